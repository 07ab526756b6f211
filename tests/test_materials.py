"""Materials from visible to near-infrared, and what photographs are made of."""

from __future__ import annotations

import itertools
from pathlib import Path

import cv2
import numpy as np
import pytest

from dasim import materials
from dasim.errors import InputError
from dasim.materials import Blend, Diffuse, Mixture, Print
from dasim.spectra import WAVELENGTH_NM

LEAF_LIMIT = 0.03  # absolute; spread between leaves is larger (PROSPECT's range at 550 nm is 0.05 to 0.25)
INK_LIMIT = 0.03  # of the paper, from 760 nm: cyan's long tail


def at(curve: np.ndarray, wavelength_nm: float) -> float:
    return float(np.interp(wavelength_nm, WAVELENGTH_NM, curve))


def weighted(surface, y: int, x: int) -> list[tuple[float, np.ndarray]]:
    """Shares and reflectances of everything a pixel of a texture is made of."""
    if isinstance(surface, Diffuse):
        return [(1.0, surface.reflectance)]
    assert isinstance(surface, Mixture)
    share = float(surface.weight[y, x])
    first = [((1 - share) * w, curve) for w, curve in weighted(surface.first, y, x)]
    return first + [(share * w, curve) for w, curve in weighted(surface.second, y, x)]


def colour_of(surface, y: int, x: int) -> np.ndarray:
    return sum(share * curve for share, curve in weighted(surface, y, x))


@pytest.fixture
def photograph(tmp_path):
    """A picture of given 8-bit sRGB colours, one a column."""

    def write(*rgb: tuple[int, int, int]) -> Path:
        data = np.array([rgb, rgb], np.uint8)[..., ::-1]
        assert cv2.imwrite(str(tmp_path / "colours.png"), data)
        return tmp_path

    return write


def test_reflectances_are_shares():
    assert len(materials.material_names()) >= 10
    for name in materials.material_names():
        curve = materials.reflectance(name)
        assert curve.shape == WAVELENGTH_NM.shape
        assert np.isfinite(curve).all() and curve.min() > 0 and curve.max() < 1, name


@pytest.mark.parametrize(("wavelength_nm", "expected"), [(550, 0.15), (680, 0.04), (720, 0.31), (780, 0.45)])
def test_leaf_is_that_of_prospect(wavelength_nm, expected):
    assert at(materials.reflectance("leaf-green"), wavelength_nm) == pytest.approx(expected, abs=LEAF_LIMIT)


def test_dyed_textiles_are_bright_in_the_near_infrared_and_carbon_is_not():
    assert (
        at(materials.reflectance("polyester-black"), 550)
        < 0.1
        < 0.4
        < at(materials.reflectance("polyester-black"), 800)
    )
    assert materials.reflectance("carbon-black").max() < 0.05


def test_unknown_names_are_the_users_mistake(tmp_path):
    with pytest.raises(InputError, match=r"material 'gold' is unknown; known are .*brick.*white-paper"):
        materials.reflectance("gold")
    with pytest.raises(InputError, match=r"image 'me\.png': no such file in .* \(or 'skimage:NAME'\)"):
        materials.surface(Blend(kind="blend", image="me.png", dark="soil", bright="sand"), tmp_path)
    with pytest.raises(InputError, match=r"image 'skimage:lena': .*; there are .*brick"):
        materials.surface(Print(kind="print", image="skimage:lena"), tmp_path)
    (tmp_path / "text.png").write_text("no picture")
    with pytest.raises(InputError, match=r"image 'text\.png': .* cannot be read as a picture"):
        materials.surface(Print(kind="print", image="text.png"), tmp_path)
    folder = tmp_path / "colours.png"
    cv2.imwrite(str(folder), np.zeros((2, 2, 3), np.uint8))
    with pytest.raises(InputError, match="material 'gold'"):
        materials.surface(Blend(kind="blend", image="colours.png", dark="gold", bright="sand"), tmp_path)


