"""Claims of depth: what breaks the thing makes its gate fail."""

from __future__ import annotations

import socket

import numpy as np
import pytest

from dasim.bounds import cramer_rao
from dasim.camera import geometry, noise
from dasim.camera import specification as cameras
from dasim.camera.crosstalk import electronic_crosstalk
from dasim.simulation import relight
from dasim.simulation.exposure import Shot
from dasim.values import Capture
from recon.picture import mosaic
from recon.settings import PRESETS
from tests.support import surfaces
from validation.claims.depth import light_levels, staircase, steps
from validation.claims.light import balance
from validation.claims.table import CLAIMS
from validation.gates.limits import GATES, judged_all, load_gates
from validation.references.depth_from_blur import first_order_m
from validation.scores.figures import Figure
from validation.subjects import strips
from validation.subjects.strips import Noise, Strips

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
    return {entry.id for entry in entries if entry.passed is False and not np.isnan(entry.value)}


def staircase_fails(figures) -> set[str]:
    return failed("staircase", staircase._figures("paper.gravel.1", "gravel", figures))


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
    """The data have twice the noise that the estimator and the bound assume."""
    honest = Noise.add_to
    monkeypatch.setattr(
        Noise, "add_to", lambda self, picture, *rest: picture + 2 * (honest(self, picture, *rest) - picture)
    )
    assert "staircase.paper.gravel.1.to-bound" in staircase_fails(
        gravel.estimates(NOISE, bank_kernels, PRESETS["paper"], 0)
    )


def test_levels_read_from_the_truth_fail(gravel, bank_kernels, monkeypatch):
    """A leak: without noise in what is estimated from, the error is far below what any estimate could have."""
    monkeypatch.setattr(Noise, "add_to", lambda self, picture, *rest: picture)
    assert "staircase.paper.gravel.1.to-bound" in staircase_fails(
        gravel.estimates(NOISE, bank_kernels, PRESETS["likelihood"], 0)
    )


def test_swapped_channels_change_the_bound(da_mobile):
    """Green's kernels for infrared: with unequal noise the bound is another."""
    power = cramer_rao.natural_power(strips.BOUND_SHAPE)
    transfer, slope = (
        part[0, [3, 1]] for part in cramer_rao.camera_transfers(da_mobile, 9.0, LIGHT, strips.BOUND_SHAPE)
    )
    width = strips.BOUND_SHAPE[1]
    right, swapped = (
        float(cramer_rao.blur_deviation(t, s, power, (4e-4, 1e-4), width=width))
        for t, s in ((transfer, slope), (transfer[::-1], slope[::-1]))
    )
    assert abs(swapped / right - 1) > 0.1


def test_bound_of_strips_scales_with_noise_and_texture(gravel):
    """The same ratio of texture to noise has the same bound."""
    one, two = (gravel._bounds(Noise("", share)) for share in (0.01, 0.02))
    strengths = np.log(strips.STRENGTHS)
    for level in range(len(TRUE_LEVELS)):
        bound = np.exp(np.interp(np.log(0.25), strengths, np.log(one[:, level])))
        other = np.exp(np.interp(0.0, strengths, np.log(two[:, level])))
        assert bound == pytest.approx(other, rel=0.02)  # a table's interpolation


def test_level_step_is_that_of_the_camera(da_mobile, gravel):
    assert gravel.step_px == pytest.approx(float(geometry.level_blur_px(da_mobile)[1]))


# --- balance -------------------------------------------------------------------------------------


@pytest.fixture
def small_balance(monkeypatch):
    """Three holes, two blurs, one light."""
    monkeypatch.setattr(balance, "ALPHAS", (0.2, 0.46, 0.9))
    monkeypatch.setattr(balance, "BLURS_PX", np.array([8.0, 26.0]))
    monkeypatch.setattr(balance, "LIGHTS", ("D65",))
    return lambda: balance.balance(lambda share: None)


def test_balance_holds_its_limits(small_balance):
    evidence = small_balance()
    assert not failed("balance", evidence.figures)
    assert len(evidence.pictures) == 1


def test_a_hole_that_does_not_count_fails_the_balance(small_balance, monkeypatch):
    monkeypatch.setattr(balance, "with_hole", lambda camera, alpha: camera)
    assert {"balance.D65.bright.small-hole", "balance.D65.bright.large-hole"} <= failed(
        "balance", small_balance().figures
    )


