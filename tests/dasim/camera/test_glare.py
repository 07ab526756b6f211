"""Veiling glare: its kernel, the sum of light, and a small source through `dasim.simulate` and `dasim.psf`."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import integrate
from scipy.special import j0

import dasim
from dasim.base.errors import InputError
from dasim.base.toml import parse
from dasim.camera import geometry, glare, radiometry
from dasim.camera.specification import Camera
from dasim.spectra import grid, illuminants

ROUNDING = 1e-12
SHARE = 0.1
VEIL = 0.002  # the paper's colour and the tails of diffraction beyond the circle


def hazy(camera: Camera, share: float, radius_mm: float | None = None) -> Camera:
    data = camera.model_dump(mode="json")
    data["stops"][1] |= {"glare_share": share, "glare_radius_mm": radius_mm}
    return parse(Camera, data, "hazy")


def test_veil_is_the_light_of_a_diffuser_in_a_mirror():
    """Set-up: a point of a diffuser sends its light to a plane 2 s away by the cosines of both ends over the square of
    the path. Expectation: the veil's density; half of it within R = 2 s; unit integral.
    """
    radius = np.array([0.0, 3.0, 10.0, 40.0])
    path = np.hypot(radius, 10.0)
    np.testing.assert_allclose(glare.veil(radius, 10.0), (10.0 / path) ** 2 / (np.pi * path**2), rtol=ROUNDING)
    for end, share in ((10.0, 0.5), (1e6, 1.0)):
        light = integrate.quad(lambda r: 2 * np.pi * r * glare.veil(r, 10.0), 0, end, points=[10, 100], limit=500)[0]
        assert light == pytest.approx(share, abs=1e-8)


def mirrored(size: int, radius: float) -> np.ndarray:
    """Veil of a point in the middle of a frame with its nearest mirror images."""
    place = np.arange(size) - (size - 1) / 2
    images = [(size * i, size * k) for i in range(-9, 10) for k in range(-9, 10)]
    return np.sum([glare.veil(np.hypot(place[:, None] - y, place - x), radius) for y, x in images], axis=0)


def through_hole(camera: Camera, channel: int) -> float:
    """Share of a channel's light that passes the hole, D65 on an even surface."""
    light = [radiometry.stop_response(camera, stop)[channel] * illuminants.illuminant("D65") for stop in camera.stops]
    return float(grid.integrate(light[1]) / grid.integrate(sum(light)))


def test_spread_is_the_veil():
    """Set-up: a point in the middle of a frame ten times as wide as the veil. Expectation: the veil around it, plus
    what its mirror images beyond the frame send back; its transfer by a Hankel integral.
    """
    picture = np.zeros((401, 401, 1))
    picture[200, 200] = 1.0
    veiled = glare.spread(picture, 1.0, 15.0)[..., 0]
    place = np.arange(401) - 200.0
    expected = sum(
        glare.veil(np.hypot(place[:, None] - 401 * i, place - 401 * k), 15.0)
        for i in range(-9, 10)
        for k in range(-9, 10)
    )
    np.testing.assert_allclose(veiled, expected, atol=2e-7)
    wave = np.cos(2 * np.pi * 2 / 401 * place)
    transfer = integrate.quad(
        lambda r: 2 * np.pi * r * glare.veil(r, 15.0) * j0(2 * np.pi * 2 / 401 * r), 0, 4000, limit=2000
    )[0]
    assert (veiled.sum(axis=0) * wave).sum() == pytest.approx(transfer, abs=2e-3)


def test_light_is_kept_and_even_pictures_stay_even():
    """Expectation: the sum of any picture, and every pixel of an even one, to rounding."""
    picture = np.random.default_rng(4).random((30, 44, 4))
    for radius in (12.0, 4000.0):
        np.testing.assert_allclose(
            glare.spread(picture, 0.3, radius).sum(axis=(0, 1)), picture.sum(axis=(0, 1)), rtol=ROUNDING
        )
        np.testing.assert_allclose(glare.spread(np.ones((9, 16, 2)), 0.3, radius), 1.0, rtol=ROUNDING)


