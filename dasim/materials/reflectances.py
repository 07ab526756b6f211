"""Parametric Lambertian reflectances from 400 to 830 nm, by name, each with its source.

No curve is a measurement: each is a few parameters that follow the curves of the cited publication or database ("in
shape like"), so that the near-infrared of a scene is realistic in kind and magnitude. Real specimens deviate by 0.05
and more; for a particular specimen, supply its spectrum (``dasim.materials.library.Spectrum``).
"""

from __future__ import annotations

from functools import cache
from typing import NamedTuple

import numpy as np

from dasim.spectra.grid import WAVELENGTH_NM, long_pass, short_pass
from dasim.typing import FloatArray

ECOSTRESS = "in shape like the ECOSTRESS spectral library (Meerdink et al. 2019)"
USGS = "in shape like the man-made materials of the USGS Spectral Library 7 (Kokaly et al. 2017)"
FLOWERS = "in shape like the Floral Reflectance Database (Arnold et al. 2010)"
SKIN = "melanin and haemoglobin as in Jacques (2013), levels as in Cooksey, Allen and Tsai (2017)"
DYES = "Kubelka-Munk dyes on undyed cotton, transparent beyond 720 nm (see near-infrared rules)"
INKS = "solid process ink on white paper, with the colours of ISO 12647-2; transparent beyond 700 to 740 nm"
PLASTICS = "in shape like the plastics of the USGS Spectral Library 7 (Kokaly et al. 2017)"


class Reflectance(NamedTuple):
    """A reflectance curve 0..1 on ``WAVELENGTH_NM``, and the source of its numbers."""

    curve: FloatArray
    source: str


def line(*points: tuple[float, float]) -> FloatArray:
    """Linear interpolation of (wavelength in nm, reflectance) points, [wavelength]."""
    return np.interp(WAVELENGTH_NM, *np.transpose(points))


def bell(centre_nm: float, sigma_nm: float) -> FloatArray:
    """A Gaussian over wavelength with peak 1, [wavelength]."""
    return np.exp(-0.5 * ((WAVELENGTH_NM - centre_nm) / sigma_nm) ** 2)


# --- transparent colorants: inks and dyes --------------------------------------------------------


def ink_transmittances() -> dict[str, FloatArray]:
    """Two-way transmittance of solid process inks on paper, by ink; transparent beyond 700 to 740 nm.

    Edges and side absorptions are chosen so that solids on ``white-paper`` approximate the colours of ISO 12647-2 under
    D50 (CIELAB 56 -36 -51 for cyan, 48 75 -4 for magenta, 89 -4 93 for yellow).
    """
    return {
        "cyan": (1.0 - 0.94 * long_pass(530.0, 72.0) * short_pass(704.0, 40.0))
        * (1.0 - 0.35 * short_pass(440.0, 60.0)),
        "magenta": (1.0 - 0.95 * long_pass(460.0, 50.0) * short_pass(599.0, 36.0))
        * (1.0 - 0.59 * short_pass(482.0, 60.0)),
        "yellow": 1.0 - 0.94 * short_pass(507.0, 44.0),
    }


DYE_STRENGTH = 14.0  # peak K/S at full strength: the reflectance of the absorption band is then about 0.03


def dye_absorptions() -> dict[str, FloatArray]:
    """K/S of three dyes at full strength: each absorbs one third of the visible band and nothing beyond 720 nm."""
    return {
        "cyan": DYE_STRENGTH * long_pass(592.0, 34.0) * short_pass(696.0, 30.0),
        "magenta": DYE_STRENGTH * long_pass(496.0, 30.0) * short_pass(582.0, 30.0),
        "yellow": DYE_STRENGTH * short_pass(484.0, 32.0),
    }


def dyed_reflectance(base: FloatArray, absorption: FloatArray) -> FloatArray:
    """Reflectance of an opaque dyed fabric (Kubelka and Munk 1931), [wavelength].

    The K/S of the dye, ``absorption``, adds to that of the undyed fabric, (1 - R)^2 / (2 R) with its reflectance R,
    ``base``.
    """
    ratio = (1.0 - base) ** 2 / (2.0 * base) + absorption
    return 1.0 + ratio - np.sqrt(ratio**2 + 2.0 * ratio)


# --- groups of curves ----------------------------------------------------------------------------


