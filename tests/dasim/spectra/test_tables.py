"""Bundled tables of the CIE and others, and the colorimetry made from them, against colour-science."""

from __future__ import annotations

import subprocess
import sys

import colour
import numpy as np
import pytest

from dasim.materials import photographs
from dasim.spectra import colour as colours
from dasim.spectra import colour_checker, grid, illuminants, observer, tables

GRID_NM = grid.WAVELENGTH_NM
OBSERVER = "CIE 1931 2 Degree Standard Observer"
LAMPS = tables.columns(illuminants._LAMP_TABLE)


def on_grid(table: colour.SpectralDistribution) -> np.ndarray:
    return np.interp(GRID_NM, table.wavelengths, table.values)


def test_the_observers_are_those_of_colour_science():
    curves = colour.MSDS_CMFS[OBSERVER]
    for n, values in enumerate(curves.values.T):
        line = np.zeros_like(GRID_NM)
        for at in (0, 70, 140, 215):  # single wavelengths: 400, 540, 680 and 830 nm
            line[:] = 0
            line[at] = 1
            width = grid.integrate(line)
            assert observer.tristimulus(line)[n] == pytest.approx(
                width * np.interp(GRID_NM[at], curves.wavelengths, values)
            )
    assert np.array_equal(
        observer.luminous_efficiency(), on_grid(colour.SDS_LEFS["CIE 1924 Photopic Standard Observer"])
    )


@pytest.mark.parametrize("name", [name for name in LAMPS if name != "wavelength_nm"])
def test_lamps_are_those_of_colour_science(name):
    table = colour.SDS_ILLUMINANTS[f"FL{name[1:]}" if name.startswith("F") else name]
    assert np.array_equal(LAMPS["wavelength_nm"], table.wavelengths)
    assert np.array_equal(LAMPS[name], table.values)


@pytest.mark.parametrize(("name", "cct_k"), illuminants._D_SERIES_CCT_K.items())
def test_daylight_is_that_of_colour_science(name, cct_k):
    """Expectation: the spectrum from the CIE's components, at the chromaticity of the colour temperature, on both sides
    of 7,000 K.
    """
    expected = on_grid(colour.sd_CIE_illuminant_D_series(colour.temperature.CCT_to_xy_CIE_D(cct_k)))
    assert illuminants.illuminant(name) == pytest.approx(expected / illuminants.lux(expected), rel=1e-9)


def test_charts_are_those_of_colour_science():
    for patches, name in ((colour_checker._TABLE, "ColorChecker N Ohta"), (colour_checker._ISO_TABLE, "ISO 17321-1")):
        wavelength_nm, *ours = tables.columns(patches).values()
        for values, table in zip(ours, colour.SDS_COLOURCHECKERS[name].values(), strict=True):
            assert np.array_equal(wavelength_nm, table.wavelengths)
            assert np.array_equal(values, table.values)


def test_primaries_are_those_of_colour_science():
    from colour.recovery import MSDS_BASIS_FUNCTIONS_sRGB_MALLETT2019 as basis

    wavelength_nm, *primaries = tables.columns(photographs._BASIS_TABLE).values()
    assert np.array_equal(wavelength_nm, basis.wavelengths)
    assert np.array_equal(np.stack(primaries), basis.values.T)


def test_the_matrix_to_srgb_is_that_of_colour_science():
    """Set-up: the white of illuminant A. Expectation: colour-science's conversion of colours under it."""
    white = colours.white_xyz(illuminants.illuminant("A"))
    xyz = np.array([[0.3, 0.2, 0.1], [0.1, 0.2, 0.3], white])
    adapt = colour.adaptation.matrix_chromatic_adaptation_VonKries(
        white, colour.xy_to_XYZ(colour.CCS_ILLUMINANTS[OBSERVER]["D65"]), transform="Bradford"
    )
    expected = xyz @ (colour.RGB_COLOURSPACES["sRGB"].matrix_XYZ_to_RGB @ adapt).T
    assert xyz @ colours.to_srgb_matrix(white).T == pytest.approx(expected, abs=1e-12)


@pytest.mark.parametrize("temperature_k", [1000, 1500, 2856, 4000, 6500, 12_000, 25_000])
def test_the_colour_temperature_of_a_blackbody_is_its_own(temperature_k):
    assert observer.cct_k(observer.planckian(temperature_k)) == pytest.approx(temperature_k, rel=1e-5)


@pytest.mark.parametrize("name", ["F2", "F7", "F11", "LED-B3", "LED-RGB1", "sun-10deg", "sky-60deg"])
def test_colour_temperatures_are_those_of_colour_science(name):
    """Expectation: Ohno's method (2013) at the chromaticity of the same spectrum, with the whole observer for the
    blackbodies. Our grid begins at 400 nm for both: 2 % at 12,000 K, less where there is less blue.
    """
    power = illuminants.illuminant(name)
    expected = colour.temperature.XYZ_to_CCT_Ohno2013(observer.tristimulus(power))[0]
    assert observer.cct_k(power) == pytest.approx(expected, rel=2e-6 * expected)


def test_a_capture_does_not_load_colour_science():
    """Rationale: it takes 1.5 s and 170 MB of each process of a dataset."""
    code = (
        "import sys, dasim; scene = dasim.random_scene(1, 0); camera = dasim.cropped('da-mobile', 16, 12);"
        "dasim.simulate(scene, dasim.focused(camera, scene), spp=1);"
        "print([name for name in ('colour', 'pandas', 'matplotlib') if name in sys.modules])"
    )
    found = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
    assert found.strip() == "[]"
