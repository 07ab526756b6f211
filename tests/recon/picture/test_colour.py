"""White balance and colour, compared with colour-science's colorimetry instead of the pipeline's own."""

import numpy as np
import pytest

from dasim.camera import noise, radiometry, specification
from dasim.camera.crosstalk import electronic_crosstalk
from dasim.spectra import grid as spectra
from dasim.spectra import illuminants
from dasim.spectra.colour import exposure_scale, to_srgb
from dasim.values import Capture
from recon.picture import colour, mosaic
from tests.support import recon_scenes

# The camera's dyes are no linear combinations of the eye's: a matrix leaves 2-3 units for such sensors.
MEAN_COLOUR_DIFFERENCE = 3.5


def white_capture(light):
    """A noisy grey ramp under a light, exposed to 80 % of the full well in its brightest channel."""
    camera = recon_scenes.da_mobile(256, 192)
    signal = spectra.integrate(radiometry.response(camera) * illuminants.illuminant(light))
    ramp = np.linspace(0.1, 0.8, 256)[None, :, None] * np.ones((192, 1, 1))
    raw, _ = noise.expose(
        electronic_crosstalk(noise.mosaic(6000 * ramp * signal / signal.max(), camera), camera), camera.sensor, 0.01, 0
    )
    return Capture(raw, camera, 0.01, 1.0, 0)


@pytest.mark.parametrize("light", ["D65", "A"])
def test_white_balance_selects_the_light_of_a_grey_scene(light):
    capture, bank = white_capture(light), recon_scenes.bank()
    electrons, saturated = mosaic.linearise(capture)
    estimate = colour.choose_light(electrons, saturated, capture.camera, bank.lights, bank.signature)
    assert bank.lights[estimate] == light


@pytest.mark.parametrize("light", ["D65", "A"])
def test_white_stays_white(light):
    camera = recon_scenes.da_mobile(256, 192)
    electrons = spectra.integrate(radiometry.response(camera) * illuminants.illuminant(light))
    visible = electrons[:3] - specification.crosstalk(camera) * electrons[3]
    linear = colour.colour_matrix(camera, light) @ visible
    np.testing.assert_allclose(linear / linear[1], 1, atol=1e-3)


@pytest.mark.parametrize("light", ["D65", "A"])
def test_colour_checker(light):
    """CIEDE2000 of the 24 patches between the sRGB of the pipeline and of colour-science, with white at equal
    luminance.
    """
    import colour as science

    camera = recon_scenes.da_mobile(256, 192)
    grid = spectra.WAVELENGTH_NM
    patches = science.SDS_COLOURCHECKERS["ISO 17321-1"].values()
    reflectance = np.stack([np.interp(grid, sd.wavelengths, sd.values) for sd in patches])
    power = illuminants.illuminant(light)
    electrons = spectra.integrate(reflectance[:, None, :] * radiometry.response(camera) * power)
    white = spectra.integrate(radiometry.response(camera) * power)
    visible = (electrons[:, :3] - specification.crosstalk(camera) * electrons[:, 3:]).astype(np.float32)
    scale = 1 / (white[1] - specification.crosstalk(camera)[1] * white[3])
    srgb = to_srgb(visible[None], colour.colour_matrix(camera, light), scale)[0]

    observer = science.MSDS_CMFS["CIE 1931 2 Degree Standard Observer"]
    curves = np.stack([np.interp(grid, observer.wavelengths, c, right=0) for c in observer.values.T])
    xyz = spectra.integrate(reflectance[:, None] * power * curves)
    xyz_white = spectra.integrate(power * curves)
    d65 = science.xy_to_XYZ(science.CCS_ILLUMINANTS["CIE 1931 2 Degree Standard Observer"]["D65"])
    adapted = science.chromatic_adaptation(xyz / xyz_white[1], xyz_white / xyz_white[1], d65, method="Von Kries")
    exact_lab = science.XYZ_to_Lab(adapted)
    lab = science.XYZ_to_Lab(science.sRGB_to_XYZ(srgb))
    assert science.delta_E(lab, exact_lab, method="CIE 2000").mean() < MEAN_COLOUR_DIFFERENCE


def test_exposure_puts_the_99th_percentile_at_its_place():
    """Display exposure maps the 99th percentile of the luminance of a neutral ramp to 0.9, by definition."""
    camera = recon_scenes.da_mobile(256, 192)
    matrix = colour.colour_matrix(camera, "D65")
    white = np.linalg.solve(matrix, np.ones(3))
    linear = (np.linspace(0, 5000, 10_001)[None, :, None] * white).astype(np.float32)
    scale = exposure_scale(linear, matrix)
    srgb = to_srgb(linear, matrix, scale)
    np.testing.assert_allclose(srgb[0, 9900], 1.055 * 0.9 ** (1 / 2.4) - 0.055, atol=2e-3)
    assert srgb.min() >= 0 and srgb.max() <= 1


def test_no_light_gives_no_scale():
    black = np.zeros((4, 4, 3), np.float32)
    matrix = np.eye(3)
    assert exposure_scale(black, matrix) == 0
    assert not to_srgb(black, matrix, 0.0).any()