def _papers_and_inks() -> dict[str, Reflectance]:
    paper = 0.86 - 0.10 * short_pass(425.0, 30.0)
    inks = {f"ink-{name}": Reflectance(paper * factor, INKS) for name, factor in ink_transmittances().items()}
    return inks | {
        "white-paper": Reflectance(paper, "bleached pulp without brightener, " + USGS),
        "newsprint": Reflectance(
            line((400, 0.36), (450, 0.46), (500, 0.52), (600, 0.59), (700, 0.67), (830, 0.74)),
            "lignin absorbs short wavelengths; " + USGS,
        ),
        "cardboard": Reflectance(
            line((400, 0.12), (450, 0.16), (500, 0.22), (600, 0.37), (700, 0.50), (830, 0.62)), "unbleached; " + USGS
        ),
        "toner-black": Reflectance(
            line((400, 0.030), (830, 0.035)), "carbon black in resin: flat to the near-infrared"
        ),
        "carbon-black": Reflectance(line((400, 0.035), (830, 0.04)), "soot absorbs broadband; " + USGS),
        "grey-card": Reflectance(line((400, 0.18), (830, 0.185)), "nominal 18 % grey, neutral to 830 nm"),
    }


def _minerals() -> dict[str, Reflectance]:
    def mineral(*points: tuple[float, float]) -> Reflectance:
        return Reflectance(line(*points), ECOSTRESS)

    iron = 0.05 * bell(860.0, 60.0)  # Fe3+ crystal field band of haematite, on fired clay
    brick = line((400, 0.07), (530, 0.10), (600, 0.24), (700, 0.33), (830, 0.40)) - iron
    return {
        "concrete-light": mineral((400, 0.38), (600, 0.48), (830, 0.52)),
        "concrete-dark": mineral((400, 0.10), (600, 0.13), (830, 0.15)),
        "brick": Reflectance(brick, ECOSTRESS),
        "mortar": mineral((400, 0.40), (600, 0.52), (830, 0.58)),
        "soil": mineral((400, 0.05), (600, 0.12), (830, 0.22)),
        "sand": mineral((400, 0.18), (600, 0.38), (830, 0.48)),
        "asphalt": mineral((400, 0.07), (600, 0.10), (830, 0.13)),
        "ceramic-white": mineral((400, 0.74), (500, 0.82), (830, 0.84)),
        "terracotta": mineral((400, 0.08), (500, 0.12), (560, 0.20), (620, 0.36), (700, 0.44), (830, 0.48)),
        "paint-white": Reflectance(0.06 + 0.84 * long_pass(412.0, 22.0), "titanium dioxide opens at 410 nm; " + USGS),
    }


def _plants() -> dict[str, Reflectance]:
    def petal(visible: FloatArray) -> Reflectance:
        return Reflectance(visible, FLOWERS)

    # Petals contain no chlorophyll and scatter light in air gaps: they are bright outside the band of their pigment.
    bright = line((400, 0.58), (600, 0.66), (830, 0.70))
    anthocyanin_red = short_pass(604.0, 40.0)
    anthocyanin_violet = bell(548.0, 44.0) + 0.6 * bell(600.0, 34.0)
    carotenoid = short_pass(512.0, 36.0)
    return {
        "leaf-green": Reflectance(
            0.03 + 0.11 * bell(552.0, 28.0) + 0.42 * long_pass(714.0, 45.0),
            "PROSPECT (Jacquemoud and Baret 1990): 0.15 at 550, 0.04 at 680, 0.31 at 720, 0.45 at 780 nm",
        ),
        "leaf-dry": Reflectance(line((400, 0.08), (550, 0.18), (650, 0.30), (720, 0.42), (830, 0.52)), ECOSTRESS),
        "petal-red": petal(bright * (1.0 - 0.94 * anthocyanin_red)),
        "petal-yellow": petal(bright * (1.0 - 0.93 * carotenoid)),
        "petal-violet": petal(bright * np.exp(-1.9 * anthocyanin_violet)),
        "petal-pink": petal(bright * np.exp(-0.85 * bell(530.0, 42.0))),
        "petal-white": petal(bright * (1.0 - 0.35 * short_pass(410.0, 30.0)) * 1.08),
        "wood-light": Reflectance(line((400, 0.20), (550, 0.42), (650, 0.56), (830, 0.68)), "lignin; " + ECOSTRESS),
        "wood-dark": Reflectance(line((400, 0.05), (550, 0.09), (650, 0.15), (830, 0.34)), "lignin; " + ECOSTRESS),
        "bark": Reflectance(line((400, 0.06), (550, 0.12), (650, 0.18), (750, 0.28), (830, 0.34)), ECOSTRESS),
    }