def test_blend_mixes_in_linear_light(photograph):
    """Set-up: black, white, and sRGB 188, whose luminance is 0.503 (IEC 61966-2-1).

    Expectation: the dark material, the bright one, and their mean: the same share at every wavelength.
    """
    folder = photograph((0, 0, 0), (255, 255, 255), (188, 188, 188))
    surface = materials.surface(Blend(kind="blend", image="colours.png", dark="soil", bright="sand"), folder)
    soil, sand = materials.reflectance("soil"), materials.reflectance("sand")
    np.testing.assert_allclose(colour_of(surface, 0, 0), soil, rtol=1e-6)
    np.testing.assert_allclose(colour_of(surface, 0, 1), sand, rtol=1e-6)
    np.testing.assert_allclose(colour_of(surface, 0, 2), 0.497 * soil + 0.503 * sand, rtol=2e-3)
    red, green = photograph((255, 0, 0), (0, 255, 0)), None
    surface = materials.surface(Blend(kind="blend", image="colours.png", dark="soil", bright="sand"), red)
    red, green = (np.ptp((colour_of(surface, 0, x) - soil) / (sand - soil)) for x in (0, 1))
    assert max(red, green) < 1e-5, "colours of the photograph do not tint the near-infrared"


def test_print_of_white_is_paper_and_of_black_is_carbon(photograph):
    folder = photograph((255, 255, 255), (0, 0, 0))
    surface = materials.surface(Print(kind="print", image="colours.png", black_generation=1.0), folder)
    np.testing.assert_allclose(colour_of(surface, 0, 0), materials.reflectance("white-paper"), rtol=1e-6)
    np.testing.assert_allclose(colour_of(surface, 0, 1), materials.reflectance("carbon-black"), rtol=1e-5)


def test_print_vanishes_in_the_near_infrared_except_its_black(photograph):
    """Rationale: process inks are transparent there; what a colour picture shows in the near-infrared is its black.

    Expectation: without black ink any colour is paper beyond 760 nm, though it differs from paper where it is seen;
    with black ink, grey is darker there by that ink's share (0.6 of a coverage of 0.784).
    """
    colours = [(255, 0, 0), (0, 255, 0), (0, 0, 255), (0, 255, 255), (255, 255, 0), (0, 0, 0), (128, 128, 128)]
    folder = photograph(*colours)
    near = WAVELENGTH_NM >= 760
    paper = materials.reflectance("white-paper")
    plain = materials.surface(Print(kind="print", image="colours.png", black_generation=0.0), folder)
    for x in range(len(colours)):
        spectrum = colour_of(plain, 0, x)
        assert np.abs(spectrum[near] / paper[near] - 1).max() < INK_LIMIT, colours[x]
        assert (spectrum[~near] / paper[~near]).min() < 0.6, colours[x]
    grey = colour_of(materials.surface(Print(kind="print", image="colours.png"), folder), 0, 6)
    black = 0.6 * (1 - 0.2158605)  # sRGB 128 in linear light
    expected = (1 - black) * paper + black * materials.reflectance("carbon-black")
    assert np.abs(grey[near] / expected[near] - 1).max() < INK_LIMIT


def test_demichel_shares_are_products_and_sum_to_one(photograph):
    """Expectation: nine areas (eight overprints and black) that cover the paper, each overprint the product of its
    inks' coverages (Demichel), written out here for coverages of 1 - 0.2159, 1 - 0.5029 and 1 - 0.8796.
    """
    folder = photograph((128, 188, 241))
    surface = materials.surface(Print(kind="print", image="colours.png", black_generation=0.0), folder)
    shares = [share for share, _ in weighted(surface, 0, 0)]
    assert len(shares) == 9 and min(shares) >= 0
    assert sum(shares) == pytest.approx(1.0, abs=1e-6)
    linear = [0.2158605, 0.5028865, 0.8796224]
    expected = [np.prod(choice) for choice in itertools.product(*[(value, 1 - value) for value in linear])]
    np.testing.assert_allclose(sorted(shares), sorted([*expected, 0.0]), atol=1e-5)


def test_print_looks_like_its_photograph(photograph):
    """Expectation: each primary's print is brightest in its own third of the visible band."""
    folder = photograph((255, 0, 0), (0, 255, 0), (0, 0, 255))
    surface = materials.surface(Print(kind="print", image="colours.png"), folder)
    thirds = [(600, 680), (520, 570), (420, 480)]
    for x in range(3):
        curve = colour_of(surface, 0, x)
        means = [curve[(WAVELENGTH_NM >= low) & (WAVELENGTH_NM <= high)].mean() for low, high in thirds]
        assert np.argmax(means) == x
