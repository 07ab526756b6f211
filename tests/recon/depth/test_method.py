"""Depth methods as plain functions: a user's method replaces the bundled one, and its result is checked."""

import dataclasses

import numpy as np
import pytest

import recon
from dasim.base.errors import InputError
from dasim.camera import specification
from recon import levels
from recon.depth import method as depth_method
from tests.support import recon_scenes

IMAGES = ("rgb", "sharp_rgb", "linear_e", "sharp_e", "ir_e", "level_raw", "level", "depth_m", "confidence")
SPARSE = 0.05  # share of the pixels that the methods of the tests estimate
# Level map filled from exact levels at a share of the pixels, on a plane of one level per 19 px: the mean error of a
# block whose nearest estimates lie within a few blocks stays below half a level.
FILLED_MEDIAN_LEVELS = 0.5
MIN_GAIN_DB = 1.0  # of the all-in-focus picture with exact levels, as the bundled methods must gain with their own


@pytest.fixture(scope="module")
def scene():
    return recon_scenes.make(recon_scenes.slanted(128, 384, 2, 22), white_e=4000)


@pytest.fixture(scope="module")
def bank():
    return recon_scenes.bank()


def sparse(exact):
    """The exact map at a few pixels chosen at random, NaN elsewhere."""
    return np.where(np.random.default_rng(5).random(exact.shape) < SPARSE, exact, np.nan).astype(np.float32)


@pytest.mark.parametrize("name", recon.PRESETS)
def test_bundled_methods_give_the_same_bytes_as_their_settings(scene, bank, name):
    settings = recon.PRESETS[name]
    by_settings = recon.reconstruct(scene.capture, bank, settings)
    by_method = recon.reconstruct(scene.capture, bank, settings, method=recon.METHODS[name])
    # The windows alone, which the settings of ``best`` and ``fast`` show as raw levels, are no part of its estimate.
    for image in [image for image in IMAGES if (name, image) not in (("best", "level_raw"), ("fast", "level_raw"))]:
        np.testing.assert_array_equal(getattr(by_method, image), getattr(by_settings, image), err_msg=image)
    assert (by_settings.method, by_method.method) == (None, name)


