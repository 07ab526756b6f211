"""Patterns off the axis: sums over the stop written out, Huygens's principle, orientation in the picture."""

from __future__ import annotations

import numpy as np
import pytest

from dasim.base.toml import parse
from dasim.camera import geometry, pointspread, stops
from dasim.camera.pupil_pattern import pupil_pattern
from dasim.camera.specification import Camera
from dasim.camera.wavefront import Phase
from dasim.camera.zernike import TERMS
from validation.references.huygens import Bench, intensity

FIELD_PX = (1024.0, 768.0)  # the full frame's corner
RESAMPLED = 0.01  # of the peak; the stop's rim lies between cells of the pupil's grid
PEAK = 0.02  # of the peak; sines of the light's angles are up to 0.5 % below their tangents
TURNED = 1e-3  # of the peak; the rim of a stop is integrated exactly along x and by 16 rows per cell along y
NODES = 3e-3  # of the peak; ten samples per pixel and a profile of 0.05 px on the axis, five nodes beside it
SHAPES = [
    {"shape": "disc", "radius_ratio": 0.46},
    {"shape": "annulus", "inner_ratio": 0.5, "outer_ratio": 0.9},
    {
        "shape": "polygon",
        "corners_ratio": [[-0.6, -0.7], [-0.2, -0.7], [-0.2, 0.3], [0.5, 0.3], [0.5, 0.7], [-0.6, 0.7]],
    },
    {"shape": "mask", "mask": [[0, 0, 0, 0], [0, 1, 0.5, 0], [0, 0, 1, 0], [0, 0, 0, 0]]},
]


def stop_of(da_mobile, shape: dict) -> stops.Stop:
    data = da_mobile.model_dump() | {"stops": [{"name": "only"} | shape]}
    return parse(Camera, data, "camera").stops[0]


@pytest.mark.parametrize("with_phase", [False, True])
@pytest.mark.parametrize("shape", SHAPES, ids=lambda shape: shape["shape"])
def test_pattern_is_the_sum_over_the_stop(da_mobile, shape, with_phase):
    """Set-up: int P exp(2 pi i W rho T rho + i pi rho T u), with coma and a phase step, cell by cell of the stop at
    nine places. Expectation: the same intensities, and unit integral over the plane.
    """
    stop, oblique, waves = stop_of(da_mobile, shape), geometry.foreshortening(da_mobile, FIELD_PX), 0.8
    y, x = np.array([-2.0, 0.1, 1.3]), np.array([-0.7, 0.0, 2.4])
    opening = stop_of(da_mobile, {"shape": "disc", "radius_ratio": 0.3, "centre_ratio": (0.1, 0.0)})
    turns = tuple(0.1 if name == "coma" else 0.0 for name in TERMS)
    phase = Phase(turns, opening, 0.6 + 0.8j) if with_phase else None
    found = pupil_pattern(stop, waves, y, x, phase, oblique)

    transmitted, place = stops.pupil(stop)
    rho = np.stack(np.meshgrid(place, place, indexing="ij"))
    cell = place[1] - place[0]
    light = np.sqrt(transmitted) if shape["shape"] == "mask" else transmitted
    path = waves * np.einsum("iyx,ij,jyx->yx", rho, oblique, rho)
    if phase is not None:
        path = path + 0.1 * np.sqrt(8) * (3 * (rho**2).sum(axis=0) - 2) * rho[1]
    light = light * np.exp(2j * np.pi * path)
    if phase is not None:
        light = light * (1 + (phase.step - 1) * stops.pupil(opening)[0])
    expected = np.empty((3, 3))
    for row, down in enumerate(y):
        for column, across in enumerate(x):
            linear = np.tensordot(oblique @ [down, across], rho, axes=1)
            field = (light * np.exp(1j * np.pi * linear)).sum() * cell**2
            expected[row, column] = np.abs(field) ** 2 / (4 * transmitted.sum() * cell**2)
    expected *= np.linalg.det(oblique)
    np.testing.assert_allclose(found, expected, atol=RESAMPLED * expected.max())
    wide = np.arange(-40, 40, 0.5)
    assert pupil_pattern(stop, waves, wide, wide, phase, oblique).sum() / 4 == pytest.approx(1, abs=0.06)


