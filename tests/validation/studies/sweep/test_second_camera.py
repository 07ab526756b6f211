"""A second camera: where it stands, which pixels it does not see, and the errors that the study compares."""

from __future__ import annotations

import numpy as np
import pytest

from dasim.camera import geometry
from dasim.camera import specification as cameras
from dasim.scene.specification import world_to_camera
from dasim.values import Reconstruction
from tests.recon.depth.test_stereo_fusion import BASELINE_M, FEW, FOCUS_M, SIZE, coloured, scale, texture
from tests.support import surfaces
from validation.studies.sweep import second_camera


@pytest.fixture(scope="module")
def camera(da_mobile):
    return cameras.cropped(cameras.refocused(da_mobile, FOCUS_M), SIZE[1], SIZE[0])


def truth(camera, depth_m):
    level = geometry.blur_px(camera, np.broadcast_to(depth_m, SIZE)) / geometry.level_blur_px(camera)[1]
    return surfaces.truth(camera, level, np.ones((*SIZE, 4)))


def level_depth_m(camera):
    return geometry.depth_of_blur_m(camera, geometry.level_blur_px(camera))


def reconstruction_of(camera, picture, depth_m) -> Reconstruction:
    colours = coloured(picture)
    depth = np.broadcast_to(np.float32(depth_m), SIZE).copy()
    ones = np.ones(SIZE, np.float32)
    return Reconstruction(
        rgb=colours, sharp_rgb=colours, linear_e=colours, sharp_e=colours, ir_e=ones, level_raw=ones, level=ones,
        depth_m=depth, confidence=ones, camera=camera, light="D55", settings={}, timings_s={},
    )  # fmt: skip


def test_the_second_camera_stands_to_the_right(make_scene):
    """Expectation: a point keeps its z and moves to the left by the baseline, whichever way the first one looks."""
    view = {"position_cm": (3, -2, 5), "look_at_cm": (10, 4, 60)}
    scene = make_scene(
        {"name": "ball", "shape": "sphere", "radius_cm": 1, "position_cm": (0, 0, 40), "material": "white-paper"},
        view=view,
    )
    point = np.array([0.1, 0.05, 0.6, 1.0])
    first, second = (world_to_camera(s) @ point for s in (scene, second_camera.other_view(scene, BASELINE_M)))
    np.testing.assert_allclose(second - first, [-BASELINE_M, 0, 0, 0], atol=1e-12)


def test_figures_compare_where_a_point_is_matched(camera):
    """Set-up: a board at 1 m that defocus puts 0.1 dioptres off; the right picture by its disparity.

    Expectation: stereo and both are within a tenth of defocus's error where there is a match; at the left edge, which
    the other camera does not see, both together are defocus.
    """
    wide = texture(SIZE[1] + 200)
    shift = round(scale(camera) / 1.0)
    columns = np.arange(SIZE[1]) + 100
    pair = [reconstruction_of(camera, wide[:, columns + s], 1 / 1.1) for s in (0, shift)]
    exact_m = scale(camera) / shift
    exact = truth(camera, exact_m)
    figures = second_camera.errors(*pair, exact, exact, BASELINE_M, level_depth_m(camera))
    off = abs(1.1 - 1 / exact_m)
    assert figures["matched-defocus"] == pytest.approx(off, rel=1e-3)
    assert max(figures["stereo-median"], figures["matched-combined"]) < 0.1 * off
    assert figures["occluded-share"] == pytest.approx(shift / SIZE[1], abs=1 / SIZE[1])
    assert figures["occluded-median"] == pytest.approx(off, rel=1e-3) and figures["occluded-matched"] < FEW


def test_what_a_near_square_hides_is_occluded(camera):
    """Set-up: a wall at 2 m, before it a strip at 0.5 m. Expectation: a stripe to the strip's left as wide as the
    difference of both disparities, and what leaves the frame at the left, and nothing else.
    """
    shifts = [scale(camera) / z for z in (2.0, 0.5)]
    left, right = np.full(SIZE, 2.0), np.full(SIZE, 2.0)
    left[:, 110:130] = 0.5
    moved = np.arange(SIZE[1]) + shifts[1]
    right[:, (moved >= 110) & (moved < 130)] = 0.5
    hidden = second_camera.occluded(truth(camera, left), truth(camera, right), camera, BASELINE_M)
    columns = np.flatnonzero(hidden.all(axis=0))
    gone = [x for x in range(SIZE[1]) if x < shifts[0] - 0.5 and not 110 <= x < 130]
    shade = shifts[1] - shifts[0]
    assert (hidden.any(axis=0) == hidden.all(axis=0)).all()
    behind = [x for x in columns if x not in gone]
    assert abs(len(behind) - min(shade, 20.0)) <= 2 and max(behind) < 110
