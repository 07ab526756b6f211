"""Two cameras: where the second one stands, which pixels it does not see, and how both depths join."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from dasim.camera import geometry
from dasim.camera import specification as cameras
from dasim.scene.specification import world_to_camera
from dasim.values import Reconstruction
from recon.depth import stereo_fusion
from tests.support import surfaces

SIZE = (96, 160)
BASELINE_M = 0.02
FOCUS_M, NEAR_VERGENCE = 2.0, 3.0
SAMPLED = 0.03  # 15,360 pixels: 0.6 % of a standard deviation, and float32 depths
WALL_AND_STRIP_M = (1.5, 0.7)
HALF_BLOCK_PX = 5  # the matcher's window reaches over the strip's edge
FEW, MOST = 0.1, 0.8
MATCH_PX = 0.5  # of a matcher with sixteenths, on a texture without noise


@pytest.fixture(scope="module")
def camera(da_mobile):
    return cameras.cropped(cameras.refocused(da_mobile, FOCUS_M), SIZE[1], SIZE[0])


def truth(camera, depth_m):
    level = geometry.blur_px(camera, np.broadcast_to(depth_m, SIZE)) / geometry.level_blur_px(camera)[1]
    return surfaces.truth(camera, level, np.ones((*SIZE, 4)))


def seen(camera, picture, depth_m) -> Reconstruction:
    colours = np.repeat(picture[..., None], 3, axis=-1).astype(np.float32)
    depth = np.broadcast_to(np.float32(depth_m), SIZE).copy()
    ones = np.ones(SIZE, np.float32)
    return Reconstruction(
        rgb=colours, sharp_rgb=colours, linear_e=colours, sharp_e=colours, ir_e=ones, level_raw=ones, level=ones,
        depth_m=depth, confidence=ones, camera=camera, light="D55", settings={}, timings_s={},
    )  # fmt: skip


def texture(width: int) -> np.ndarray:
    from scipy import ndimage

    random = np.random.default_rng(3).random((SIZE[0], width))
    smooth = ndimage.gaussian_filter(random, 1.0)
    return (smooth - smooth.min()) / np.ptp(smooth)


def test_the_second_camera_stands_to_the_right(make_scene):
    """Expectation: a point keeps its z and moves to the left by the baseline, whichever way the first one looks."""
    view = {"position_cm": (3, -2, 5), "look_at_cm": (10, 4, 60)}
    scene = make_scene(
        {"name": "ball", "shape": "sphere", "radius_cm": 1, "position_cm": (0, 0, 40), "material": "white-paper"},
        view=view,
    )
    point = np.array([0.1, 0.05, 0.6, 1.0])
    first, second = (world_to_camera(s) @ point for s in (scene, stereo_fusion.other_view(scene, BASELINE_M)))
    np.testing.assert_allclose(second - first, [-BASELINE_M, 0, 0, 0], atol=1e-12)


@pytest.mark.parametrize("depth_m", [0.7, 1.4])
def test_a_plane_has_its_distance(camera, depth_m):
    """Set-up: a textured plane, moved by b f / (p z) pixels, interpolated. Expectation: z, to half a pixel."""
    wide = texture(SIZE[1] + 200)
    shift = float(stereo_fusion.shift_px(camera, BASELINE_M, np.float64(depth_m)))
    columns = np.arange(SIZE[1])
    left = wide[:, 100 : 100 + SIZE[1]]
    right = np.stack([np.interp(columns + 100 + shift, np.arange(wide.shape[1]), row) for row in wide])
    pair = [seen(camera, picture, depth_m) for picture in (left, right)]
    found = stereo_fusion.stereo_depth_m(pair[0], pair[1], BASELINE_M, 0.4)[10:-10, 110:-10]
    known = np.isfinite(found)
    assert known.mean() > 0.9
    error = stereo_fusion.shift_px(camera, BASELINE_M, found[known]) - shift
    assert np.median(np.abs(error)) < MATCH_PX


def test_both_together_are_nearer_to_the_better_one(camera):
    """Set-up: z = 1 m; stereo is exact, defocus off by a fifth of a level. Expectation: less than defocus's error."""
    step = float(geometry.level_blur_px(camera)[1])
    wrong = float(geometry.depth_of_blur_m(camera, geometry.blur_px(camera, 1.0) + 0.2 * step))
    result = seen(camera, texture(SIZE[1]), wrong)
    both = stereo_fusion.combined_m(result, np.ones(SIZE), 0.06)
    assert np.abs(1 / both - 1).max() < 0.5 * abs(1 / wrong - 1)


def test_a_match_far_from_a_sure_level_is_wrong(camera):
    """Expectation: where stereo has none, or one many levels off, the depth by defocus stays."""
    result = seen(camera, texture(SIZE[1]), 1.0)
    matched = np.ones(SIZE)
    matched[:, :50], matched[:, 50:100] = np.nan, 0.05
    np.testing.assert_allclose(stereo_fusion.combined_m(result, matched, BASELINE_M), 1.0, rtol=1e-6)


def test_an_unsure_level_refutes_no_match(camera):
    """Set-up: a match three levels from what defocus says. Expectation: the match is refuted by a sure level alone, and
    goes for all where the level is a guess.
    """
    step = 3 * float(geometry.level_blur_px(camera)[1])
    matched = np.full(SIZE, float(geometry.depth_of_blur_m(camera, geometry.blur_px(camera, 1.0) + step)))
    result = seen(camera, texture(SIZE[1]), 1.0)
    guess = replace(result, confidence=np.zeros(SIZE, np.float32))
    np.testing.assert_allclose(stereo_fusion.combined_m(result, matched, BASELINE_M), 1.0, rtol=1e-6)
    np.testing.assert_allclose(stereo_fusion.combined_m(guess, matched, BASELINE_M), matched, rtol=1e-3)


