"""The side of the focus: evidence of four channels, signed levels, and what is said of them."""

from __future__ import annotations

import dataclasses
from functools import cache

import numpy as np
import pytest
from scipy import signal

from dasim.camera import geometry, pointspread, specification
from dasim.spectra import illuminants
from dasim.spectra.grid import CHANNELS
from dasim.values import LevelsBehind, PsfBank
from recon import levels
from recon.depth import side
from recon.depth.best import Map
from recon.depth.channels import Channel, Leak
from recon.picture import mosaic
from tests.support import recon_scenes

BEHIND, NEAR = 5, 9  # levels on either side
SHAPE = (64, 96)
MEAN_E, CONTRAST_E = 1000.0, 150.0
CERTAIN = 0.9
NO_LEAK = [Leak(0.0, 0.0)] * 3


@cache
def kernels(shift_um: float) -> np.ndarray:
    """Kernels from level -BEHIND to NEAR of the camera focused at 20 cm with axial colour, [level, channel, y, x]."""
    camera = recon_scenes.da_mobile(512, 384)
    shift = {"focal_shift_um": ((450.0, -shift_um / 2), (550.0, 0.0), (750.0, shift_um)), "focus_distance_m": 0.2}
    camera = camera.model_copy(update={"lens": camera.lens.model_copy(update=shift)})
    blurs = np.arange(-BEHIND, NEAR + 1) * geometry.level_blur_px(camera)[1]
    at = pointspread.kernels(camera, blurs, illuminants.illuminant("D65"), 41)
    found = np.stack([at(index, (0.0, 0.0), ...)[0] for index in range(len(blurs))])
    return np.asarray(found / found.sum(axis=(-1, -2), keepdims=True), np.float32)


def sides(level: int, shift_um: float) -> tuple[list[Channel], list[Channel]]:
    """Four colour planes of a natural texture at a signed level, with photon noise, and the kernels of both sides."""
    random = np.random.default_rng(3)
    own = kernels(shift_um)
    height, width = (2 * n + 40 for n in SHAPE)
    radius = np.hypot(np.fft.fftfreq(height)[:, None], np.fft.rfftfreq(width))
    radius[0, 0] = np.inf
    texture = np.fft.irfft2(np.fft.rfft2(random.normal(size=(height, width))) / radius, s=(height, width))
    texture *= CONTRAST_E / texture.std()
    camera = specification.load_camera("da-mobile")
    phases, planes = mosaic.phases(camera), []
    for index, name in enumerate(CHANNELS):
        row, column = phases[name]
        blurred = MEAN_E + signal.fftconvolve(texture, own[level + BEHIND, index], mode="valid")[row::2, column::2]
        planes.append((blurred + random.normal(size=SHAPE) * np.sqrt(MEAN_E), phases[name]))
    variance = np.full(SHAPE, MEAN_E, np.float32)
    return tuple(
        [
            Channel(plane.astype(np.float32), phase, variance, side_kernels[:, index])
            for index, (plane, phase) in enumerate(planes)
        ]
        for side_kernels in (own[BEHIND:], own[BEHIND::-1])
    )  # type: ignore[return-value]


@pytest.mark.parametrize("level", [-4, -1, 2, 5])
def test_a_surface_is_seen_on_its_side(level):
    """Expectation: nearly certain on every sample, whatever the side; with both sides exchanged, the opposite."""
    near, far = sides(level, 15.0)
    clipped = np.zeros(SHAPE, bool)
    right = side.probability_behind(near, far, NO_LEAK, clipped, 0.05)
    wrong = side.probability_behind(far, near, NO_LEAK, clipped, 0.05)
    if level < 0:
        right, wrong = 1 - right, 1 - wrong
    assert right.shape == SHAPE
    assert right.max() < 1 - CERTAIN and wrong.min() > 0.5


def test_without_axial_colour_there_is_no_evidence():
    """Expectation: the prior, everywhere: levels of both sides have the same kernels. Clipped samples say nothing."""
    near, far = sides(-3, 0.0)
    alike = [channel._replace(kernels=other.kernels) for channel, other in zip(near, far, strict=True)]
    clipped = np.zeros(SHAPE, bool)
    found = side.probability_behind(alike, far, NO_LEAK, clipped, 0.05)
    np.testing.assert_allclose(found, side.PRIOR_BEHIND, atol=1e-5)
    found = side.probability_behind(*sides(-3, 15.0), NO_LEAK, ~clipped, 0.05)
    np.testing.assert_allclose(found, side.PRIOR_BEHIND, atol=1e-5)


