"""Named reflectances against published values and measured curves, also in the near-infrared."""

from __future__ import annotations

import colour
import numpy as np
import pytest

from dasim.materials import reflectances
from dasim.materials.reflectances import curve
from dasim.spectra import colour_checker, illuminants
from dasim.spectra.grid import WAVELENGTH_NM

LEAF_LIMIT = 0.03  # absolute; spread between leaves is larger (PROSPECT's range at 550 nm is 0.05 to 0.25)
OPEN = 0.97  # of the paper, from 740 nm: cyan's tail
INK_COLOUR_LIMIT = 8.0  # CIELAB; the standard's own paper and ink differ by 5, ours are logistic edges
NEAR_INFRARED = (WAVELENGTH_NM >= 650) & (WAVELENGTH_NM <= 810)


def at(name: str, *wavelengths_nm: float) -> np.ndarray:
    return np.interp(wavelengths_nm, WAVELENGTH_NM, curve(name))


def lab(reflectance: np.ndarray, light: str) -> np.ndarray:
    """CIELAB of a reflectance under an illuminant, 1931 observer."""
    observer = colour.MSDS_CMFS["CIE 1931 2 Degree Standard Observer"]
    matching = np.stack([np.interp(WAVELENGTH_NM, observer.wavelengths, column) for column in observer.values.T])
    power = illuminants.illuminant(light)
    white = matching @ power
    return colour.XYZ_to_Lab(matching @ (power * reflectance) / white[1], white[:2] / white.sum())


def test_every_reflectance_is_a_share_and_has_a_source():
    assert len(reflectances.names()) >= 36
    for name in reflectances.names():
        values = curve(name)
        assert values.shape == WAVELENGTH_NM.shape
        assert np.isfinite(values).all() and values.min() > 0.01 and values.max() < 0.95, name
        source = reflectances.source(name)
        assert len(source) > 15 and "\n" not in source, name


@pytest.mark.parametrize(("wavelength_nm", "expected"), [(550, 0.15), (680, 0.04), (720, 0.31), (780, 0.45)])
def test_leaf_is_that_of_prospect(wavelength_nm, expected):
    assert at("leaf-green", wavelength_nm)[0] == pytest.approx(expected, abs=LEAF_LIMIT)


def test_red_edge_parts_living_leaves_from_dry_ones():
    """Expectation: normalised difference of 800 and 670 nm (NDVI) above 0.7 when green, below 0.4 when dry."""
    for name, low, high in (("leaf-green", 0.7, 1.0), ("leaf-dry", 0.1, 0.4)):
        red, infrared = at(name, 670, 800)
        assert low < (infrared - red) / (infrared + red) < high, name


@pytest.mark.parametrize("name", ["petal-red", "petal-yellow", "petal-violet", "petal-pink", "petal-white"])
def test_petals_are_bright_in_the_near_infrared(name):
    assert at(name, 720, 800).min() > 0.6


def test_skin_has_the_bands_of_haemoglobin_and_the_darkness_of_melanin():
    """Expectation: the W of oxyhaemoglobin (darker at 542 and 577 nm than between), a rise beyond 600 nm, and melanin
    that matters less the longer the wave: near-infrared 0.55 to 0.7 when light, 0.35 to 0.5 when dark.
    """
    light, dark = at("skin-light", 542, 560, 577, 620), at("skin-dark", 542, 560, 577, 620)
    assert light[1] > light[0] and light[1] > light[2]
    for values in (light, dark):  # melanin tilts the W of dark skin
        assert values[1] ** 2 > 1.1 * values[0] * values[2] and values[3] > 1.4 * values[2]
    assert 0.55 < at("skin-light", 800)[0] < 0.7 and 0.35 < at("skin-dark", 800)[0] < 0.5
    contrast = at("skin-light", 450, 550, 650, 800) / at("skin-dark", 450, 550, 650, 800)
    assert (np.diff(contrast) < 0).all() and contrast[0] > 3


@pytest.mark.parametrize("name", ["polyester-black", "cotton-black"])
def test_dyed_black_is_bright_in_the_near_infrared(name):
    assert at(name, 450, 550, 650).max() < 0.1 and at(name, 760, 800).min() > 0.45