@pytest.mark.slow
def test_small_source_in_a_capture(da_mobile, make_scene, lamp, jit):
    """Set-up: a bright disc of 2 px before nothing, with and without glare of 10 %, the same random numbers.

    Expectation: each channel's sum stays; far from the source is the share of the veil there, times the channel's share
    of light through the hole.
    """
    camera = dasim.refocused(dasim.cropped(da_mobile, 96, 96), 0.3)
    radius_cm = 2 * 1.7e-6 * 0.3 / geometry.image_distance_m(camera) * 100
    disc = {"name": "spot", "shape": "disc", "radius_cm": radius_cm, "position_cm": (0, 0, 30)}
    scene = make_scene(disc | {"material": "white-paper"}, lights=[lamp])
    exposure = dasim.Exposure(time_s=0.01)
    plain, veiled = (
        dasim.simulate(scene, hazy(camera, share, 0.05), spp=64, exposure=exposure).truth for share in (0.0, SHARE)
    )
    sums = [truth.mean_e.sum(axis=(0, 1), dtype=np.float64) for truth in (veiled, plain)]  # single precision loses 1e-5
    np.testing.assert_allclose(*sums, rtol=1e-6)
    away = np.hypot(*(np.indices((96, 96)) - 47.5)) > 30
    far = [truth.mean_e[away].sum(axis=0) / truth.mean_e.sum(axis=(0, 1)) for truth in (plain, veiled)]
    outside = SHARE * float(mirrored(96, 0.05 / 1.7e-3)[away].sum())
    for channel in range(4):
        expected = outside * through_hole(camera, channel)
        assert far[1][channel] - (1 - SHARE) * far[0][channel] == pytest.approx(expected, abs=VEIL)
    assert outside > 0.4 * SHARE


def test_psf_has_the_veil(da_mobile):
    """Expectation: IR's kernel far from its middle has the veil, times the share; the default radius is 2 s."""
    plain, veiled = (dasim.psf(hazy(da_mobile, share, 0.2), 0.4, "IR", "D65", size=121) for share in (0.0, SHARE))
    corner = np.hypot(60, 60) * 1.7e-3
    expected = SHARE * (1.7e-3 / 0.2) ** 2 / np.pi / (1 + (corner / 0.2) ** 2) ** 2
    expected *= through_hole(da_mobile, 3)
    assert veiled[0, 0] - (1 - SHARE) * plain[0, 0] == pytest.approx(expected, rel=0.01)
    assert glare.radius_px(da_mobile, da_mobile.stops[1]) == pytest.approx(2 * 3.6 / (1 - 3.6 / 400) / 1.7e-3)


@pytest.mark.parametrize(("key", "value"), [("glare_share", 0.9), ("glare_radius_mm", 0.001)])
def test_refused_keys(da_mobile, key, value):
    data = da_mobile.model_dump(mode="json")
    data["stops"][1] |= {key: value}
    with pytest.raises(InputError, match=rf"stops\.hole\.{key}: must be") as problem:
        parse(Camera, data, "camera.toml")
    assert "\n" not in str(problem.value)


def test_veil_narrower_than_the_pixels_is_refused(da_mobile):
    """Rationale: a transfer function that has not decayed at the Nyquist frequency rings, with light below zero."""
    data = hazy(da_mobile, SHARE, 0.02).model_dump(mode="json")
    data["sensor"]["pixel_pitch_um"] = 10.0
    with pytest.raises(InputError, match=r"stops\.hole\.glare_radius_mm: must be at least 3 pixels \(is 2\)"):
        parse(Camera, data, "camera.toml")
    point = np.zeros((65, 65, 1))
    point[32, 32] = 1.0
    assert glare.spread(point, SHARE, 3.0).min() > -1e-6
    assert glare.spread(point, SHARE, 1.0).min() < -1e-5
