"""Spectral curves on one wavelength grid: sensor responses, filter edges, illuminants.

Every curve is a float64 array of shape [len(WAVELENGTH_NM)], sampled at ``WAVELENGTH_NM`` and
linear in between. The grid ends at 830 nm, the upper limit of Mitsuba's spectral variants.
"""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dasim.errors import InputError

FloatArray = NDArray[np.float64]

WAVELENGTH_STEP_NM = 2.0
WAVELENGTH_NM: FloatArray = np.arange(400.0, 830.0 + WAVELENGTH_STEP_NM / 2, WAVELENGTH_STEP_NM)

PLANCK_J_S = 6.62607015e-34
LIGHT_SPEED_M_S = 299_792_458.0
BOLTZMANN_J_K = 1.380649e-23
MAX_LUMINOUS_EFFICACY_LM_W = 683.002  # lm/W at 555 nm, CIE 015:2018

CHANNELS = ("R", "G", "B", "IR")
NEAR_INFRARED_NM = (650.0, 810.0)  # the paper's band, sec. 3.2

# ln(81): a logistic 1 / (1 + exp(-x)) rises from 10 % to 90 % over 2 ln 9 = ln 81 units of x.
_LOGISTIC_10_90 = float(np.log(81.0))

ILLUMINANTS = ("D65", "D55", "D50", "A", "incandescent-2800K")
_D_SERIES_CCT_K = {"D65": 6504.0, "D55": 5503.0, "D50": 5003.0}
_PLANCKIAN_K = {"A": 2855.5, "incandescent-2800K": 2800.0}


def integrate(values: FloatArray, axis: int = -1) -> Any:
    """Integral over wavelength of ``values`` (sampled on ``WAVELENGTH_NM``) by trapezoids, in units * nm."""
    return np.trapezoid(values, WAVELENGTH_NM, axis=axis)


def long_pass(edge_nm: float, width_nm: float) -> FloatArray:
    """Transmittance 0..1 of a long-pass edge: logistic, half-maximum at ``edge_nm``, 10-90 % in ``width_nm``."""
    steps = _LOGISTIC_10_90 * (edge_nm - WAVELENGTH_NM) / width_nm
    return 1.0 / (1.0 + np.exp(np.minimum(steps, 700.0)))  # beyond, exp overflows


def short_pass(edge_nm: float, width_nm: float) -> FloatArray:
    """Transmittance 0..1 of a short-pass edge, the complement of :func:`long_pass`."""
    return 1.0 - long_pass(edge_nm, width_nm)


def photons_per_joule() -> FloatArray:
    """Photons a joule of light holds at each wavelength, lambda / (h c)."""
    return WAVELENGTH_NM * 1e-9 / (PLANCK_J_S * LIGHT_SPEED_M_S)


def _bell(centre_nm: float, left_nm: float, right_nm: float) -> FloatArray:
    """Gaussian bell of height 1 with different standard deviations left and right of its centre."""
    sigma = np.where(WAVELENGTH_NM < centre_nm, left_nm, right_nm)
    return np.exp(-0.5 * ((WAVELENGTH_NM - centre_nm) / sigma) ** 2)


def rgb_ir_quantum_efficiency() -> FloatArray:
    """Quantum efficiency of a synthetic RGB-IR sensor, shape [4 (R, G, B, IR), wavelength], 0..1.

    The paper's Fig. 2(d) is not available as numbers and no measured curve of a whole RGB-IR sensor
    was found, so these are parametric: a clear silicon pixel (broad bell, 0.58 at 610 nm) behind one
    dye a channel. The visible pass bands and near-infrared tails follow published curves of silicon
    sensors in shape (the tails of green and blue open slowly beyond 700 and 780 nm); red passes nearly
    all of the near-infrared, as sec. 4.4 states. The infrared dye opens at 655 nm, so that the infrared
    pixel sees almost no visible light, which eq. (7) assumes. Green peaks at 0.55.
    """
    clear = 0.58 * _bell(610.0, 221.0, 254.0)
    red = 0.03 + 0.88 * long_pass(592.0, 30.0)
    green = 0.05 + 0.94 * _bell(540.0, 32.0, 36.0) + 0.28 * long_pass(755.0, 120.0)
    blue = 0.05 + 0.90 * _bell(455.0, 45.0, 33.0) + 0.45 * long_pass(805.0, 45.0)
    infrared = 0.95 * long_pass(655.0, 14.0)
    return clear * np.stack([red, green, blue, infrared])


def ir_crosstalk(response: FloatArray) -> FloatArray:
    """Near-infrared crosstalk of R, G and B relative to IR, eq. (8): ratios of areas over 650-810 nm.

    ``response`` is [4, wavelength] in electrons a photon (the paper's f_i); returns [3].
    """
    low, high = NEAR_INFRARED_NM
    band = (WAVELENGTH_NM >= low) & (WAVELENGTH_NM <= high)
    areas = np.trapezoid(response[:, band], WAVELENGTH_NM[band], axis=-1)
    return np.asarray(areas)[:3] / np.asarray(areas)[3]


@cache
def luminous_efficiency() -> FloatArray:
    """CIE 1924 photopic luminous efficiency V(lambda), 0..1, from colour-science."""
    import colour

    table = colour.SDS_LEFS["CIE 1924 Photopic Standard Observer"]
    return np.interp(WAVELENGTH_NM, table.wavelengths, table.values, left=0.0, right=0.0)


def planckian(temperature_k: float) -> FloatArray:
    """Relative spectral power of a blackbody, scaled to 1 at 560 nm (Planck's law)."""

    def law(wavelength_nm: FloatArray | float) -> FloatArray:
        metres = np.asarray(wavelength_nm) * 1e-9
        exponent = PLANCK_J_S * LIGHT_SPEED_M_S / (metres * BOLTZMANN_J_K * temperature_k)
        return metres**-5 / np.expm1(exponent)

    return law(WAVELENGTH_NM) / law(560.0)


@cache
def illuminant(name: str) -> FloatArray:
    """Relative spectral power of a named illuminant (``ILLUMINANTS``), scaled to 1 lux.

    Returned in W m^-2 nm^-1 of a light that gives one lux. The D series is computed from the CIE
    components S0-S2, which reach 830 nm (the tables of D65 and D55 stop at 780 nm, inside the
    near-infrared band); A and the incandescent lamp from Planck's law. Raises InputError for other names.
    """
    if name in _PLANCKIAN_K:
        relative = planckian(_PLANCKIAN_K[name])
    elif name in _D_SERIES_CCT_K:
        relative = _daylight(_D_SERIES_CCT_K[name])
    else:
        raise InputError(f"illuminant '{name}' is unknown; known are {', '.join(ILLUMINANTS)}")
    return relative / (MAX_LUMINOUS_EFFICACY_LM_W * integrate(relative * luminous_efficiency()))


def _daylight(cct_k: float) -> FloatArray:
    """Relative spectral power of the CIE daylight of a correlated colour temperature (CIE 015:2018)."""
    import colour

    chromaticity = colour.temperature.CCT_to_xy_CIE_D(cct_k)
    table = colour.sd_CIE_illuminant_D_series(chromaticity)
    return np.interp(WAVELENGTH_NM, table.wavelengths, table.values)
