"""Claims of depth: what breaks the thing makes its gate fail."""

from __future__ import annotations

import socket

import numpy as np
import pytest

from dasim import camera as cameras
from recon.settings import PRESETS
from validation import bounds, strips
from validation.claim import GATES, judged_all, load_gates
from validation.claim_table import CLAIMS
from validation.claims import staircase
from validation.strips import Noise, Strips

LIGHT = "D65"
BANK_LEVELS = range(9)  # enough for a score to have neighbours
TRUE_LEVELS = (3, 5, 7)
KERNEL_PX = 41
NOISE = Noise("1", 0.01)


@pytest.fixture(scope="module")
def bank_kernels(da_mobile):
    """The camera's own kernels in place of a bank's: [level, channel, y, x]."""
    return strips.own_kernels(da_mobile, list(BANK_LEVELS), LIGHT, KERNEL_PX).astype(np.float32)


@pytest.fixture(scope="module")
def gravel(da_mobile, bank_kernels):
    return Strips("gravel", TRUE_LEVELS, bank_kernels[list(TRUE_LEVELS)], da_mobile, LIGHT)


def failed(claim: str, figures) -> set[str]:
    """Figures that do not keep their limits; those that were not measured do not count."""
    entries = judged_all(claim, figures, load_gates(GATES, CLAIMS))
    return {entry.id for entry in entries if entry.passed is False and np.isfinite(entry.value)}


def staircase_fails(found) -> set[str]:
    return failed("staircase", staircase._figures("paper.gravel.1", "gravel", found))


def test_photographs_need_no_network(monkeypatch):
    def refuse(*args, **options):
        raise AssertionError("a connection")

    monkeypatch.setattr(socket.socket, "connect", refuse)
    for name in (staircase.TEXTURE, *staircase.TEXTURES):
        picture = strips.photograph(name, (202, 298))
        assert picture.shape == (202, 298)
        assert 0 <= picture.min() < 0.3 < 0.6 < picture.max() <= 1


def test_staircase_holds_its_limits(gravel, bank_kernels):
    assert not staircase_fails(gravel.estimates(NOISE, bank_kernels, PRESETS["paper"], 0))


def test_kernels_of_the_next_level_fail(gravel, bank_kernels):
    shifted = np.concatenate([bank_kernels[1:], bank_kernels[-1:]])
    assert {"staircase.paper.gravel.1.bias", "staircase.paper.gravel.1.to-bound"} <= staircase_fails(
        gravel.estimates(NOISE, shifted, PRESETS["paper"], 0)
    )


def test_noise_that_is_more_than_said_fails(gravel, bank_kernels, monkeypatch):
    """Twice the noise that the estimator and the bound are told."""
    honest = Noise.added
    monkeypatch.setattr(
        Noise, "added", lambda self, picture, *rest: picture + 2 * (honest(self, picture, *rest) - picture)
    )
    assert "staircase.paper.gravel.1.to-bound" in staircase_fails(
        gravel.estimates(NOISE, bank_kernels, PRESETS["paper"], 0)
    )


def test_levels_read_from_the_truth_fail(gravel, bank_kernels, monkeypatch):
    """A leak: without noise in what is estimated from, the error is far below what any estimate could have."""
    monkeypatch.setattr(Noise, "added", lambda self, picture, *rest: picture)
    assert "staircase.paper.gravel.1.to-bound" in staircase_fails(
        gravel.estimates(NOISE, bank_kernels, PRESETS["likelihood"], 0)
    )


def test_swapped_channels_change_the_bound(da_mobile):
    """Green's kernels for infrared: with unequal noise the bound is another."""
    power = bounds.natural_power(strips.BOUND_SHAPE)
    transfer, slope = (part[0, [3, 1]] for part in bounds.camera_transfers(da_mobile, 9.0, LIGHT, strips.BOUND_SHAPE))
    width = strips.BOUND_SHAPE[1]
    right, swapped = (
        float(bounds.blur_deviation(t, s, power, (4e-4, 1e-4), width=width))
        for t, s in ((transfer, slope), (transfer[::-1], slope[::-1]))
    )
    assert abs(swapped / right - 1) > 0.1


def test_bound_of_strips_scales_with_noise_and_texture(gravel):
    """The same ratio of texture to noise has the same bound."""
    one, two = (gravel._bounds(Noise("", share)) for share in (0.01, 0.02))
    strengths = np.log(strips.STRENGTHS)
    for level in range(len(TRUE_LEVELS)):
        own = np.exp(np.interp(np.log(0.25), strengths, np.log(one[:, level])))
        other = np.exp(np.interp(0.0, strengths, np.log(two[:, level])))
        assert own == pytest.approx(other, rel=0.02)  # a table's interpolation


def test_level_step_is_that_of_the_camera(da_mobile, gravel):
    assert gravel.step_px == pytest.approx(float(cameras.level_blur_px(da_mobile)[1]))