def test_a_hole_of_another_size_fails_the_light_loss(small_balance, monkeypatch):
    """5 % more radius."""
    honest = balance.with_hole
    monkeypatch.setattr(balance, "with_hole", lambda camera, alpha: honest(camera, 1.05 * alpha))
    assert "balance.light-loss" in failed("balance", small_balance().figures)


def test_the_minimum_of_a_parabola():
    x = np.array([0.2, 0.4, 0.5, 0.8])
    assert balance.minimum(x, np.exp((x - 0.45) ** 2 + 1)) == pytest.approx((0.45, np.e))


# --- steps of depth ------------------------------------------------------------------------------


def two_planes(random, step, spread, bias=0.0, level=10.0):
    """Raw levels of two planes, the nearer on the left, a tenth of the pixels without one."""
    levels = np.where(np.arange(80) < 40, level, level - step) + bias + spread * random.standard_normal((60, 80))
    levels[random.random(levels.shape) < 0.1] = np.nan
    near = np.broadcast_to(np.arange(80) < 40, levels.shape)
    return steps.assigned(levels, near, ~near, (level, level - step))


@pytest.mark.parametrize("step", [0.2, 0.5, 1.0])
def test_share_of_right_answers_is_that_of_normal_noise(step):
    from scipy.stats import norm

    assignment = two_planes(np.random.default_rng(0), step, 0.4)
    assert assignment.right == pytest.approx(norm.cdf(step / 2 / 0.4), abs=0.02)
    assert assignment.ordered == pytest.approx(norm.cdf(step / 0.4 / np.sqrt(2)), abs=0.03)
    assert assignment.textured == pytest.approx(0.9, abs=0.02)


def test_guessing_is_one_half():
    random = np.random.default_rng(0)
    near = np.broadcast_to(np.arange(80) < 40, (60, 80))
    assignment = steps.assigned(np.full((60, 80), 9.9), near, ~near, (10.0, 9.8))
    assert (assignment.right, assignment.ordered) == pytest.approx((0.5, 0.5))
    assignment = steps.assigned(random.uniform(0, 28, (60, 80)), near, ~near, (10.0, 9.8))
    assert assignment.right == pytest.approx(0.5, abs=0.03)


def test_levels_of_the_next_kernel_are_not_right():
    """A bias of a whole level orders the planes, and assigns all pixels to one of them."""
    assignment = two_planes(np.random.default_rng(0), 0.4, 0.1, bias=1.0)
    assert assignment.right == pytest.approx(0.5, abs=0.02)
    assert assignment.ordered > 0.98


def test_threshold_is_interpolated_where_the_share_passes_it():
    assert steps.threshold((0.1, 0.2, 0.4, 0.8), [0.5, 0.65, 0.85, 0.95]) == pytest.approx(0.2 * 2**0.5)
    assert steps.threshold((0.1, 0.2), [0.9, 0.95]) == 0.1
    assert np.isnan(steps.threshold((0.1, 0.2), [0.5, 0.6]))
    assert steps.threshold((0.1, 0.2, 0.4), [0.8, 0.5, 1.0]) == pytest.approx(0.2 * 2**0.5)  # the last time


def test_step_of_a_level_is_that_of_the_blur(da_mobile):
    """Far focus, small steps: twice d^2 N p / (2 f^2) a pixel of blur; a level has 1 / (1 - alpha) of it."""
    camera = cameras.refocused(da_mobile, 100.0)
    by_formula = 2 * first_order_m(camera, 0.2) / (1 - geometry.hole_ratio(camera)) * 0.01
    assert steps.step_m(camera, 0.2, 0.01) == pytest.approx(by_formula, rel=0.01)
    assert np.isnan(steps.step_m(camera, 2.0, 3.0))


