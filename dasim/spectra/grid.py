"""The wavelength grid of all spectral curves, the edges of filters, and integration over wavelength.

A curve is a float64 array of shape [len(WAVELENGTH_NM)], sampled at ``WAVELENGTH_NM`` and interpolated linearly. The
grid ends at 830 nm, the upper limit of Mitsuba's spectral variants.
"""

from __future__ import annotations

from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray
from pydantic import Field
from scipy.special import expit

from dasim.typing import FloatArray

WAVELENGTH_STEP_NM = 2.0
WAVELENGTH_NM: FloatArray = np.arange(400.0, 830.0 + WAVELENGTH_STEP_NM / 2, WAVELENGTH_STEP_NM)
WHOLE_GRID_NM = (float(WAVELENGTH_NM[0]), float(WAVELENGTH_NM[-1]))

BAND_NM = 10.0  # width of the bands of :func:`bands`, within which quantities that vary slowly are constant

PLANCK_J_S = 6.62607015e-34
LIGHT_SPEED_M_S = 299_792_458.0

AnyNm = Annotated[float, Field(ge=100, le=1e5)]  # wavelength in a user's table, which may extend beyond the grid

CHANNELS = ("R", "G", "B", "IR")
LUMINANCE = (0.2126, 0.7152, 0.0722)  # of linear sRGB, IEC 61966-2-1
NEAR_INFRARED_NM = (650.0, 810.0)  # the paper's band, sec. 3.2

# ln(81): a logistic 1 / (1 + exp(-x)) rises from 10 % to 90 % over 2 ln 9 = ln 81 units of x.
_LOGISTIC_10_90 = float(np.log(81.0))


def integrate(values: FloatArray) -> Any:
    """Trapezoidal integral of ``values`` [..., wavelength] over wavelength, [...], in units of the values times nm."""
    return np.trapezoid(values, WAVELENGTH_NM, axis=-1)


def integrate_product(first: FloatArray, second: FloatArray) -> Any:
    """Integral over wavelength of the product of two curves [..., wavelength] that are linear between grid points.

    The trapezoidal rule on the products is off where both change within a step: by h/6 times the product of their
    changes, which is 0.4 % for the infrared channel under the spectral lines of F11.
    """
    changes = np.diff(first, axis=-1) * np.diff(second, axis=-1)
    return integrate(first * second) - WAVELENGTH_STEP_NM / 6 * changes.sum(axis=-1)


def bands(weights: FloatArray) -> list[tuple[float, FloatArray]]:
    """Integrals of weights [..., wavelength] over bands of ``BAND_NM``, each with its mean wavelength in nm.

    Together they are :func:`integrate`, less the bands that hold less than a millionth of it.
    """
    step = WAVELENGTH_STEP_NM * np.ones_like(WAVELENGTH_NM)
    step[[0, -1]] /= 2  # the trapezoidal rule
    index = band_index()
    found = []
    for band in range(index[-1] + 1):
        inside = index == band
        weight = (weights[..., inside] * step[inside]).sum(axis=-1)
        if weight.max() > 1e-6 * integrate(weights).max():
            found.append((float(WAVELENGTH_NM[inside].mean()), weight))
    return found


def band_index() -> NDArray[np.int_]:
    """The band of every wavelength of the grid, [wavelength]; the last one has its upper limit, too."""
    first, last = WHOLE_GRID_NM
    return np.minimum((WAVELENGTH_NM - first) // BAND_NM, (last - first) // BAND_NM - 1).astype(int)


def long_pass(edge_nm: float, width_nm: float) -> FloatArray:
    """Transmittance 0..1 of a long-pass filter: a logistic edge, 0.5 at ``edge_nm``, 10-90 % within ``width_nm``."""
    return np.asarray(expit(_LOGISTIC_10_90 * (WAVELENGTH_NM - edge_nm) / width_nm))


def short_pass(edge_nm: float, width_nm: float) -> FloatArray:
    """Transmittance 0..1 of a short-pass filter, the complement of :func:`long_pass`."""
    return 1.0 - long_pass(edge_nm, width_nm)


def photons_per_joule() -> FloatArray:
    """Photons per joule of light at each wavelength, lambda / (h c), [wavelength]."""
    return WAVELENGTH_NM * 1e-9 / (PLANCK_J_S * LIGHT_SPEED_M_S)
