"""An even wall, lit by a named illuminant or by any spectrum, which scene files cannot express.

Tested in tests/validation/claims/test_checks.py.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from dasim.spectra import grid
from dasim.typing import FloatArray
from validation.subjects import rendering

WALL = {"name": "wall", "shape": "plane", "size_cm": (400, 400), "position_cm": (0, 0, 40)}
STEP_NM = 1e-3  # over which a sharp light rises


def wall(light: str | dict[str, Any], *, material: str = "white-paper", lux: float = 500.0) -> Any:
    """Mitsuba's scene of an even wall under an illuminant of ``lux``, or under a spectrum in Mitsuba's words.

    White paper, because its reflectance does not change beyond 480 nm.
    """
    import mitsuba as mi

    from dasim.render import translate

    dome, lamp = rendering.EVEN_LIGHT
    if isinstance(light, str):
        dome = dome | {"illuminant": light, "lux": lux}
    described = translate.scene_dict(rendering.make_scene([WALL | {"material": material}], [dome, lamp]))
    if not isinstance(light, str):
        described["light_0000"]["radiance"] = light
    return mi.load_dict(described, optimize=False)


def sharp_light(band_nm: tuple[float, float], power: FloatArray) -> dict[str, Any]:
    """A light of a spectral power [wavelength] within a band and none outside, in Mitsuba's words.

    Its level is of no meaning: about 1 W m^-2 sr^-1 nm^-1.
    """
    low, high = band_nm
    nm = grid.WAVELENGTH_NM
    inside = nm[(nm > low) & (nm < high)]
    places = np.array([nm[0], low - STEP_NM, low, *inside, high, high + STEP_NM, nm[-1]])
    values = np.interp(places, nm, power) * ((places >= low) & (places <= high))
    values /= values[values > 0].mean()
    return {
        "type": "irregular",
        "wavelengths": ",".join(f"{place:.9g}" for place in places),
        "values": ",".join(f"{value:.9g}" for value in values),
    }
