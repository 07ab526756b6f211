"""Thin-lens geometry and apertures against traced rays and the numbers of the paper."""

from __future__ import annotations

import numpy as np
import pytest

from dasim.base.errors import InputError
from dasim.camera import geometry, radiometry, stops, thin_lens
from dasim.camera import specification as cameras
from dasim.camera.dotted_keys import with_values
from dasim.scene import targets
from dasim.simulation.calibration import calibration_captures
from dasim.spectra import grid as spectra

ROUNDING = 1e-9  # relative, of double precision through a few operations
PAPER_DIGITS = 5e-4  # the paper's percentages have three digits
COATING_EDGES = 0.004  # of the light: coatings have edges of 8 nm, which eq. (1) has not
FIGURE_13_DIGITS = 0.012  # 0.046 has two digits, the others three
F_M, A_M = 3.6e-3, 3.6e-3 / 2.8


def traced_height_m(y_m: float, slope: float, depth_m: float, focal_m: float, image_m: float) -> float:
    """Height on the sensor of a ray that starts at ``y_m`` on an object: ray matrices, no lens equation."""
    travel_in, bend = np.array([[1, depth_m], [0, 1]]), np.array([[1, 0], [-1 / focal_m, 1]])
    travel_out = np.array([[1, image_m], [0, 1]])
    return float((travel_out @ bend @ travel_in @ np.array([y_m, slope]))[0])


@pytest.mark.parametrize("focus_m", [0.05, 0.12, 0.4, 2.0, 1e5])
def test_image_distance_brings_all_rays_of_a_point_together(focus_m):
    """Set-up: a point 1 mm off the axis at the focus distance, rays to many places of the lens."""
    s = thin_lens.image_distance_m(F_M, focus_m)
    heights = [traced_height_m(1e-3, slope, focus_m, F_M, s) for slope in np.linspace(-1, 1, 7) * 1e-3 / focus_m]
    assert np.ptp(heights) < ROUNDING * 1e-3
    assert heights[0] == pytest.approx(-1e-3 * s / focus_m, rel=1e-6), "upside down, magnified by s / d"


@pytest.mark.parametrize("focus_m", [0.12, 0.4])
@pytest.mark.parametrize("depth_m", [0.05, 0.1, 0.119, 0.4, 2.0])
def test_blur_is_what_two_rim_rays_draw(focus_m, depth_m):
    """Set-up: rays from an axial point to the upper and the lower rim of the lens.

    Expectation: their distance on the sensor, with the sign of the side (a near point's rays cross behind the
    sensor, so they have not changed sides).
    """
    s = thin_lens.image_distance_m(F_M, focus_m)
    rim = A_M / 2 / depth_m
    diameter_m = traced_height_m(0, rim, depth_m, F_M, s) - traced_height_m(0, -rim, depth_m, F_M, s)
    blur = thin_lens.blur_diameter_m(depth_m, A_M, s, focus_m)
    assert blur == pytest.approx(diameter_m, rel=1e-9, abs=1e-15)
    assert thin_lens.depth_of_blur_m(diameter_m, A_M, s, focus_m) == pytest.approx(depth_m, rel=1e-9)


def test_levels_span_the_working_range(da_mobile):
    """From 5 cm to 2 m the relative diameter spans 28.7 pixels, the paper's 29 kernels; 52 px of visible blur."""
    camera = cameras.refocused(da_mobile, 2.0)
    relative = (1 - 0.46) * (geometry.blur_px(camera, 0.05) - geometry.blur_px(camera, 2.0))
    assert relative == pytest.approx(28.7, abs=0.05)
    blurs = geometry.level_blur_px(camera)
    assert len(blurs) == 29
    np.testing.assert_allclose(blurs * (1 - 0.46), range(29), atol=1e-12)
    assert blurs[-1] == pytest.approx(52, abs=0.5)
    depths = geometry.depth_of_blur_m(camera, blurs)
    assert depths[0] == pytest.approx(2.0) and 0.05 < depths[-1] < 0.053 and (np.diff(depths) < 0).all()
    np.testing.assert_allclose(geometry.blur_px(camera, depths), blurs, rtol=ROUNDING, atol=1e-9)


