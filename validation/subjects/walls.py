"""An even wall lit by a named illuminant, or by an arbitrary spectrum, which scene files cannot express.

Tested in tests/validation/claims/test_light_checks.py.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from dasim.spectra import grid
from dasim.typing import FloatArray
from validation.subjects import rendering

WALL = {"name": "wall", "shape": "plane", "size_cm": (400, 400), "position_cm": (0, 0, 40)}
STEP_NM = 1e-3  # width of the spectral edge of a band-limited light


def wall(light: str | dict[str, Any], *, material: str = "white-paper", lux: float = 500.0) -> Any:
    """A Mitsuba scene of an even wall that fills the view.

    ``light`` is the name of an illuminant, with an illuminance of ``lux``, or a spectrum as a Mitsuba dictionary. The
    default material is white paper, because its reflectance is constant beyond 480 nm.
    """
    import mitsuba as mi

    from dasim.render import translate

    dome, lamp = rendering.EVEN_LIGHT
    if isinstance(light, str):
        dome = dome | {"illuminant": light, "lux": lux}
    described = translate.scene_dict(rendering.make_scene([WALL | {"material": material}], [dome, lamp]))
    if not isinstance(light, str):
        described["light_0000"] = {"type": "constant", "radiance": light, "sampling_weight": 0.0}
    return mi.load_dict(described, optimize=False)


def sharp_light(band_nm: tuple[float, float], power: FloatArray) -> dict[str, Any]:
    """A Mitsuba spectrum with the spectral power ``power`` [wavelength] within a band and no light outside.

    It is normalised to a mean of 1 W m^-2 sr^-1 nm^-1, so that only ratios of signals have a meaning.
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
