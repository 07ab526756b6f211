"""Indices of refraction of conductors from 400 to 830 nm, where the tables of a Mitsuba scene end before.

Tested in tests/dasim/render/foreign/test_surfaces.py.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from dasim.render.foreign.notes import Notes
from dasim.render.plugin import spectrum_dict
from dasim.spectra.grid import WAVELENGTH_NM
from dasim.typing import FloatArray

PLUGINS = ("conductor", "roughconductor")
INDICES = ("eta", "k")  # real and imaginary part


def continue_index(props: Any, key: str, notes: Notes) -> None:
    """Extend the table of a conductor's index to 400 to 830 nm by its first and last values.

    Beyond the table, Mitsuba uses zero, with which a conductor would be a perfect mirror.
    """
    spectrum, what = props[key], f"{props.plugin_name()}.{key}"
    if not spectrum.is_uniform() and not _covers_band(spectrum.wavelengths):
        props[key] = _index_spectrum(np.array(spectrum.wavelengths), np.array(spectrum.values), what, notes)


def continue_material(props: Any, notes: Notes) -> None:
    """Replace a conductor's named material whose tables do not cover 400 to 830 nm by tables that do."""
    import mitsuba as mi

    name, resolver = props["material"] if "material" in props else "none", mi.file_resolver()
    paths = {key: Path(str(resolver.resolve(f"data/ior/{name}.{key}.spd"))) for key in INDICES}
    if "eta" in props or not all(path.is_file() for path in paths.values()):
        return  # none, or what Mitsuba refuses
    tables = {key: np.array(mi.spectrum_from_file(str(path))) for key, path in paths.items()}
    if all(_covers_band(nm) for nm, _ in tables.values()):
        return
    del props["material"]
    for key, (nm, values) in tables.items():
        props[key] = _index_spectrum(nm, values, f"{name}.{key}", notes)


def _covers_band(nm: Any) -> bool:
    return bool(min(nm) <= WAVELENGTH_NM[0] and max(nm) >= WAVELENGTH_NM[-1])


def _index_spectrum(nm: FloatArray, values: FloatArray, what: str, notes: Notes) -> Any:
    """Mitsuba's spectrum of a table [wavelength], constant beyond its ends."""
    import mitsuba as mi

    notes.add(f"spectrum {what} covers {nm[0]:g} to {nm[-1]:g} nm: it is constant beyond")
    return mi.load_dict(spectrum_dict(np.interp(WAVELENGTH_NM, nm, values)))
