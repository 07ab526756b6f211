"""Interpolation of the infrared plane on the mosaic's own grid, and its removal from the colours."""

import numpy as np
import pytest

from dasim.camera.radiometry import response
from dasim.spectra import grid, illuminants
from recon.picture import infrared
from recon.settings import PAPER
from tests.support import recon_scenes

PHASES = [(0, 0), (0, 1), (1, 0), (1, 1)]
BORDER = 4
# Relative to the visible light. Eq. (8) is exact for equal photons per wavelength, up to the edges of the filters at
# 650 nm: red gains 1.9 % of light that the open lens still passes beyond, and loses the 0.7 % of its visible light that
# the infrared pixel sees. D65 and A are no such light: their ratios of the channels from 650 to 810 nm differ from
# eq. (8) by up to 12 % (blue under A), which is 2.6 % of the visible blue.
EDGES, SPECTRA = 0.015, 0.03


def sampled(function, phase, shape=(48, 64)):
    y, x = np.indices(shape, dtype=float)
    image = function(y, x)
    return image, image[phase[0] :: 2, phase[1] :: 2].astype(np.float32)


@pytest.mark.parametrize("phase", PHASES)
def test_a_ramp_stays_where_it_is(phase):
    """Cubic convolution reproduces a line exactly; a shift of half a pixel would change it by half its slope."""
    image, plane = sampled(lambda y, x: 3 * y - 2 * x + 100, phase)
    inner = slice(BORDER, -BORDER)
    np.testing.assert_allclose(infrared.interpolate(plane, phase)[inner, inner], image[inner, inner], atol=1e-3)


@pytest.mark.parametrize("phase", PHASES)
def test_a_shifted_pattern_comes_out_at_its_place(phase):
    """A sinusoid with a period of 16 px, shifted by 0.3 px, keeps its phase within 0.01 px (cubic error: (2/16)^3)."""
    frequency = 1 / 16
    for axis in (0, 1):
        _, plane = sampled(lambda y, x: np.cos(2 * np.pi * frequency * ((y, x)[axis] - 0.3)), phase)  # noqa: B023
        result = infrared.interpolate(plane, phase)
        line = result[16:32, 16:48].mean(axis=1) if axis == 0 else result[16:32, 16:48].mean(axis=0)
        place = np.arange(16, 16 + len(line))
        angle = -np.angle(np.sum(line * np.exp(-2j * np.pi * frequency * place)))
        assert abs(angle / (2 * np.pi * frequency) - 0.3) < 0.01


@pytest.mark.parametrize("phase", PHASES)
def test_samples_stay_as_they_are(phase):
    plane = np.random.default_rng(1).uniform(0, 100, (12, 10)).astype(np.float32)
    np.testing.assert_allclose(infrared.interpolate(plane, phase)[phase[0] :: 2, phase[1] :: 2], plane, rtol=1e-6)


@pytest.mark.parametrize(("light", "residual"), [("equal photons", EDGES), ("D65", SPECTRA), ("A", SPECTRA)])
def test_removal_leaves_the_visible_light_of_each_light(light, residual):
    """In a white scene, eq. (7) leaves the light below 650 nm in R, G and B, up to ``residual``."""
    camera = recon_scenes.da_mobile(512, 384)
    visible = grid.WAVELENGTH_NM < grid.NEAR_INFRARED_NM[0]
    spectrum = 1 / grid.WAVELENGTH_NM if light == "equal photons" else illuminants.illuminant(light)
    power = response(camera) * spectrum
    electrons, expected = grid.integrate(power), grid.integrate(power * visible)[:3]
    image = np.tile(electrons / electrons[1] * 1000, (4, 4, 1)).astype(np.float32)
    clean = infrared.separate(image, infrared.separation(camera, light, PAPER))
    np.testing.assert_allclose(clean[0, 0], expected / electrons[1] * 1000, rtol=residual)
