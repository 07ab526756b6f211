"""Illuminants by name: spectral power on the wavelength grid, scaled to one lux.

The CIE's tables of lamps end at 780 nm, within the near-infrared band; :func:`description` states how each illuminant
is extrapolated beyond its table.
"""

from __future__ import annotations

import re
from functools import cache
from pathlib import Path
from typing import NamedTuple

import numpy as np

from dasim.base.errors import InputError, kind_of
from dasim.base.suggestions import did_you_mean
from dasim.spectra import daylight, tables
from dasim.spectra.grid import NEAR_INFRARED_NM, WAVELENGTH_NM, integrate, photons_per_joule
from dasim.spectra.observer import cct_k, luminous_efficiency, planckian
from dasim.typing import FloatArray

_DAYLIGHT_TABLE = Path(__file__).parents[1] / "data" / "daylight.csv"
_LAMP_TABLE = Path(__file__).parents[1] / "data" / "lamps.csv"

MAX_LUMINOUS_EFFICACY_LM_W = 683.002  # lm/W at 555 nm, CIE 015:2018

_D_SERIES_CCT_K = {"D65": 6504.0, "D55": 5503.0, "D50": 5003.0, "D75": 7504.0}
_PLANCKIAN_K = {"A": 2855.5, "incandescent-2800K": 2800.0}
ENERGY_SAVING = "energy-saving-3500K"
_FLUORESCENT = tuple(f"F{i}" for i in range(1, 13)) + tuple(f"F3.{i}" for i in range(1, 16))
_LEDS = (*(f"LED-B{i}" for i in range(1, 6)), "LED-BH1", "LED-RGB1", "LED-V1", "LED-V2")

ILLUMINANTS = (*_D_SERIES_CCT_K, *_PLANCKIAN_K, ENERGY_SAVING, *_FLUORESCENT, *_LEDS)
BLACKBODY_K = (1000, 25_000)
ELEVATION_DEG = (5, 90)
PATTERNS = (
    f"blackbody-NNNNK ({BLACKBODY_K[0]} to {BLACKBODY_K[1]} K)",
    f"sun-NNdeg, sky-NNdeg and daylight-NNdeg (sun {ELEVATION_DEG[0]} to {ELEVATION_DEG[1]} degrees up)",
)
EXAMPLES = ("blackbody-5000K", "sun-10deg", "sun-60deg", "sky-60deg", "daylight-60deg")  # of the patterns
_BLACKBODY = re.compile(r"blackbody-(\d{1,6})K")
_DAYLIGHT = re.compile(r"(sun|sky|daylight)-(\d{1,3})deg")

_TABLE_END_NM = 780.0  # of the CIE's fluorescent lamps and LEDs
_MEAN_FROM_NM = 760.0  # lamps: beyond the table, the mean of the table from here to its end
_TAIL_FROM_NM = 740.0  # LEDs: beyond the table, the exponential decay fitted from here to its end

# Three-band compact fluorescent lamp [inferred]: the CIE's tables, plus two parts that a measured three-band lamp of
# 3000 K has above 700 nm (U30 of ISETCam): a weak continuum, and the unresolved lines of argon at 795 to 826 nm.
_THREE_BAND = ("F12", "F11")  # 3000 K and 4000 K
_THREE_BAND_CCT_K = 3500.0
_CONTINUUM_W_M2_NM = 0.40e-6  # per lux
_ARGON_NM, _ARGON_SIGMA_NM, _ARGON_W_M2 = 806.0, 12.0, 8e-6  # per lux


class Description(NamedTuple):
    """Properties of an illuminant for a list."""

    name: str
    cct_k: float  # correlated colour temperature
    near_infrared: float  # photons within 650-810 nm, relative to D65 of the same illuminance
    beyond: str  # extrapolation beyond the end of its table


def illuminant(name: str) -> FloatArray:
    """Spectral irradiance of an illuminant at 1 lux, [wavelength], W m^-2 nm^-1; the array is read-only.

    ``name`` is one of ``ILLUMINANTS`` or matches one of ``PATTERNS``; InputError otherwise.
    """
    if not isinstance(name, str):
        raise InputError(f"illuminant: must be a name such as 'D65', not {kind_of(name)}")
    return _illuminant(name)


@cache
def _illuminant(name: str) -> FloatArray:
    curve = _one_lux(_relative(name))
    curve.setflags(write=False)
    return curve


def lux(power: FloatArray) -> float:
    """Illuminance in lux of a spectral irradiance [wavelength] in W m^-2 nm^-1."""
    return float(MAX_LUMINOUS_EFFICACY_LM_W * integrate(power * luminous_efficiency()))


def illuminant_names() -> list[str]:
    """Names of the illuminants that have a fixed name, without those of ``PATTERNS`` such as ``blackbody-5000K``."""
    return list(ILLUMINANTS)


def description(name: str) -> Description:
    """Colour temperature and near-infrared content of an illuminant, and its extrapolation beyond its table."""
    low, high = NEAR_INFRARED_NM
    band = (WAVELENGTH_NM >= low) & (WAVELENGTH_NM <= high)
    photons = [np.trapezoid((illuminant(n) * photons_per_joule())[band], WAVELENGTH_NM[band]) for n in (name, "D65")]
    return Description(name, cct_k(illuminant(name)), float(photons[0] / photons[1]), _beyond(name))


def _beyond(name: str) -> str:
    if name in _D_SERIES_CCT_K:
        return "computed from the CIE's S0, S1 and S2, which reach 830 nm"
    if name in _PLANCKIAN_K or _BLACKBODY.fullmatch(name):
        return "Planck's law"
    if _DAYLIGHT.fullmatch(name):
        return "SPCTRAL2 (Bird and Riordan 1986), whose table reaches 4000 nm"
    if name in _LEDS:
        return "CIE table to 780 nm, then the exponential decay of 740-780 nm"
    if name == ENERGY_SAVING:
        return "inferred: a mixture of F12 and F11, with the continuum and argon lines of a measured lamp above 700 nm"
    return "CIE table to 780 nm, then the mean of its last 20 nm; measured lamps have 0.93 to 1.0 of that"