def test_a_map_that_has_joined_neighbours_is_not_regularised(scene, bank):
    """Set-up: a noisy map without gaps, with and without ``joined``; one with a gap. Expectation: the first is kept
    within 2x2 blocks, the others are smoothed.
    """
    noisy = np.clip(scene.level + np.random.default_rng(1).normal(0, 1, scene.level.shape), 0, 28)
    noisy = noisy[::2, ::2].repeat(2, axis=0).repeat(2, axis=1)
    gap = noisy.copy()
    gap[10:12, 10:12] = np.nan

    def result(level, joined):
        estimate = recon.DepthEstimate(level=level, joined=joined)
        return recon.reconstruct(scene.capture, bank, method=lambda capture, own: estimate).level

    inner = (slice(16, -16), slice(16, -16))

    def rough(level):
        return np.std(np.diff(level[inner], axis=1))

    kept, smoothed, filled = result(noisy, True), result(noisy, False), result(gap, True)
    blocks = [level.reshape(level.shape[0] // 2, 2, -1, 2).mean(axis=(1, 3)) for level in (kept, noisy)]
    assert np.corrcoef(*(block.ravel() for block in blocks))[0, 1] > 0.99
    assert rough(kept) > 2 * rough(smoothed)
    assert rough(kept) > 2 * rough(filled)


def test_a_foreign_method_yields_an_all_in_focus_picture(scene, bank):
    """Set-up: a method that returns the exact depth at one pixel in twenty. Expectation: the level map is filled in
    from these pixels, and the picture gains sharpness.
    """

    def oracle(capture, own_bank):
        return recon.DepthEstimate(depth_m=sparse(levels.depth_of(scene.level, own_bank.depth_m)))

    result = recon.reconstruct(scene.capture, bank, method=oracle)
    inner = (slice(16, -16), slice(64, -16))
    assert np.median(np.abs(result.level - scene.level)[inner]) < FILLED_MEDIAN_LEVELS
    separation = np.hstack([np.eye(3), -specification.crosstalk(scene.capture.camera)[:, None]])
    truth = np.maximum(scene.sharp_e @ separation.T, 0)
    before, after = (np.mean((image - truth)[inner] ** 2) for image in (result.linear_e, result.sharp_e))
    assert 10 * np.log10(before / after) > MIN_GAIN_DB
    assert result.method is not None and result.method.endswith("oracle")


def test_levels_and_depths_give_equal_estimates(scene, bank):
    """A level map and the corresponding depths, both with a standard deviation of one level, give equal levels and
    confidence.

    The standard deviation of the depth is that of the level times z^2 times the dioptres per level.
    """
    level = sparse(scene.level).astype(np.float64)
    depth_m = 1 / np.interp(level, np.arange(len(bank.depth_m)), 1 / bank.depth_m.astype(np.float64))
    per_level = (1 / float(bank.depth_m[-1]) - 1 / float(bank.depth_m[0])) / (len(bank.depth_m) - 1)
    by_level = recon.DepthEstimate(level=level, sd=np.ones_like(level))
    by_depth = recon.DepthEstimate(depth_m=depth_m, sd=per_level * depth_m**2)
    first, second = (depth_method.on_blocks(estimate, bank) for estimate in (by_level, by_depth))
    np.testing.assert_allclose(first[0], second[0], atol=1e-4)
    np.testing.assert_allclose(first[1], second[1], atol=1e-4)
    known = np.isfinite(first[0])
    assert np.all(first[1][known] == 0.5) and not first[1][~known].any()  # s^2 / (s^2 + sd^2), s one level


def test_a_block_has_the_mean_of_its_pixels_estimates(bank):
    level = np.full((4, 4), np.nan)
    level[0, 0], level[1, 1] = 3.0, 5.0
    level[2:, 2:] = 7.0
    blocks, confidence, outside = depth_method.on_blocks(recon.DepthEstimate(level=level), bank)
    np.testing.assert_array_equal(blocks, np.array([[4, np.nan], [np.nan, 7]], np.float32))
    np.testing.assert_array_equal(confidence, [[0.5, 0], [0, 0.5]])
    assert outside == 0


def test_estimates_outside_the_bank_are_counted(scene, bank):
    """If half of the frame is farther than the focus, these pixels count as in focus and a note states their number."""
    focus_m = float(bank.depth_m[0])

    def half_behind(capture, own_bank):
        depth_m = np.full(capture.raw_dn.shape, 0.9 * focus_m)
        depth_m[:, : depth_m.shape[1] // 2] = 2 * focus_m
        return recon.DepthEstimate(depth_m=depth_m)

    result = recon.reconstruct(scene.capture, bank, method=half_behind)
    note, side = result.notes
    assert note.startswith("50.0% of the estimates of method ") and "half_behind" in note
    assert side.startswith("the side of the focus is assumed") and result.side == "assumed"
    assert np.all(result.level_raw[:, : result.level_raw.shape[1] // 2] == 0)


def returns(value):
    def method(capture, bank):
        return value(capture) if callable(value) else value

    return method


WRONG = {
    "no estimate": (returns(None), "returns NoneType; it must be a recon.DepthEstimate"),
    "an array": (returns(np.ones((4, 4))), "returns ndarray"),
    "half size": (
        returns(lambda capture: recon.DepthEstimate(level=np.ones((64, 192)))),
        r"shape \(64, 192\), the raw frame has \(128, 384\)",
    ),
    "nothing": (returns(lambda capture: recon.DepthEstimate(level=np.full((128, 384), np.nan))), "all values are NaN"),
    "below zero": (
        returns(lambda capture: recon.DepthEstimate(depth_m=np.full((128, 384), -1.5))),
        "goes down to -1.5 m",
    ),
}


@pytest.mark.parametrize("case", WRONG)
def test_what_a_method_must_not_return_is_named(scene, bank, case):
    method, problem = WRONG[case]
    with pytest.raises(InputError, match=rf"^method '.*method': .*{problem}"):
        recon.reconstruct(scene.capture, bank, method=method)


ONES = np.ones((4, 6))


@pytest.mark.parametrize(
    ("fields", "problem"),
    [
        ({}, "neither of level and depth_m"),
        ({"level": ONES, "depth_m": ONES}, "both of level and depth_m"),
        ({"level": [[1.0]]}, "of type list"),
        ({"level": ONES.astype(int)}, "array of int64"),
        ({"level": ONES[0]}, r"shape \(6,\)"),
        ({"depth_m": 0 * ONES}, "goes down to 0 m"),
        ({"depth_m": np.inf * ONES}, "infinite values; NaN marks"),
        ({"level": ONES, "sd": ONES[:2]}, r"sd has the shape \(2, 6\), level has \(4, 6\)"),
        ({"level": ONES, "sd": -ONES}, "sd is NaN or negative"),
        ({"level": ONES, "sd": np.nan * ONES}, "sd is NaN or negative"),
    ],
)
def test_invalid_estimates_are_named(fields, problem):
    with pytest.raises(InputError, match=f"depth estimate: .*{problem}"):
        recon.DepthEstimate(**fields)


def test_coverage_is_the_share_of_pixels_with_an_estimate():
    level = np.full((4, 6), np.nan)
    level[0] = 2.0
    estimate = recon.DepthEstimate(level=level, sd=level)
    assert estimate.coverage == 0.25 and estimate.shape == (4, 6)


def test_bundled_methods_refuse_a_bank_of_another_camera(scene, bank):
    other = bank.camera.model_copy(update={"sensor": bank.camera.sensor.model_copy(update={"cutoff_nm": 700.0})})
    with pytest.raises(InputError, match="differ in cutoff_nm"):
        recon.METHODS["bands"](scene.capture, dataclasses.replace(bank, camera=other))