@pytest.mark.parametrize("name", ["carbon-black", "toner-black", "plastic-black", "rubber-black"])
def test_carbon_is_dark_everywhere(name):
    assert curve(name).max() < 0.055


@pytest.mark.parametrize(
    ("ink", "expected"), [("cyan", (56, -36, -51)), ("magenta", (48, 75, -4)), ("yellow", (89, -4, 93))]
)
def test_process_inks_have_their_colour_and_are_transparent_in_the_near_infrared(ink, expected):
    """Expectation: solids of ISO 12647-2 (CIELAB under D50), and the bare paper from 740 nm on."""
    assert np.linalg.norm(lab(curve(f"ink-{ink}"), "D50") - expected) < INK_COLOUR_LIMIT
    beyond = WAVELENGTH_NM >= 740
    assert (curve(f"ink-{ink}") / curve("white-paper"))[beyond].min() > OPEN


def test_kubelka_munk_of_no_dye_is_the_fabric_and_more_dye_is_darker():
    fabric = curve("cotton-undyed")
    np.testing.assert_allclose(reflectances.dyed_reflectance(fabric, np.zeros_like(fabric)), fabric, rtol=1e-9)
    cyan = reflectances.dye_absorptions()["cyan"]
    once, twice = (reflectances.dyed_reflectance(fabric, amount * cyan) for amount in (1, 2))
    assert (twice <= once).all() and (once <= fabric).all()
    # K/S of a perfect white with absorption 1: R = 2 - sqrt(3)
    assert reflectances.dyed_reflectance(np.array([1.0]), np.array([1.0]))[0] == pytest.approx(2 - np.sqrt(3))


# --- the ColorChecker ----------------------------------------------------------------------------

TABLE_LIMIT = 1e-9  # the table itself, up to its 720 nm: every second point of ours is one of its own
READING_LIMIT = 0.025  # lines between three numbers that are rounded to 0.01
CHART_LIMIT = (
    0.17  # between two charts: 0.16 on magenta, where a third (BabelColor's) differs as much from the measured
)
TYPICAL_CHART_LIMIT = 0.03  # median patch


def test_colour_checker_is_the_table_of_colour_science_up_to_720_nm():
    table = colour.SDS_COLOURCHECKERS["ColorChecker N Ohta"]
    assert len(colour_checker.PATCHES) == len(table) == 24
    places = np.arange(400.0, 721.0, 10.0)
    for name, patch in zip(colour_checker.PATCHES, table.values(), strict=True):
        ours = np.interp(places, WAVELENGTH_NM, colour_checker.curve(name))
        assert np.abs(ours - np.interp(places, patch.wavelengths, patch.values)).max() < TABLE_LIMIT, name


@pytest.mark.parametrize("name", colour_checker.PATCHES)
def test_colour_checker_patches_are_shares(name):
    values = colour_checker.curve(name)
    assert np.isfinite(values).all() and values.min() > 0.01 and values.max() < 0.95


def test_colour_checker_against_a_measured_chart(reference):
    """Set-up: the chart that ISETCam publishes, columns of the chart one after the other.

    Expectation: beyond 760 nm within the rounding of what was read from that chart; between 650 and 720 nm, which is
    another chart's table, within what charts differ, each neutral within 0.04.
    """
    chart = reference("reflectance_macbeth")
    worst = []
    for number, name in enumerate(colour_checker.PATCHES):
        row, column = divmod(number, 6)
        measured = np.interp(WAVELENGTH_NM, chart["wavelength_nm"], chart[f"s{column * 4 + row + 1:03d}"])
        error = np.abs(colour_checker.curve(name) - measured)
        assert error[WAVELENGTH_NM >= 760].max() < READING_LIMIT, name
        worst.append(error[NEAR_INFRARED].max())
        assert worst[-1] < (0.04 if row == 3 else CHART_LIMIT), (name, worst[-1])
    assert np.median(worst) < TYPICAL_CHART_LIMIT
