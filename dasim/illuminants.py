"""Illuminants by name: spectral power on the wavelength grid, of lights that give one lux."""

from __future__ import annotations

from functools import cache

import numpy as np

from dasim.errors import InputError
from dasim.spectra import LIGHT_SPEED_M_S, PLANCK_J_S, WAVELENGTH_NM, FloatArray, integrate

BOLTZMANN_J_K = 1.380649e-23
MAX_LUMINOUS_EFFICACY_LM_W = 683.002  # lm/W at 555 nm, CIE 015:2018

ILLUMINANTS = ("D65", "D55", "D50", "A", "incandescent-2800K")
_D_SERIES_CCT_K = {"D65": 6504.0, "D55": 5503.0, "D50": 5003.0}
_PLANCKIAN_K = {"A": 2855.5, "incandescent-2800K": 2800.0}


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