def test_the_standard_deviation_holds_the_doubt_about_the_side():
    """Expectation: mean square distance from the chosen level, of a mixture of both sides; infinite stays infinite."""

    def of(level, sd):
        return Map(*(np.array([[value, value, value]], np.float32) for value in (level, sd, level, sd)))

    near, far = of(3.0, 0.5), of(2.0, 0.25)
    found = side.signed(near, far, np.array([[0.0, 0.2, 0.9]], np.float32))
    np.testing.assert_allclose(found.level, [[3, 3, -2]])
    expected = [0.5**2, 0.8 * 0.5**2 + 0.2 * (0.25**2 + 5**2), 0.9 * 0.25**2 + 0.1 * (0.5**2 + 5**2)]
    np.testing.assert_allclose(found.sd[0] ** 2, expected, rtol=1e-5)
    unknown = side.signed(near, of(2.0, np.inf), np.array([[0.6, 0.7, 0.9]], np.float32))
    assert np.isinf(unknown.sd).all() and np.isinf(unknown.window_sd).all()


def test_depths_of_signed_levels_lie_on_one_line_in_dioptres():
    """Expectation: 1/d = 1/d_f + level times a constant on both sides, clamped to the ends; and back again."""
    vergence = 5 + 0.7 * np.arange(-4, 7)
    near_m, behind_m = 1 / vergence[4:], 1 / vergence[4::-1]
    level = np.array([-9.0, -4.0, -1.5, 0.0, 2.25, 6.0, 9.0])
    depth_m = levels.depth_of(level, near_m, behind_m)
    np.testing.assert_allclose(1 / depth_m, 5 + 0.7 * np.clip(level, -4, 6), rtol=1e-6)
    np.testing.assert_allclose(levels.level_of(depth_m, near_m), np.clip(level, -4, 6), atol=1e-5)
    np.testing.assert_array_equal(levels.depth_of(np.array([-2.0]), near_m), np.float32([1 / 5]))


def test_measured_depths_behind_the_focus_are_read_both_ways():
    """Set-up: depths of a calibration that are up to a quarter of a level off, on both sides."""
    off = np.array([0.2, -0.25, 0.1, -0.2, 0, 0.1, -0.2, 0.25])
    vergence = 5 + 0.7 * (np.arange(-4, 4) + off)
    near_m, behind_m = 1 / vergence[4:], 1 / vergence[4::-1]
    level = np.array([-4, -2.5, -1, 0, 1.5, 3])
    np.testing.assert_allclose(
        levels.level_of(levels.depth_of(level, near_m, behind_m), near_m, behind_m), level, atol=1e-5
    )


def test_the_note_says_how_the_side_is_known():
    camera, level = recon_scenes.da_mobile(512, 384), np.array([[-1.0, 2.0, 3.0, 1.0]])
    one = np.ones((1, 1, 4, 1, 1), np.float32)
    plain = PsfBank(one, ("D65",), one[0, :, :, 0, 0], one[0, 0, :1, 0, 0], 0 * one[0, 0, :1, 0, 0], camera, "wave")
    both = dataclasses.replace(plain, behind=LevelsBehind(one, plain.depth_m, plain.blur_px))
    assumed = [side.side_note("assumed", level, bank) for bank in (plain, both)]
    assert all("assumed: everything is taken to be nearer than 0.4 m" in note for note in assumed)
    assert "the bank has no levels behind" in assumed[0] and "this method does not tell" in assumed[1]
    assert "estimated from axial colour: 25.0% of pixels behind" in side.side_note("estimated", level, both)
    assert "estimated by method 'mine': 25.0%" in side.side_note("estimated", level, both, "mine")


def test_a_side_that_knows_nothing_leaves_the_other_as_it_is():
    """Set-up: a bank of few levels behind the focus, whose windows know nothing; certainly in front, or doubtful.

    Expectation: the standard deviation of the near side, with the doubt about the side where there is any.
    """
    level, sd = np.full((1, 2), 6, np.float32), np.full((1, 2), 0.4, np.float32)
    none = np.full((1, 2), np.inf, np.float32)
    near, far = Map(level, sd, level, sd), Map(level / 6, none, level / 6, none)
    found = side.signed(near, far, np.array([[0.0, 0.2]], np.float32))
    np.testing.assert_array_equal(found.level, 6)
    np.testing.assert_allclose(found.sd, [[0.4, np.sqrt(0.8 * 0.16 + 0.2 * 49)]], rtol=1e-6)
    behind = side.signed(near, far, np.array([[1.0, 0.8]], np.float32))
    assert np.isinf(behind.sd).all()