def test_depth_as_range_is_no_depth(da_mobile):
    """Planes 18 degrees off the axis whose depth is confused with the distance along the ray are assigned wrongly."""
    camera = cameras.refocused(da_mobile, 100.0)
    z, oblique = 0.1, 1 / np.cos(np.radians(18))
    level = np.array([float(geometry.blur_px(camera, d)) for d in (z, z + steps.step_m(camera, z, 0.4))])
    wrong = np.array([float(geometry.blur_px(camera, d * oblique)) for d in (z, z + steps.step_m(camera, z, 0.4))])
    step = float(geometry.level_blur_px(camera)[1])
    levels = np.where(np.arange(80) < 40, *(wrong / step)) * np.ones((60, 80))
    near = np.broadcast_to(np.arange(80) < 40, levels.shape)
    assignment = steps.assigned(levels, near, ~near, (level[0] / step, level[1] / step))
    assert assignment.right == pytest.approx(0.5)


# --- levels of light -----------------------------------------------------------------------------


@pytest.fixture(scope="module")
def even_shot(da_mobile):
    """A shot of an even grey surface of 1,000 green electrons at 1/100 s; its level falls from left to right."""
    camera = cameras.cropped(da_mobile, 64, 48)
    mean = np.broadcast_to(np.array([600.0, 1000.0, 500.0, 300.0]), (48, 64, 4)).astype(np.float32)
    truth = surfaces.truth(camera, np.broadcast_to(np.linspace(20.0, 0.0, 64), (48, 64)), mean, False)
    return Shot(Capture(np.zeros((48, 64), np.uint16), camera, 0.01, 1.0, 0), truth)


@pytest.mark.parametrize(
    ("times", "time_s", "gain"),
    [(5.0, None, 1.0), (0.5, 1 / 30, None), (0.01, 1 / 30, 16.0)],
    ids=["bright", "dim", "dark"],
)
def test_exposure_is_time_first_then_gain(even_shot, times, time_s, gain):
    camera = even_shot.capture.camera
    capture = relight.exposed(even_shot, times, 0)
    full = 0.85 * camera.sensor.full_well_e / capture.gain
    green = 1000 * times * capture.exposure_s / 0.01
    collected = electronic_crosstalk(noise.mosaic(even_shot.truth.mean_e.astype(float), camera), camera)[::2, ::2]
    brightest = green * np.percentile(collected, noise.Exposure().auto_percentile) / 1000
    assert capture.exposure_s <= relight.LONGEST_S
    assert time_s is None or capture.exposure_s == pytest.approx(time_s)
    assert gain is None or capture.gain == gain
    assert brightest <= full * 1.001
    if capture.gain < relight.MOST_GAIN:
        assert brightest == pytest.approx(full)
    electrons, _ = mosaic.linearise(capture)
    assert electrons[::2, ::2].mean() == pytest.approx(green, rel=0.05)


def test_errors_are_those_of_the_pixels_before_the_focus(even_shot):
    level = even_shot.truth.level
    raw = np.where(np.arange(64) < 32, level + 0.5, np.nan).astype(np.float32)
    error, raw_error, share = light_levels.errors_of(level + 2.0, raw, even_shot)
    assert (error, raw_error, share) == pytest.approx((2.0, 0.5, 0.5), abs=1e-4)


def test_light_that_only_harms_fails():
    """The curve turned round: noise that rises with light."""
    good = np.array([8.0, 4.0, 2.0, 0.8, 0.6, 0.5, 0.5])
    assert not failed("light-levels", light_levels.summary("D65", good, 2.0))
    assert {f"light-levels.D65.{key}" for key in ("order", "bright", "dark", "enough-lux")} <= failed(
        "light-levels", light_levels.summary("D65", good[::-1], 2.0)
    )
    assert light_levels.summary("D65", good, 2.0)[0].value == 300  # below half of 2
    assert light_levels.summary("D65", good + 1, 2.0)[0].value == np.inf


@pytest.mark.parametrize(("spread", "bias", "holds"), [(0.4, 0.0, True), (1.0, 0.0, False), (0.1, 1.0, False)])
def test_noise_and_kernels_of_the_next_level_fail_the_measured_step(spread, bias, holds):
    """Levels with 0.4 levels of noise; with more than twice of it; and without noise, a level too large."""
    random = np.random.default_rng(0)
    right = [two_planes(random, step, spread, bias).right for step in steps.STEPS]
    figure = Figure("paper.3.6mm.20cm.levels", steps.threshold(steps.STEPS, right), "level", "")
    entries = judged_all("depth-steps", [figure], load_gates(GATES, CLAIMS))
    assert next(entry.passed for entry in entries if entry.id == f"depth-steps.{figure.id}") is holds
