"""Skies: their levels, and how their light is spread."""

from __future__ import annotations

import numpy as np
import pytest

from dasim.scene import lights, panorama
from dasim.scene.lights import Sky, direction
from dasim.spectra import daylight, illuminants

QUADRATURE = 2e-3  # midpoints of 1,024 rows of a map that steps at the horizon


def a_sky(distribution: str, **others) -> Sky:
    return Sky(kind="sky", illuminant="D65", lux=1.0, distribution=distribution, **others)


def test_levels_of_skies():
    """Expectation: level ground under a sky of zenith luminance 1 gets pi (uniform) or 7 pi / 9 (overcast)."""
    for distribution, level in (("uniform", np.pi), ("overcast", 7 * np.pi / 9)):
        irradiance = panorama.irradiance_from_above(panorama.sky(a_sky(distribution)))
        assert irradiance == pytest.approx(level, rel=QUADRATURE)


def test_overcast_is_three_times_as_bright_above():
    values = panorama.sky(a_sky("overcast"))
    assert values[0].mean() / values[panorama.SKY_ROWS // 2 - 1].mean() == pytest.approx(3.0, rel=0.02)
    assert values[panorama.SKY_ROWS // 2 :].max() == 0.0


def test_clear_sky_is_brightest_around_the_sun():
    """Expectation: the brightest of all places at the height of the sun lies at its azimuth, the sky is the same on
    both sides of it, and 90 degrees from the sun it is several times darker.
    """
    values = panorama.sky(a_sky("clear", sun_elevation_deg=40, sun_azimuth_deg=90))
    towards = panorama.directions(panorama.SKY_ROWS)
    row = panorama.SKY_ROWS * 50 // 180
    assert np.dot(towards[row, np.argmax(values[row])], direction(40, 90)) > np.cos(np.radians(1))
    ahead, behind = values[:, panorama.SKY_ROWS + 10], values[:, -11]
    np.testing.assert_allclose(ahead, behind, rtol=1e-9)
    assert values[row].max() > 4 * values[row].min()


def test_daylight_has_the_suns_and_the_skys_own_ratio():
    """Expectation: their levels on level ground add up, in the ratio of the model's illuminances; with them the
    scene's main light has the name of both.
    """
    light = lights.Daylight(kind="daylight", lux=6e4, elevation_deg=25)
    sun, sky = lights.parts(light)  # of black ground
    height = np.sin(np.radians(25))
    assert sun.lux * height + sky.lux == pytest.approx(6e4)
    model = [illuminants.lux(curve) for curve in daylight.sun_and_sky(25)]
    assert sun.lux / sky.lux == pytest.approx(model[0] / model[1])
    assert (sun.illuminant, sky.illuminant, light.illuminant) == ("sun-25deg", "sky-25deg", "daylight-25deg")
