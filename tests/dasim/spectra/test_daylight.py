"""Sun and sky against an independent implementation of the same model, ``pvlib.spectrum.spectrl2``."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from pvlib.atmosphere import get_relative_airmass
from pvlib.spectrum import spectrl2

from dasim.spectra import daylight
from dasim.spectra.grid import WAVELENGTH_NM

TABLE = Path(daylight.__file__).parents[1] / "data" / "spctral2.csv"

# pvlib follows NREL's program ``spectrl2_2.c``, which differs from the report in two constants. Eq. 2-4 has 1.3366 for
# 1.335: at 400 nm and air mass 10.3 (5 degrees) 0.0016 / 0.4^2 of 115.6 times an optical depth of 3.7, 3.5e-4 of the
# light. Eq. 2-11 has 118.3 for 118.93: 0.45 * 0.5 % of the optical depth of oxygen, which is 1.1 at 760 nm, 2.6e-3.
RAYLEIGH, OXYGEN = 5e-4, 3e-3


@pytest.mark.parametrize("elevation_deg", [5.0, 15.0, 30.0, 48.2, 75.0, 90.0])
def test_sun_and_sky_agree_with_pvlib(elevation_deg):
    zenith_deg = 90.0 - elevation_deg
    theirs = spectrl2(
        apparent_zenith=zenith_deg,
        aoi=zenith_deg,
        surface_tilt=0.0,
        ground_albedo=daylight.GROUND_ALBEDO,
        surface_pressure=101_300.0,
        relative_airmass=get_relative_airmass(zenith_deg, model="kasten1966"),
        precipitable_water=daylight.WATER_CM,
        ozone=daylight.OZONE_ATM_CM,
        aerosol_turbidity_500nm=daylight.TURBIDITY_500_NM,
        dayofyear=1,
    )
    wavelength_nm = theirs["wavelength"]
    tabulated_nm, outside, mixed_gases = np.loadtxt(TABLE, delimiter=",", comments=("#", "w"), usecols=(0, 1, 4)).T
    # All of theirs is scaled by the day's distance to the sun; ours is at the mean distance.
    day = theirs["dni_extra"][wavelength_nm == 400.0, 0] / outside[tabulated_nm == 400.0]
    oxygen = np.interp(WAVELENGTH_NM, tabulated_nm, mixed_gases) > 0
    for ours, name in zip(daylight.sun_and_sky(elevation_deg), ("dni", "dhi"), strict=True):
        expected = np.interp(WAVELENGTH_NM, wavelength_nm, theirs[name][:, 0]) / day
        np.testing.assert_allclose(ours[oxygen], expected[oxygen], rtol=OXYGEN)
        np.testing.assert_allclose(ours[~oxygen], expected[~oxygen], rtol=RAYLEIGH)