def _skin(melanin: float) -> Reflectance:
    """Skin: light scattered in the dermis, absorbed there by haemoglobin and twice in the epidermis by melanin.

    ``melanin`` is the two-way natural optical density of the epidermis at 550 nm, which is proportional to
    wavelength^-3.33 (Jacques 2013). Oxyhaemoglobin absorbs at 415, 542 and 577 nm, the last two in the W shape that is
    typical of skin, and is nearly transparent beyond 600 nm. The rough surface adds a Fresnel reflectance of 0.035.
    """
    haemoglobin = 1.0 * bell(417.0, 24.0) + 0.30 * bell(542.0, 11.0) + 0.36 * bell(577.0, 8.0)
    haemoglobin = haemoglobin + 0.30 * short_pass(592.0, 26.0)
    dermis = line((400, 0.52), (500, 0.60), (650, 0.66), (830, 0.66))
    epidermis = np.exp(-melanin * (550.0 / WAVELENGTH_NM) ** 3.33)
    return Reflectance(0.035 + dermis * np.exp(-haemoglobin) * epidermis, SKIN)


def _textiles() -> dict[str, Reflectance]:
    undyed = line((400, 0.48), (450, 0.60), (500, 0.67), (600, 0.74), (700, 0.78), (830, 0.80))
    cyan, magenta, yellow = dye_absorptions().values()

    def cotton(*dyes: FloatArray) -> Reflectance:
        return Reflectance(dyed_reflectance(undyed, sum(dyes, np.zeros_like(undyed))), DYES)

    indigo = 5.5 * bell(650.0, 44.0) + 2.0 * short_pass(640.0, 150.0) * long_pass(470.0, 60.0)
    return {
        "cotton-white": Reflectance(0.82 - 0.12 * short_pass(430.0, 40.0), "bleached; " + USGS),
        "cotton-undyed": Reflectance(undyed, "unbleached; " + USGS),
        "cotton-red": cotton(0.6 * magenta, 0.5 * yellow),
        "cotton-yellow": cotton(0.7 * yellow),
        "cotton-green": cotton(0.45 * cyan, 0.06 * magenta, 0.25 * yellow),
        "cotton-blue": cotton(0.5 * cyan, 0.25 * magenta),
        "cotton-black": cotton(cyan, magenta, yellow),
        "denim": Reflectance(
            dyed_reflectance(undyed, indigo), "indigo absorbs around 650 nm; Kubelka-Munk on undyed cotton"
        ),
        "wool-undyed": Reflectance(line((400, 0.24), (500, 0.46), (600, 0.58), (700, 0.65), (830, 0.70)), USGS),
        "polyester-black": Reflectance(
            0.04 + 0.50 * long_pass(715.0, 70.0), "disperse dyes, transparent in the near-infrared; " + USGS
        ),
        "leather-brown": Reflectance(
            line((400, 0.05), (500, 0.06), (600, 0.13), (700, 0.30), (830, 0.50)), "tanned and dyed; " + USGS
        ),
    }


def _plastics() -> dict[str, Reflectance]:
    def plastic(curve: FloatArray) -> Reflectance:
        return Reflectance(curve, PLASTICS)

    return {
        "plastic-white": plastic(0.08 + 0.76 * long_pass(414.0, 24.0)),
        "plastic-red": plastic(0.04 + 0.66 * long_pass(598.0, 34.0)),
        "plastic-yellow": plastic(0.05 + 0.68 * long_pass(512.0, 36.0)),
        "plastic-green": plastic(0.04 + 0.24 * bell(522.0, 30.0) + 0.40 * long_pass(762.0, 70.0)),
        # Phthalocyanine and ultramarine absorb from 550 to 700 nm and are transparent beyond.
        "plastic-blue": plastic(0.04 + 0.36 * bell(455.0, 36.0) + 0.50 * long_pass(745.0, 70.0)),
        "plastic-black": plastic(line((400, 0.045), (830, 0.05))),
        "rubber-black": plastic(line((400, 0.04), (830, 0.05))),
    }


@cache
def _all() -> dict[str, Reflectance]:
    skins = {"skin-light": _skin(0.18), "skin-medium": _skin(0.68), "skin-dark": _skin(1.9)}
    return _papers_and_inks() | _minerals() | _plants() | skins | _textiles() | _plastics()


def names() -> list[str]:
    """Sorted names of the curves."""
    return sorted(_all())


def curve(name: str) -> FloatArray:
    """Reflectance 0..1 on ``WAVELENGTH_NM`` of one of :func:`names`, [wavelength]."""
    return _all()[name].curve.copy()


def source(name: str) -> str:
    """Source of the numbers of one of :func:`names`, in one line."""
    return _all()[name].source
