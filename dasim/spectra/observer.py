"""The CIE's observers on the wavelength grid: luminous efficiency, tristimulus values, correlated colour temperature.

The tables are bundled: importing colour-science, from which they are, takes 1.5 s and 170 MB, with pandas and
matplotlib. The tests compare all of this with it.

Tested in tests/dasim/spectra/test_tables.py.
"""

from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np

from dasim.spectra import tables
from dasim.spectra.grid import LIGHT_SPEED_M_S, PLANCK_J_S, WAVELENGTH_NM, integrate
from dasim.typing import FloatArray

_TABLE = Path(__file__).parents[1] / "data" / "observer.csv"

BOLTZMANN_J_K = 1.380649e-23
CCT_K = (1000.0, 1e5)  # range of :func:`cct_k`
CCT_STEPS = 200  # blackbodies, of which the nearest is the first estimate


@cache
def _curves() -> FloatArray:
    """V(lambda), and the three colour-matching functions, [4, wavelength]; read-only."""
    table = tables.columns(_TABLE)
    curves = np.stack([np.interp(WAVELENGTH_NM, table["wavelength_nm"], table[name]) for name in "vxyz"])
    curves.setflags(write=False)
    return curves


def luminous_efficiency() -> FloatArray:
    """CIE 1924 photopic luminous efficiency V(lambda), 0..1, [wavelength]; read-only."""
    return _curves()[0]


def tristimulus(power: FloatArray) -> FloatArray:
    """XYZ [..., 3] of spectra [..., wavelength] by the CIE 1931 observer of 2 degrees, in units of the spectra x nm."""
    return np.asarray(integrate(power[..., None, :] * _curves()[1:]))


def planckian(temperature_k: float) -> FloatArray:
    """Relative spectral power of a blackbody by Planck's law, [wavelength], 1 at 560 nm."""

    def law(wavelength_nm: FloatArray | float) -> FloatArray:
        metres = np.asarray(wavelength_nm) * 1e-9
        exponent = PLANCK_J_S * LIGHT_SPEED_M_S / (metres * BOLTZMANN_J_K * temperature_k)
        return metres**-5 / np.expm1(exponent)

    return law(WAVELENGTH_NM) / law(560.0)


def cct_k(power: FloatArray) -> float:
    """Correlated colour temperature in kelvin, within ``CCT_K``, of a spectrum [wavelength].

    It is the temperature of the blackbody whose chromaticity is nearest in the CIE 1960 diagram, (u', 2/3 v')
    (CIE 015:2018, 9.5).
    """
    from scipy.optimize import minimize_scalar

    own, (steps, locus) = _uv(power), _locus()

    def distance(per_k: float) -> float:
        return float(np.hypot(*(_uv(planckian(1 / per_k)) - own)))

    nearest, width = steps[np.argmin(np.hypot(*(locus - own).T))], steps[1] - steps[0]
    bounds = max(nearest - width, steps[0]), min(nearest + width, steps[-1])
    return float(1 / minimize_scalar(distance, bounds=bounds, method="bounded", options={"xatol": 1e-12}).x)


@cache
def _locus() -> tuple[FloatArray, FloatArray]:
    """1 / temperature of blackbodies within ``CCT_K``, evenly spaced, [n], and their chromaticities, [n, 2]."""
    per_k = np.linspace(1 / CCT_K[1], 1 / CCT_K[0], CCT_STEPS)
    return per_k, np.stack([_uv(planckian(1 / each)) for each in per_k])


def _uv(power: FloatArray) -> FloatArray:
    """Chromaticity (u, v) in the CIE 1960 diagram of a spectrum [wavelength]."""
    x, y, z = tristimulus(power)
    return np.array([4 * x, 6 * y]) / (x + 15 * y + 3 * z)