def test_weights_are_those_of_least_variance(camera):
    """Set-up: depths by defocus and by stereo with errors of the deviations that the weights assume.

    Expectation: both together have the variance 1 / (1/a + 1/b) of the best mean of two, below that of either.
    """
    per_level = 1 / float(geometry.depth_of_blur_m(camera, geometry.level_blur_px(camera)[1])) - 1 / FOCUS_M
    baseline_m = stereo_fusion.MATCH_PX / (
        stereo_fusion.LEVEL_SIGMA * per_level * geometry.intrinsic_matrix(camera)[0, 0]
    )
    deviation = stereo_fusion.LEVEL_SIGMA * per_level  # of both, with so short a baseline
    random = np.random.default_rng(5)
    errors = deviation * np.clip(random.standard_normal((2, *SIZE)), -2, 2)  # two at most, so that all agree
    result = replace(seen(camera, texture(SIZE[1]), 1.0), depth_m=(1 / (NEAR_VERGENCE + errors[0])).astype(np.float32))
    both = 1 / stereo_fusion.combined_m(result, 1 / (NEAR_VERGENCE + errors[1]), baseline_m) - NEAR_VERGENCE
    assert both.std() == pytest.approx(errors[0].std() / np.sqrt(2), rel=SAMPLED)


def test_what_is_hidden_has_no_match(camera):
    """Set-up: a far wall, before it a near strip, each with its own texture; the right picture by their disparities.

    Expectation: the wall beside the strip that the right camera does not see is not matched; wall and strip are.
    """
    wide, own = texture(SIZE[1] + 200), texture(SIZE[1] + 300)[:, 100:]
    columns = np.arange(SIZE[1])
    shifts = [round(float(stereo_fusion.shift_px(camera, BASELINE_M, np.float64(z)))) for z in WALL_AND_STRIP_M]
    left, right = wide[:, columns + 100], wide[:, columns + 100 + shifts[0]]
    strip, moved = (columns >= 110) & (columns < 140), (columns + shifts[1] >= 110) & (columns + shifts[1] < 140)
    left, right = np.where(strip, own[:, columns], left), np.where(moved, own[:, columns + shifts[1]], right)
    pair = [seen(camera, picture, 1.0) for picture in (left, right)]
    found = np.isfinite(stereo_fusion.stereo_depth_m(pair[0], pair[1], BASELINE_M, 0.3))[10:-10]
    shade = range(110 - (shifts[1] - shifts[0]) + HALF_BLOCK_PX, 110 - HALF_BLOCK_PX)
    assert found[:, shade].mean() < FEW < MOST < min(found[:, 113:137].mean(), found[:, 50 : shade[0] - 5].mean())


def test_figures_compare_where_a_point_is_matched(camera):
    """Set-up: a board at 1 m that defocus puts 0.1 dioptres off; the right picture by its disparity.

    Expectation: stereo and both are within a tenth of defocus's error where there is a match; at the left edge, which
    the other camera does not see, both together are defocus.
    """
    wide = texture(SIZE[1] + 200)
    shift = round(float(stereo_fusion.shift_px(camera, BASELINE_M, np.float64(1.0))))
    columns = np.arange(SIZE[1]) + 100
    pair = [seen(camera, wide[:, columns + s], 1 / 1.1) for s in (0, shift)]
    exact_m = BASELINE_M * geometry.intrinsic_matrix(camera)[0, 0] / shift
    exact = truth(camera, exact_m)
    found = stereo_fusion.figures(pair[0], pair[1], exact, exact, BASELINE_M, 0.4)
    off = abs(1.1 - 1 / exact_m)
    assert found["matched-defocus"] == pytest.approx(off, rel=1e-3)
    assert max(found["stereo-median"], found["matched-combined"]) < 0.1 * off
    assert found["occluded-share"] == pytest.approx(shift / SIZE[1], abs=1 / SIZE[1])
    assert found["occluded-median"] == pytest.approx(off, rel=1e-3) and found["occluded-matched"] < FEW


def test_what_a_near_square_hides_is_occluded(camera):
    """Set-up: a wall at 2 m, before it a strip at 0.5 m. Expectation: a stripe to the strip's left as wide as the
    difference of both disparities, and what leaves the frame at the left, and nothing else.
    """
    shifts = [float(stereo_fusion.shift_px(camera, BASELINE_M, np.float64(z))) for z in (2.0, 0.5)]
    left, right = np.full(SIZE, 2.0), np.full(SIZE, 2.0)
    left[:, 110:130] = 0.5
    moved = np.arange(SIZE[1]) + shifts[1]
    right[:, (moved >= 110) & (moved < 130)] = 0.5
    hidden = stereo_fusion.occluded(truth(camera, left), replace(truth(camera, right)), camera, BASELINE_M)
    columns = np.flatnonzero(hidden.all(axis=0))
    gone = [x for x in range(SIZE[1]) if x < shifts[0] - 0.5 and not 110 <= x < 130]
    shade = shifts[1] - shifts[0]
    assert (hidden.any(axis=0) == hidden.all(axis=0)).all()
    behind = [x for x in columns if x not in gone]
    assert abs(len(behind) - min(shade, 20.0)) <= 2 and max(behind) < 110
