"""Notes on what was changed in a Mitsuba scene, and checks of its values.

Tested in tests/dasim/render/foreign/test_scene.py.
"""

from __future__ import annotations

from collections import Counter
from typing import Any

import numpy as np

from dasim.base.errors import InputError
from dasim.scene.mitsuba_scene import MitsubaScene
from dasim.spectra.grid import WAVELENGTH_NM


class Notes:
    """Changes made to a scene, with their counts, in the order of their first occurrence."""

    def __init__(self) -> None:
        self.counts: Counter[str] = Counter()

    def add(self, what: str) -> None:
        """Count one more change of the kind ``what``."""
        self.counts[what] += 1

    def lines(self) -> list[str]:
        """One line per kind of change."""
        return [what if count == 1 else f"{what} ({count} times)" for what, count in self.counts.items()]


def check_values(values: Any, what: str, scene: MitsubaScene) -> None:
    """InputError where values are negative, infinite or NaN, as those of no surface or light are."""
    if not np.isfinite(values).all() or min(values) < 0:
        raise InputError(f"{scene.file}: {what} has values that are negative or not finite; 0 or more is allowed")


def note_range(spectrum: Any, what: str, notes: Notes) -> None:
    """Note where the scene's own spectrum does not cover the band from 400 to 830 nm."""
    if spectrum.is_uniform():
        return
    low, high = min(spectrum.wavelengths), max(spectrum.wavelengths)
    if high < WAVELENGTH_NM[-1]:
        notes.add(f"spectrum {what} ends at {high:g} nm: it is zero from there to 830 nm")
    if low > WAVELENGTH_NM[0]:
        notes.add(f"spectrum {what} begins at {low:g} nm: it is zero from 400 nm to there")
