"""Kernels that few nodes cannot integrate: fine patterns, many waves of defocus, polygons without diffraction."""

from __future__ import annotations

import numpy as np
import pytest

from dasim.base.toml import parse
from dasim.camera import geometry, pointspread
from dasim.camera.pointspread import psf, radial_profiles
from dasim.camera.specification import Camera
from dasim.spectra.grid import CHANNELS
from dasim.spectra.illuminants import illuminant

OPEN = {"name": "open", "radius_ratio": 1.0}


def changed(camera, stops, **tables):
    """The camera with other stops, and with other values in tables such as ``lens``."""
    data = camera.model_dump(mode="json") | {"stops": stops, "levels": None}
    return parse(Camera, data | {name: data[name] | values for name, values in tables.items()}, "test")


def test_a_tiny_wavefront_error_of_an_annulus_changes_nothing(da_mobile):
    """Expectation: the hole of the annulus stays closed where its amplitude has a phase."""
    ring = {"name": "ring", "shape": "annulus", "inner_ratio": 0.6, "outer_ratio": 1.0}
    plain, aberrated = (changed(da_mobile, stops=[ring | more]) for more in ({}, {"wavefront_nm": {"spherical": 1e-6}}))
    np.testing.assert_allclose(psf(aberrated, 0.12, "G", "D65"), psf(plain, 0.12, "G", "D65"), atol=1e-8)


@pytest.mark.parametrize("depth_m", [0.5, 0.2])
@pytest.mark.parametrize("channel", ["G", "IR"])
def test_pixels_hold_the_integral_of_the_profile(da_mobile, depth_m, channel):
    """Set-up: a point off the centre of a pixel, in focus and out of it; 20 Gauss-Legendre nodes per pixel and axis, at
    each of which the profile is computed. Expectation: the kernel to 2e-4 of its peak.
    """
    size, offset = 15, (0.23, -0.41)
    place, weight = np.polynomial.legendre.leggauss(20)
    fine = (np.arange(size)[:, None] + (place + 1) / 2).ravel() - size / 2
    radius = np.hypot(fine[:, None] - offset[0], fine[None, :] - offset[1])
    blur = np.array([geometry.blur_px(da_mobile, depth_m)])
    profiles, _ = radial_profiles(da_mobile, blur, illuminant("D65"), radius.ravel())
    nodes = profiles[0, CHANNELS.index(channel)].reshape(size, 20, size, 20)
    expected = np.einsum("iajb,a,b", nodes, weight / 2, weight / 2)
    kernel = psf(da_mobile, depth_m, channel, "D65", offset_px=offset, size=size)
    np.testing.assert_allclose(kernel / expected.max(), expected / expected.max(), atol=2e-4)


def test_kernels_of_masks_have_nodes_enough(monkeypatch):
    """Set-up: a coded aperture in focus and out of it, with the bundled number of nodes and with 14 per pixel and axis.
    Expectation: the kernel to 3e-4 of its peak.
    """
    for depth_m in (0.5, 0.2):
        few = psf("coded-mobile", depth_m, "G", "D65", size=15)
        with monkeypatch.context() as patch:
            patch.setattr(pointspread, "PIXEL_NODES", 14)
            many = psf("coded-mobile", depth_m, "G", "D65", size=15)
        assert not np.array_equal(few, many)
        np.testing.assert_allclose(few / many.max(), many / many.max(), atol=3e-4)


@pytest.mark.parametrize("field_px", [(0, 0), (100, 0)])
@pytest.mark.parametrize(("pitch_um", "f_number"), [(3.45, 2.0), (5.0, 1.4)])
def test_patterns_much_finer_than_a_pixel_hold_all_the_light(da_mobile, pitch_um, f_number, field_px):
    """Set-up: lambda N of 0.11 to 0.26 pixels at 400 nm, in focus. Expectation: the light within 21 px, 98 to 100 %."""
    lens = {"focal_length_mm": 12, "f_number": f_number, "focus_distance_m": 2}
    camera = changed(da_mobile, lens=lens, sensor={"pixel_pitch_um": pitch_um}, stops=[OPEN])
    for channel in "BR":
        assert 0.98 < psf(camera, 2.0, channel, "D65", field_px=field_px, size=21).sum() < 1.002, channel


@pytest.mark.parametrize("corners", [0, 6])
def test_many_waves_of_defocus_hold_all_the_light(da_mobile, corners):
    """Set-up: 60 to 90 waves of defocus, of a disc and of a hexagon. Expectation: 98 to 101 % of the light, and for
    the disc a quarter of it within half the radius.
    """
    turn = 2 * np.pi * np.arange(corners) / max(corners, 1)
    shape = {"shape": "polygon", "corners_ratio": np.stack([np.cos(turn), np.sin(turn)], 1).tolist()} if corners else {}
    lens = {"focal_length_mm": 25, "f_number": 2.0, "focus_distance_m": 2}
    stop = {"name": "open", **shape} if corners else OPEN
    camera = changed(da_mobile, lens=lens, sensor={"pixel_pitch_um": 5.0}, stops=[stop])
    kernel = psf(camera, 0.95, "G", "D65")
    assert 0.98 < kernel.sum() < 1.01
    if not corners:
        radius = np.hypot(*(np.indices(kernel.shape) - len(kernel) // 2))
        blur = abs(geometry.blur_px(camera, 0.95))
        assert kernel[radius < blur / 4].sum() == pytest.approx(0.25, abs=0.02)


def test_geometric_blur_of_a_polygon_is_even(da_mobile):
    """Rationale: points of a pupil, counted by pixels, beat with them."""
    turn = np.pi / 3 * np.arange(6)
    corners = np.stack([np.cos(turn), np.sin(turn)], 1).tolist()
    camera = changed(da_mobile, stops=[{"name": "open", "shape": "polygon", "corners_ratio": corners}])
    kernel = psf(camera, 0.05, "G", "D65", diffraction="off")
    middle = len(kernel) // 2
    inner = kernel[middle - 8 : middle + 9, middle - 8 : middle + 9]
    np.testing.assert_allclose(inner, inner.mean(), rtol=1e-3)
    assert kernel.sum() == pytest.approx(1, abs=1e-6)