def test_a_camera_may_set_its_own_levels(da_mobile):
    """Expectation: levels of its own lie evenly from 0 to the given blur whatever the hole, and scenes follow them."""
    text = {"count": 7, "max_blur_px": 30.0}
    wide = with_values(
        da_mobile.model_copy(update={"levels": cameras.Levels(**text)}), {"stops.hole.radius_ratio": 0.9}
    )
    np.testing.assert_allclose(geometry.level_blur_px(wide), [0, 5, 10, 15, 20, 25, 30])
    board = targets.staircase(wide, 3).objects[0]
    assert geometry.blur_px(wide, board.position_cm[2] / 100) == pytest.approx(15.0)
    with pytest.raises(InputError, match="level 7 is not one of 0 to 6"):
        targets.staircase(wide, 7)
    pictures = calibration_captures(wide, ("A",), frames=1)
    assert {round(picture.blur_px, 9) for picture in pictures} == {0, 5, 10, 15, 20, 25, 30}


@pytest.mark.parametrize(
    ("focal_mm", "error_cm"),
    [(3.6, (0.046, 0.184, 0.735, 2.94, 18.4, 73.5)), (8.0, (0.009, 0.037, 0.149, 0.595, 3.72, 14.9))],
)
def test_figure_13(da_mobile, focal_mm, error_cm):
    """The paper's Fig. 13: depth error of half a pixel of blur, focus at infinity, at 5 cm to 2 m.

    Set-up: the slope of depth over blur from the camera's own two conversions, a hundredth of a pixel apart.
    """
    lens = da_mobile.lens.model_copy(update={"focal_length_mm": focal_mm, "focus_distance_m": 1e6})
    camera = da_mobile.model_copy(update={"lens": lens})
    for depth_m, expected_cm in zip((0.05, 0.1, 0.2, 0.4, 1.0, 2.0), error_cm, strict=True):
        blur = geometry.blur_px(camera, depth_m)
        nearer, farther = geometry.depth_of_blur_m(camera, np.array([blur + 0.005, blur - 0.005]))
        assert (farther - nearer) * 100 * 50 == pytest.approx(expected_cm, rel=FIGURE_13_DIGITS, abs=5e-4)


@pytest.mark.parametrize(
    ("radii", "expected"),
    [
        ((1, 1, 1, 0.46), 0.197),  # the paper's: one pixel of four behind the hole
        ((0.59, 1, 1, 0.59), 0.326),  # Chakrabarti and Zickler: both green pixels of four
        ((0.5, 0.5, 0.5, 0.5), 0.75),  # Bando et al.: three sub-apertures of half the radius
    ],
)
def test_light_loss_is_that_of_equation_1(radii, expected):
    """Expectation: the paper's percentages, and the area that a block of pixels has lost, counted pixel by pixel."""
    reductions = [(radii.count(radius), radius) for radius in set(radii)]
    loss = stops.light_loss(reductions, len(radii))
    assert loss == pytest.approx(expected, abs=PAPER_DIGITS)
    grid = np.linspace(-1, 1, 2001)
    distance = np.hypot(grid[:, None], grid)
    open_area = np.mean([np.count_nonzero(distance <= radius) for radius in radii])
    assert loss == pytest.approx(1 - open_area / np.count_nonzero(distance <= 1), abs=2e-3), "areas counted on a grid"


@pytest.mark.parametrize("alpha", [0.3, 0.46, 0.9])
def test_light_loss_of_a_camera_is_that_of_equation_1(da_mobile, alpha):
    loss = radiometry.light_loss(with_values(da_mobile, {"stops.hole.radius_ratio": alpha}))
    assert loss == pytest.approx((1 - alpha**2) / 4, abs=COATING_EDGES)


def test_a_mosaic_with_fewer_infrared_pixels_loses_less():
    """Expectation: a 4x4 mosaic with two infrared pixels of sixteen loses half as much as one with four."""
    four = cameras.load_camera("da-4x4")
    count = sum(name == "IR" for row in four.sensor.mosaic for name in row)
    pixels = sum(len(row) for row in four.sensor.mosaic)
    assert radiometry.light_loss(four) == pytest.approx((1 - 0.46**2) * count / pixels, abs=COATING_EDGES)


def test_two_sides_of_a_coating_add_up_to_clear_glass():
    """Rationale: a disc with a hole is the open lens below the edge plus the hole above it: nothing is lost."""
    below = stops.Disc(name="open", radius_ratio=1.0, passes_nm=((400, 640),), edge_width_nm=12)
    above = stops.Disc(name="hole", radius_ratio=0.46, passes_nm=((640, 830),), edge_width_nm=12)
    clear = stops.Disc(name="clear", radius_ratio=1.0)
    np.testing.assert_allclose(
        stops.transmittance(below) + stops.transmittance(above), stops.transmittance(clear), atol=1e-12
    )
    assert stops.transmittance(below)[spectra.WAVELENGTH_NM < 600].min() > 0.999
    assert stops.transmittance(above)[spectra.WAVELENGTH_NM > 680].min() > 0.999