def _relative(name: str) -> FloatArray:
    """Spectral power of a named illuminant at an arbitrary scale, [wavelength]."""
    if name in _PLANCKIAN_K:
        return planckian(_PLANCKIAN_K[name])
    if name in _D_SERIES_CCT_K:
        return _daylight(_D_SERIES_CCT_K[name])
    if name == ENERGY_SAVING:
        return _energy_saving()
    if name in _FLUORESCENT:
        return _table(name)
    if name in _LEDS:
        return _led(name)
    if match := _BLACKBODY.fullmatch(name):
        return planckian(_within(name, int(match[1]), BLACKBODY_K, "K"))
    if match := _DAYLIGHT.fullmatch(name):
        elevation_deg = _within(name, int(match[2]), ELEVATION_DEG, "degrees")
        sun, sky = daylight.sun_and_sky(elevation_deg)
        level = np.sin(np.radians(elevation_deg))
        return {"sun": sun, "sky": sky, "daylight": sun * level + sky}[match[1]]
    raise InputError(
        f"illuminant '{name}' is unknown; 'dasim list illuminants' prints all; there are also {', '.join(PATTERNS)}"
        f"{did_you_mean(name, ILLUMINANTS, 3)}"
    )


def _within(name: str, value: int, allowed: tuple[int, int], unit: str) -> int:
    if not allowed[0] <= value <= allowed[1]:
        raise InputError(f"illuminant '{name}': {allowed[0]} to {allowed[1]} {unit} are allowed")
    return value


def _one_lux(relative: FloatArray) -> FloatArray:
    return np.array(relative / lux(relative))


def _daylight(temperature_k: float) -> FloatArray:
    """Relative spectral power of CIE daylight at a correlated colour temperature (CIE 015:2018, 4.1.2).

    It is computed from the components S0-S2, which reach 830 nm, because the tables of D50 to D75 end at 780 nm.
    """
    per_k = 1 / temperature_k
    factors = (
        (0.244063, 0.09911e3, 2.9678e6, -4.6070e9)
        if temperature_k <= 7000
        else (0.237040, 0.24748e3, 1.9018e6, -2.0064e9)
    )
    x = sum(factor * per_k**power for power, factor in enumerate(factors))
    y = -3.000 * x**2 + 2.870 * x - 0.275
    below = 0.0241 + 0.2562 * x - 0.7341 * y
    # The CIE rounds both factors.
    first = np.round((-1.3515 - 1.7703 * x + 5.9114 * y) / below, 3)
    second = np.round((0.0300 - 31.4424 * x + 30.0717 * y) / below, 3)
    table = tables.columns(_DAYLIGHT_TABLE)
    return np.interp(WAVELENGTH_NM, table["wavelength_nm"], table["s0"] + first * table["s1"] + second * table["s2"])


def _table(name: str) -> FloatArray:
    """A table of the CIE (CIE 015:2018), beyond 780 nm the mean of its last 20 nm, [wavelength].

    Three measured fluorescent lamps have 0.93 to 1.0 of that mean up to 830 nm, where their phosphors do not emit and
    the lines of argon are weak. The last value alone is not used because some tables round it to 0.
    """
    table = tables.columns(_LAMP_TABLE)
    wavelength_nm, values = table["wavelength_nm"], table[name]
    level = np.mean(values[wavelength_nm >= _MEAN_FROM_NM])
    return np.where(WAVELENGTH_NM > _TABLE_END_NM, level, np.interp(WAVELENGTH_NM, wavelength_nm, values))


def _led(name: str) -> FloatArray:
    """An LED of the CIE (CIE 015:2018), [wavelength]; the exponential decay of its phosphor continues beyond 780 nm."""
    curve = _table(name)
    curve = np.where(WAVELENGTH_NM > _TABLE_END_NM, curve[WAVELENGTH_NM == _TABLE_END_NM], curve)
    fall = (WAVELENGTH_NM >= _TAIL_FROM_NM) & (WAVELENGTH_NM <= _TABLE_END_NM)
    slope = np.polyfit(WAVELENGTH_NM[fall], np.log(curve[fall]), 1)[0]
    return curve * np.exp(slope * np.maximum(WAVELENGTH_NM - _TABLE_END_NM, 0.0))


def _energy_saving() -> FloatArray:
    """A three-band compact fluorescent lamp of 3500 K [inferred].

    It is the mixture of the CIE's three-band lamps F12 (3000 K) and F11 (4000 K) that has this colour temperature, plus
    the continuum and the argon lines above 700 nm of a measured three-band lamp, which the CIE's tables lack.
    """
    from scipy.optimize import brentq

    warm, cold = (_one_lux(_table(name)) for name in _THREE_BAND)

    def lamp(share: float) -> FloatArray:
        argon = np.exp(-0.5 * ((WAVELENGTH_NM - _ARGON_NM) / _ARGON_SIGMA_NM) ** 2)
        argon *= _ARGON_W_M2 / (_ARGON_SIGMA_NM * np.sqrt(2 * np.pi))
        floor = _CONTINUUM_W_M2_NM * np.clip((WAVELENGTH_NM - 700.0) / 40.0, 0.0, 1.0)
        return (1 - share) * warm + share * cold + floor + argon

    return lamp(brentq(lambda share: cct_k(lamp(share)) - _THREE_BAND_CCT_K, 0.0, 1.0, xtol=1e-6))
