"""Tables of discs and rings: mean weights, places on the stop, and drawing that ends."""

from __future__ import annotations

import numpy as np
import pytest

from dasim.camera import radial_pattern, radiometry
from dasim.render import radial_blur, radial_tables
from dasim.render.wavelengths import draw_density
from dasim.spectra import grid

MEAN_WEIGHT = 0.002  # a million weights of spread 0.3 to 0.8 average to 0.0003 to 0.0008


@pytest.fixture(scope="module")
def blurs(jit, da_mobile):
    """Weights of both stops, with the density of their wavelengths."""
    from dasim.render import wave

    pairs = []
    for stop in da_mobile.stops:
        density = draw_density(radiometry.response(da_mobile), radiometry.stop_response(da_mobile, stop))
        pairs.append((wave.blur(da_mobile, stop, density, 25.0), density))
    return pairs


@pytest.mark.parametrize("averaged", [False, True])
@pytest.mark.parametrize("stop", [0, 1])
@pytest.mark.parametrize(
    ("blur_px", "expected_px", "slope"),
    [
        (0, 0, (0, 0)),
        (1.13, 1.13, (0, 0)),
        (-8, -8, (0, 0)),
        (20, 20, (0, 0)),
        (20, 20, (0.2, -0.1)),
        (-8, -8, (0.0, 0.4)),
        (3.07, 6, (0, 0)),
        (20, 0, (0, 0)),
    ],
)
def test_weights_average_one(blurs, da_mobile, stop, blur_px, expected_px, slope, averaged):
    """Rationale: an even area must not change, and light must not get lost where another depth is met than expected.

    Set-up: a million draws at one depth, aimed at a surface of that depth or another, facing the camera or slanted;
    with the kernels of single wavelengths, and those averaged over nearby ones.
    Expectation: mean weight 1 within 0.002 at the depth that was expected; where another is met, what cannot be drawn
    (light beyond 36 lambda N, 2 / (36 pi^2) = 0.6 %) may lack. rho lies on the stop, and the weighted displacement has
    the mean radius of the kernel within its noise.
    """
    import drjit as dr
    import mitsuba as mi

    blur, density = blurs[stop]
    blur = blur.over_wavelengths() if averaged else blur
    count = 1 << 20
    rng = np.random.default_rng(20)
    cdf = np.cumsum(density) / np.sum(density)
    wavelength = np.interp(rng.random(count), cdf, grid.WAVELENGTH_NM).astype(np.float32)
    numbers = mi.Point2f(rng.random((2, count), dtype=np.float32))
    expected = mi.Float(dr.full(mi.Float, expected_px, count))
    rho, delta, drawn, *_ = blur.draw(numbers, numbers, expected, mi.Vector2f(*slope), mi.UInt32(3))
    u = -delta - rho * (blur_px / 2)
    weight = np.array(
        drawn * blur.weights(u, mi.Float(blur_px), mi.Vector2f(0.0), [mi.Float(wavelength)])[0], dtype=np.float64
    )
    assert float(dr.max(dr.norm(rho))[0]) <= da_mobile.stops[stop].radius_ratio * (1 + 1e-5)
    lost = 0.006 if expected_px != blur_px or any(slope) else 0.0
    assert 1 - lost - MEAN_WEIGHT < weight.mean() < 1 + MEAN_WEIGHT
    assert (weight**2).mean() < (1.7 if not any(slope) else 2.5), "the price in noise is small"


def test_averaged_kernels_have_the_mean_contrast_of_their_wavelengths():
    """Set-up: the pattern of a disc in focus, averaged over wavelengths that differ by up to a fifth.

    Expectation: its MTF at six frequencies, by a Hankel transform, is the mean of the closed form for a disc over
    these wavelengths, within 0.003: light beyond 60 lambda N, 0.3 %, is left out. The plain pattern misses this by
    more than 0.01 at the highest frequency.
    """
    from scipy.special import j0

    radius = np.arange(0.0, 60.0, radial_blur.RADIUS_STEP)
    plain = radial_pattern.wave_profile(radius, np.zeros(1), 0.0)
    averaged = radial_tables.over_wavelengths(plain, radius)
    frequency = np.array([0.2, 0.3, 0.4, 0.6, 0.75, 0.9])  # of 1 / (lambda N)

    def transformed(profile: np.ndarray) -> np.ndarray:
        light = profile[0] * radius
        return j0(2 * np.pi * np.outer(frequency, radius)) @ light / light.sum()

    def disc(frequency: np.ndarray) -> np.ndarray:
        inside = np.minimum(frequency, 1.0)
        return 2 / np.pi * (np.arccos(inside) - inside * np.sqrt(1 - inside**2))

    nearby = 1 + radial_tables.NEARBY * np.linspace(-1, 1, 2001)
    expected = disc(np.multiply.outer(nearby, frequency)).mean(axis=0)
    np.testing.assert_allclose(transformed(averaged), expected, atol=0.003)
    assert abs(transformed(plain) - expected)[-1] > 0.01


def test_thin_ring_far_out_of_focus_is_drawn(jit, da_mobile):
    """Rationale: rho is drawn by rejection; where the blur's hole is wider than the in-focus pattern no rho leads to
    its middle, and drawing would never end. Expectation: it does, with rho on the ring; up to 1 % of the light, which
    diffraction throws into the middle of the hole, is not drawn.
    """
    import drjit as dr
    import mitsuba as mi

    from dasim.camera.stops import Annulus
    from dasim.render import radial_tables

    count, blur_px = 1 << 18, 100.0
    ring = Annulus(name="ring", shape="annulus", inner_ratio=0.9, outer_ratio=1.0)
    blur = radial_tables.tables(da_mobile, ring, [(550.0, 1.0)], 550.0, 110.0)
    numbers = mi.Point2f(np.random.default_rng(2).random((2, count), dtype=np.float32))
    expected = mi.Float(dr.full(mi.Float, blur_px, count))
    rho, delta, drawn, *_ = blur.draw(numbers, numbers, expected, mi.Vector2f(0.0), mi.UInt32(3))
    weight = (
        drawn * blur.weights(-delta - rho * (blur_px / 2), mi.Float(blur_px), mi.Vector2f(0.0), [mi.Float(550.0)])[0]
    )
    radius = np.array(dr.norm(rho))
    assert 0.9 - 1e-5 < radius.min() and radius.max() < 1 + 1e-5
    assert np.array(weight, dtype=np.float64).mean() == pytest.approx(0.995, abs=0.006)
