"""Geometry of a camera against two rays through the lens, and against the definitions of its quantities."""

from __future__ import annotations

import numpy as np
import pytest

from dasim.camera import geometry, specification
from dasim.spectra import grid

DEPTH_M = np.array([0.05, 0.1, 0.2, 0.39, 0.4, 0.41, 1.0, 50.0])


def rim_ray_px(camera: specification.Camera, depth_m: float) -> float:
    """Where the ray from a point on the axis through the lens's upper rim meets the sensor, pixels from the axis.

    A thin lens turns a ray at height y by -y / f. Upwards is positive.
    """
    lens, rim_m = camera.lens, camera.lens.focal_length_mm * 1e-3 / camera.lens.f_number / 2
    focal_m = lens.focal_length_mm * 1e-3
    sensor_m = 1 / (1 / focal_m - 1 / lens.focus_distance_m)
    slope = rim_m / depth_m - rim_m / focal_m
    return (rim_m + slope * sensor_m) / (camera.sensor.pixel_pitch_um * 1e-6)


def test_blur_is_what_the_rays_of_both_rims_span(da_mobile):
    """Expectation: twice the rim ray's distance from the axis; a point nearer than the focus is still above the axis
    where the ray through the upper rim meets the sensor, hence positive.
    """
    traced = [2 * rim_ray_px(da_mobile, depth) for depth in DEPTH_M]
    np.testing.assert_allclose(geometry.blur_px(da_mobile, DEPTH_M), traced, rtol=1e-9, atol=1e-9)


def test_depth_of_a_blur_inverts_it(da_mobile):
    np.testing.assert_allclose(geometry.depth_of_blur_m(da_mobile, geometry.blur_px(da_mobile, DEPTH_M)), DEPTH_M)


def test_blur_beside_the_focus_by_axial_colour_is_that_of_a_shifted_lens(da_mobile):
    """Set-up: a lens longer by 20 um at all wavelengths. Expectation: the blur of a point in focus, traced through
    the longer lens onto the same sensor.
    """
    lens = da_mobile.lens
    shifted = da_mobile.model_copy(update={"lens": lens.model_copy(update={"focal_shift_um": ((400, 20), (830, 20))})})
    focal_m, rim_m = lens.focal_length_mm * 1e-3, geometry.aperture_m(da_mobile) / 2
    sensor_m = 1 / (1 / focal_m - 1 / lens.focus_distance_m)
    slope = rim_m / lens.focus_distance_m - rim_m / (focal_m + 20e-6)
    traced = 2 * (rim_m + slope * sensor_m) / (da_mobile.sensor.pixel_pitch_um * 1e-6)
    expected = np.full(grid.WAVELENGTH_NM.shape, traced)
    np.testing.assert_allclose(geometry.chromatic_blur_px(shifted), expected, rtol=1e-9)


def test_levels_are_a_pixel_of_relative_diameter_apart(da_mobile):
    """Expectation: visible minus infrared blur, (1 - alpha) c, is the level's number; alpha is the hole's ratio."""
    blur = geometry.level_blur_px(da_mobile)
    np.testing.assert_allclose(blur - 0.46 * blur, np.arange(29), atol=1e-9)


def test_levels_behind_the_focus_end_before_infinity(da_mobile):
    """Set-up: focus at 20 cm, so that infinity has the blur A s / (p d_f), and at 2 m, where it is below one level.

    Expectation: whole levels up to there with axial colour of 15 um, none for a lens as short at all wavelengths.
    """
    lens = da_mobile.lens
    for focus_m, shift, levels in ((0.2, 15, 7), (2.0, 15, 0), (0.2, 0.1, 0)):
        update = {"focus_distance_m": focus_m, "focal_shift_um": ((500.0, 0.0), (750.0, shift))}
        camera = da_mobile.model_copy(update={"lens": lens.model_copy(update=update)})
        infinity_px = geometry.aperture_m(camera) * geometry.image_distance_m(camera) / focus_m / 1.7e-6
        blur = geometry.behind_blur_px(camera)
        np.testing.assert_allclose(blur, -np.arange(levels + 1) / 0.54, atol=1e-9)
        assert -blur[-1] < infinity_px
        assert shift < 1 or infinity_px <= (levels + 1) / 0.54


def test_intrinsic_matrix_projects_as_the_pinhole_does(da_mobile):
    """Expectation: similar triangles, x s / (z p) pixels from the middle of the frame."""
    sensor_m = 1 / (1 / 3.6e-3 - 1 / da_mobile.lens.focus_distance_m)
    place = geometry.intrinsic_matrix(da_mobile) @ (0.03, -0.02, 0.5)
    middle = (da_mobile.sensor.width_px / 2, da_mobile.sensor.height_px / 2)
    expected = np.array([0.03, -0.02]) / 0.5 * sensor_m / 1.7e-6 + middle
    np.testing.assert_allclose(place[:2] / place[2], expected)


@pytest.mark.parametrize("ratio", [0.3, 0.8])
def test_hole_ratio_is_that_of_the_smallest_stop(da_mobile, ratio):
    visible, hole = da_mobile.stops
    stops = (hole.model_copy(update={"radius_ratio": ratio}), visible)
    assert geometry.hole_ratio(da_mobile.model_copy(update={"stops": stops})) == pytest.approx(ratio)
