"""Stereo matching and the fusion of its depth with that of defocus."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import ndimage

from dasim.camera import geometry
from dasim.camera import specification as cameras
from recon.depth import stereo_fusion

SIZE = (96, 160)
BASELINE_M = 0.02
FOCUS_M, NEAR_VERGENCE = 2.0, 3.0
SAMPLED = 0.03  # 15,360 pixels: 0.6 % of a standard deviation, and float32 depths
WALL_AND_STRIP_M = (1.5, 0.7)
HALF_BLOCK_PX = 5  # the matcher's window reaches over the strip's edge
FEW, MOST = 0.1, 0.8
MATCH_PX = 0.5  # of a matcher with sixteenths, on a texture without noise
SURE, GUESS = np.ones(SIZE, np.float32), np.zeros(SIZE, np.float32)


@pytest.fixture(scope="module")
def camera(da_mobile):
    return cameras.cropped(cameras.refocused(da_mobile, FOCUS_M), SIZE[1], SIZE[0])


def scale(camera):
    """Pixels of disparity per dioptre, b f / p."""
    return BASELINE_M * geometry.intrinsic_matrix(camera)[0, 0]


def dioptres_per_level(camera):
    return 1 / float(geometry.depth_of_blur_m(camera, geometry.level_blur_px(camera)[1])) - 1 / FOCUS_M


def coloured(picture):
    return np.repeat(picture[..., None], 3, axis=-1).astype(np.float32)


def everywhere(depth_m):
    return np.full(SIZE, depth_m, np.float32)


def texture(width: int) -> np.ndarray:
    random = np.random.default_rng(3).random((SIZE[0], width))
    smooth = ndimage.gaussian_filter(random, 1.0)
    return (smooth - smooth.min()) / np.ptp(smooth)


@pytest.mark.parametrize("depth_m", [0.7, 1.4])
def test_a_plane_has_its_distance(camera, depth_m):
    """Set-up: a textured plane, displaced by b f / (p z) pixels through interpolation. Expectation: z to
    half a pixel.
    """
    wide = texture(SIZE[1] + 200)
    shift = scale(camera) / depth_m
    columns = np.arange(SIZE[1])
    left = wide[:, 100 : 100 + SIZE[1]]
    right = np.stack([np.interp(columns + 100 + shift, np.arange(wide.shape[1]), row) for row in wide])
    pair = [coloured(picture) for picture in (left, right)]
    matched_m = stereo_fusion.stereo_depth_m(*pair, scale(camera), 0.4)[10:-10, 110:-10]
    known = np.isfinite(matched_m)
    assert known.mean() > 0.9
    error = scale(camera) / matched_m[known] - shift
    assert np.median(np.abs(error)) < MATCH_PX


def combined(camera, depth_m, confidence, matched):
    return stereo_fusion.combined_m(depth_m, confidence, matched, scale(camera), dioptres_per_level(camera))


def test_the_combination_is_nearer_to_the_better_one(camera):
    """Set-up: z = 1 m, exact stereo and defocus that is off by a fifth of a level. Expectation: the combined error is
    below that of defocus.
    """
    step = float(geometry.level_blur_px(camera)[1])
    wrong = float(geometry.depth_of_blur_m(camera, geometry.blur_px(camera, 1.0) + 0.2 * step))
    both = combined(camera, everywhere(wrong), SURE, np.ones(SIZE))
    assert np.abs(1 / both - 1).max() < 0.5 * abs(1 / wrong - 1)


def test_a_match_far_from_a_confident_level_is_rejected(camera):
    """Expectation: where stereo has no match, or one many levels off, the depth by defocus stays."""
    matched = np.ones(SIZE)
    matched[:, :50], matched[:, 50:100] = np.nan, 0.05
    np.testing.assert_allclose(combined(camera, everywhere(1.0), SURE, matched), 1.0, rtol=1e-6)


def test_an_uncertain_level_rejects_no_match(camera):
    """Set-up: a match three levels from the depth by defocus. Expectation: a confident level rejects the match; if the
    level is uncertain, the result is the match.
    """
    step = 3 * float(geometry.level_blur_px(camera)[1])
    matched = np.full(SIZE, float(geometry.depth_of_blur_m(camera, geometry.blur_px(camera, 1.0) + step)))
    np.testing.assert_allclose(combined(camera, everywhere(1.0), SURE, matched), 1.0, rtol=1e-6)
    np.testing.assert_allclose(combined(camera, everywhere(1.0), GUESS, matched), matched, rtol=1e-3)


def test_weights_are_those_of_least_variance(camera):
    """Set-up: depths by defocus and by stereo whose errors have the standard deviations that the weights assume.

    Expectation: the combination has the variance 1 / (1/a + 1/b) of the best weighted mean, below both variances.
    """
    per_level = dioptres_per_level(camera)
    deviation = stereo_fusion.LEVEL_SIGMA * per_level
    short = stereo_fusion.MATCH_PX / deviation  # px per dioptre of a baseline at which a match has the same deviation
    random = np.random.default_rng(5)
    errors = deviation * np.clip(random.standard_normal((2, *SIZE)), -2, 2)  # at most two, so that all agree
    defocus_m, stereo_m = (1 / (NEAR_VERGENCE + error) for error in errors)
    both = 1 / stereo_fusion.combined_m(defocus_m.astype(np.float32), SURE, stereo_m, short, per_level) - NEAR_VERGENCE
    assert both.std() == pytest.approx(errors[0].std() / np.sqrt(2), rel=SAMPLED)


def test_what_is_hidden_has_no_match(camera):
    """Set-up: a far wall behind a near strip, each with its own texture; the right picture is displaced by their
    disparities.

    Expectation: beside the strip, the part of the wall that the right camera does not see has no match; wall and strip
    have one elsewhere.
    """
    wide, near_texture = texture(SIZE[1] + 200), texture(SIZE[1] + 300)[:, 100:]
    columns = np.arange(SIZE[1])
    shifts = [round(scale(camera) / z) for z in WALL_AND_STRIP_M]
    left, right = wide[:, columns + 100], wide[:, columns + 100 + shifts[0]]
    strip, moved = (columns >= 110) & (columns < 140), (columns + shifts[1] >= 110) & (columns + shifts[1] < 140)
    left, right = (
        np.where(strip, near_texture[:, columns], left),
        np.where(moved, near_texture[:, columns + shifts[1]], right),
    )
    pair = [coloured(picture) for picture in (left, right)]
    matched = np.isfinite(stereo_fusion.stereo_depth_m(*pair, scale(camera), 0.3))[10:-10]
    shade = range(110 - (shifts[1] - shifts[0]) + HALF_BLOCK_PX, 110 - HALF_BLOCK_PX)
    assert matched[:, shade].mean() < FEW < MOST < min(matched[:, 113:137].mean(), matched[:, 50 : shade[0] - 5].mean())
