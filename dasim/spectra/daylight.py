"""Direct sun and clear sky from 400 to 830 nm: the simple spectral model SPCTRAL2.

R. Bird and C. Riordan, Simple solar spectral model for direct and diffuse irradiance on horizontal and tilted planes
at the earth's surface for cloudless atmospheres, J. Climate Appl. Meteorol. 25, 87-97 (1986). Equations are numbered
as in the report SERI/TR-215-2436 (1984). The tests compare the model with ``pvlib.spectrum.spectrl2``; the two agree
within 0.22 % in the oxygen bands and 0.04 % elsewhere, because pvlib uses two constants of a later program instead of
those of the report. pvlib is not a dependency because it would add pandas and HDF5.
"""

from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np

from dasim.spectra import tables
from dasim.spectra.grid import WAVELENGTH_NM
from dasim.typing import FloatArray

_TABLE = Path(__file__).parents[1] / "data" / "spctral2.csv"

# Atmosphere of ASTM G173 at sea level and the sun's mean distance, with the rural aerosol of the report.
WATER_CM, OZONE_ATM_CM, TURBIDITY_500_NM = 1.42, 0.344, 0.084
ANGSTROM_EXPONENT, ASYMMETRY, SCATTERING_ALBEDO_400_NM, SCATTERING_FALL = 1.14, 0.65, 0.945, 0.095
GROUND_ALBEDO = 0.2
OZONE_HEIGHT_RATIO = 22.0 / 6370.0  # height of the ozone layer over the earth's radius
_DIFFUSE_AIR_MASS = 1.8  # effective air mass of diffuse light, eqs. 3-8 and 3-15


def sun_and_sky(elevation_deg: float) -> tuple[FloatArray, FloatArray]:
    """Direct normal irradiance of the sun and diffuse horizontal irradiance of a clear sky, W m^-2 nm^-1.

    The table has steps of 5 to 26 nm and is interpolated linearly: the bands of oxygen at 760 nm and of water at 720
    and 820 nm have the correct area, but no fine structure.

    Args:
        elevation_deg: elevation of the sun above the horizon, degrees.

    Returns:
        Direct and diffuse irradiance, each [wavelength].
    """
    rows = _table()
    direct, diffuse = _spectra(elevation_deg)
    return tuple(np.interp(WAVELENGTH_NM, rows[0], values) for values in (direct, diffuse))  # type: ignore[return-value]


@cache
def _table() -> FloatArray:
    """Wavelength, extraterrestrial irradiance and absorption coefficients of water, ozone and mixed gases, [5, n]."""
    return np.stack(list(tables.columns(_TABLE).values()))


def _spectra(elevation_deg: float) -> tuple[FloatArray, FloatArray]:
    """Direct normal and diffuse horizontal irradiance at the table's wavelengths, W m^-2 nm^-1, eqs. 2-1 and 3-1."""
    wavelength_nm, outside = _table()[:2]
    zenith_deg = 90.0 - elevation_deg
    cosine = np.cos(np.radians(zenith_deg))
    air_mass = 1.0 / (cosine + 0.15 * (93.885 - zenith_deg) ** -1.253)  # eq. 2-5, Kasten (1966)
    ozone_mass = (1 + OZONE_HEIGHT_RATIO) / np.sqrt(cosine**2 + 2 * OZONE_HEIGHT_RATIO)  # eq. 2-10
    rayleigh, aerosol, scattered, absorbed, gases = _transmittances(air_mass, ozone_mass)
    direct = outside * rayleigh * aerosol * gases

    a = np.log(1 - ASYMMETRY)  # eqs. 3-11 to 3-15: downward share of aerosol scattering
    forward, along = a * (1.459 + a * (0.1595 + a * 0.4129)), a * (0.0783 + a * (-0.3824 - a * 0.5874))
    downward = 1 - 0.5 * np.exp((forward + along * cosine) * cosine)
    downward_diffuse = 1 - 0.5 * np.exp((forward + along / _DIFFUSE_AIR_MASS) / _DIFFUSE_AIR_MASS)

    incident = outside * cosine * gases * absorbed
    from_air = incident * (1 - rayleigh**0.95) * 0.5  # eq. 3-5
    from_aerosol = incident * rayleigh**1.5 * (1 - scattered) * downward  # eq. 3-6
    # Light between ground and sky, eqs. 3-7 and 3-8. Its path lies below the ozone layer.
    rayleigh_d, _, scattered_d, absorbed_d, gases_d = _transmittances(_DIFFUSE_AIR_MASS, 0.0)
    aerosol_d = (1 - downward_diffuse) * rayleigh_d * (1 - scattered_d)
    sky_albedo = gases_d * absorbed_d * (0.5 * (1 - rayleigh_d) + aerosol_d)
    reflected = (direct * cosine + from_air + from_aerosol) * sky_albedo * GROUND_ALBEDO
    reflected = reflected / (1 - sky_albedo * GROUND_ALBEDO)
    blue = np.where(wavelength_nm <= 450, ((wavelength_nm + 550) / 1000) ** 1.8, 1.0)  # eq. 3-17
    return direct, (from_air + from_aerosol + reflected) * blue


def _transmittances(
    air_mass: float, ozone_mass: float
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray, FloatArray]:
    """Transmittances of Rayleigh scattering, aerosol, aerosol scattering alone, aerosol absorption alone, and gases.

    ``air_mass`` and ``ozone_mass`` are path lengths in units of the vertical path. Each transmittance is [n].
    """
    wavelength_nm, _, water, ozone, mixed = _table()
    um = wavelength_nm * 1e-3
    rayleigh = np.exp(-air_mass / (um**4 * (115.6406 - 1.335 / um**2)))  # eq. 2-4
    depth = TURBIDITY_500_NM * (wavelength_nm / 500.0) ** -ANGSTROM_EXPONENT  # eq. 2-7
    albedo = SCATTERING_ALBEDO_400_NM * np.exp(-SCATTERING_FALL * np.log(wavelength_nm / 400.0) ** 2)  # eq. 3-16
    vapour = water * WATER_CM * air_mass
    gases = np.exp(-0.2385 * vapour / (1 + 20.07 * vapour) ** 0.45)  # eq. 2-8
    gases *= np.exp(-ozone * OZONE_ATM_CM * ozone_mass)  # eq. 2-9
    gases *= np.exp(-1.41 * mixed * air_mass / (1 + 118.93 * mixed * air_mass) ** 0.45)  # eq. 2-11
    aerosol, scattered = np.exp(-depth * air_mass), np.exp(-albedo * depth * air_mass)
    return rayleigh, aerosol, scattered, np.exp(-(1 - albedo) * depth * air_mass), gases
