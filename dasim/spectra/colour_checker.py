"""The 24 patches of the X-Rite (GretagMacbeth) ColorChecker: one chart for scenes, one for colour matrices.

The chart for scenes covers 400 to 830 nm. Up to 720 nm it has the spectra of N. Ohta (1997). That
table ends at 780 nm, and its last 60 nm lie below the values of other instruments (by 0.09 for the orange patch), so
that it is not used beyond 720 nm. There the reflectance is linear between three values per patch, which were read to
0.01 from the chart that ISETCam publishes as measured to beyond 1,000 nm (macbethChart, MIT licence). Charts differ:
the pigments changed around 2005 and 2014, and a patch of another year may differ by 0.2 in the near-infrared (foliage,
dark skin).

Colour matrices are fitted to a different measurement (ISO 17321-1), so that the chart in a scene is an independent test
of them.

Tested in tests/dasim/materials/test_reflectances.py.
"""

from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np

from dasim.spectra import tables
from dasim.spectra.grid import WAVELENGTH_NM
from dasim.typing import FloatArray

_TABLE = Path(__file__).parents[1] / "data" / "colour_checker.csv"
_ISO_TABLE = Path(__file__).parents[1] / "data" / "iso_17321.csv"

TABLE_END_NM = 720.0
BEYOND_NM = (760.0, 790.0, 830.0)  # wavelengths of the values of the second source
SOURCE = "ColorChecker: Ohta (1997) to 720 nm, then read from ISETCam's chart at 760, 790, 830 nm"

_REFLECTANCE_BEYOND = {
    "dark-skin": (0.49, 0.50, 0.48),
    "light-skin": (0.75, 0.76, 0.77),
    "blue-sky": (0.12, 0.12, 0.13),
    "foliage": (0.42, 0.44, 0.47),
    "blue-flower": (0.48, 0.48, 0.49),
    "bluish-green": (0.29, 0.30, 0.41),
    "orange": (0.66, 0.68, 0.69),
    "purplish-blue": (0.24, 0.36, 0.53),
    "moderate-red": (0.60, 0.60, 0.61),
    "purple": (0.40, 0.42, 0.43),
    "yellow-green": (0.41, 0.43, 0.52),
    "orange-yellow": (0.66, 0.67, 0.68),
    "blue": (0.19, 0.32, 0.44),
    "green": (0.11, 0.13, 0.29),
    "red": (0.75, 0.76, 0.77),
    "yellow": (0.75, 0.76, 0.77),
    "magenta": (0.69, 0.70, 0.71),
    "cyan": (0.16, 0.21, 0.31),
    "white": (0.83, 0.83, 0.83),
    "neutral-8": (0.52, 0.52, 0.51),
    "neutral-6.5": (0.31, 0.31, 0.30),
    "neutral-5": (0.16, 0.16, 0.15),
    "neutral-3.5": (0.08, 0.08, 0.08),
    "black": (0.05, 0.06, 0.06),
}
PATCHES = tuple(f"checker-{name}" for name in _REFLECTANCE_BEYOND)  # by rows from the top, left to right


@cache
def _curves() -> dict[str, FloatArray]:
    """Reflectances 0..1 of all patches of the chart for scenes by name, each [wavelength]."""
    table = tables.columns(_TABLE)
    inside = table["wavelength_nm"] <= TABLE_END_NM
    wavelength_nm = np.concatenate([table["wavelength_nm"][inside], BEYOND_NM])
    return {
        f"checker-{name}": np.interp(WAVELENGTH_NM, wavelength_nm, np.concatenate([table[name][inside], beyond]))
        for name, beyond in _REFLECTANCE_BEYOND.items()
    }


def curve(patch: str) -> FloatArray:
    """Reflectance 0..1 of one of ``PATCHES`` of the chart for scenes, [wavelength]."""
    return _curves()[patch].copy()


@cache
def iso_17321_curves() -> FloatArray:
    """Reflectances 0..1 of the 24 patches of ISO 17321-1, [24, wavelength], constant beyond their table; read-only."""
    wavelength_nm, *patches = tables.columns(_ISO_TABLE).values()
    curves = np.stack([np.interp(WAVELENGTH_NM, wavelength_nm, values) for values in patches])
    curves.setflags(write=False)
    return curves