@pytest.mark.parametrize("depth_m", [0.4, 0.2, 1.5])
def test_pattern_of_the_hole_is_that_of_huygens(da_mobile, depth_m):
    """Set-up: the hole at 730 nm in the full frame's corner, which is 37 degrees from a row, in focus and out of it."""
    hole, half = da_mobile.stops[1], np.arange(-8, 8.1, 0.5)
    image_m, radius_m = geometry.image_distance_m(da_mobile), 0.46 * geometry.aperture_m(da_mobile) / 2
    scale_px = 730e-9 * image_m / geometry.aperture_m(da_mobile) / 1.7e-6  # lambda N of the whole lens
    waves = float(geometry.blur_px(da_mobile, depth_m)) / (8 * scale_px)
    found = pupil_pattern(
        hole, waves, half / scale_px, half / scale_px, None, geometry.foreshortening(da_mobile, FIELD_PX)
    )
    tangent = tuple(value * 1.7e-6 / image_m for value in FIELD_PX)
    expected = intensity(Bench(radius_m, image_m, 0.4, depth_m, tangent), np.array([730.0]), half * 1.7e-6, 48)[0]
    np.testing.assert_allclose(found / found.max(), expected / expected.max(), atol=PEAK)
    axis = pupil_pattern(hole, waves, half / scale_px, half / scale_px)
    assert np.abs(axis / axis.max() - expected / expected.max()).max() > 3 * PEAK


def test_kernels_turn_with_the_field(da_mobile):
    """Expectation: exchanging x and y of the field transposes the kernel, mirroring it mirrors it; the default is the
    middle of the frame, and the axis' kernel is that without a field.
    """
    from dasim.camera import specification as cameras

    def kernel(field_px, camera=da_mobile):
        return pointspread.psf(camera, 0.3, "IR", "D65", size=21, field_px=field_px)

    corner = kernel((900.0, 500.0))
    np.testing.assert_allclose(kernel((500.0, 900.0)), corner.T, atol=TURNED * corner.max())
    np.testing.assert_allclose(kernel((-900.0, 500.0)), corner[:, ::-1], atol=TURNED * corner.max())
    assert np.abs(corner - corner.T).max() > 50 * TURNED * corner.max()
    np.testing.assert_array_equal(kernel(None), kernel((0.0, 0.0)))
    window = cameras.cropped(da_mobile, 64, 48, at_px=(1892, 1244))
    np.testing.assert_array_equal(kernel(None, window), corner)
    assert corner.max() < 0.8 * kernel(None).max()


def test_automatic_frame_holds_the_kernel_of_the_corner(da_mobile):
    """Set-up: 100 nm of coma and astigmatism each in the corner, on the axis none. Expectation: no more light lies
    outside the frame than on the axis, where it is diffraction's alone.
    """
    data = da_mobile.model_dump(mode="json")
    data["lens"]["wavefront_by_field"] = [{"angle_deg": 0.0}, {"angle_deg": 31.0, "coma": 100.0, "astigmatism": 100.0}]
    camera = parse(Camera, data, "camera")
    axis, corner = (pointspread.psf(camera, 0.5, "G", "D65", field_px=at) for at in ((0, 0), FIELD_PX))
    assert 0.98 < axis.sum() < corner.sum() + 0.005 and len(corner) > len(axis)


@pytest.mark.parametrize("field_px", [(1.0, 0.0), (200.0, -100.0)])
def test_kernels_near_the_axis_are_those_of_the_axis(da_mobile, field_px):
    """Rationale: on the axis radial profiles are used, beside it transforms of the pupil. Expectation: the peak differs
    by the areas of patterns, cos^-4, and by the integrals over the pixel.
    """
    angle = np.hypot(*field_px) * 1.7e-6 / geometry.image_distance_m(da_mobile)
    for channel in ("G", "IR"):
        near, axis = (pointspread.psf(da_mobile, 0.25, channel, "D65", size=31, field_px=f) for f in (field_px, None))
        assert np.abs(near - axis).max() < (NODES + 2.5 * angle**2) * axis.max()
