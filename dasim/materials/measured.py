"""Reflectance spectra measured by the user: read, checked and resampled, never extrapolated.

Tested in tests/dasim/materials/test_library.py.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from dasim.base import untrusted
from dasim.base.errors import InputError
from dasim.spectra.grid import WAVELENGTH_NM
from dasim.typing import FloatArray


def resample(points: FloatArray, where: str) -> FloatArray:
    """Reflectance [wavelength] on ``WAVELENGTH_NM``, by linear interpolation of points [n, 2].

    A point is a wavelength in nm and a reflectance 0..1; wavelengths must increase and cover the whole grid. InputError
    names the first problem; ``where`` is the start of its message.
    """
    first, last = WAVELENGTH_NM[0], WAVELENGTH_NM[-1]
    if len(points) < 2 or (np.diff(points[:, 0]) <= 0).any():
        raise InputError(f"{where}: needs two or more wavelengths, each longer than the one before")
    low, high = points[0, 0], points[-1, 0]
    if low > first or high < last:
        raise InputError(
            f"{where}: reaches from {low:g} to {high:g} nm, must cover {first:g} to {last:g} nm; "
            "add measured or assumed values there; nothing is extrapolated"
        )
    ends = np.array([(nm, np.interp(nm, points[:, 0], points[:, 1])) for nm in (first, last)])
    inside = np.vstack([ends, points[(points[:, 0] >= first) & (points[:, 0] <= last)]])
    if inside[:, 1].max(initial=0.0) > 1:
        peak = inside[inside[:, 1].argmax()]
        hint = "; is it in percent?" if peak[1] > 1.5 else ""
        raise InputError(f"{where}: reflectance {peak[1]:g} at {peak[0]:g} nm; at most 1 is possible{hint}")
    if inside[:, 1].min(initial=0.0) < 0:
        low = inside[inside[:, 1].argmin()]
        raise InputError(f"{where}: reflectance {low[1]:g} at {low[0]:g} nm; it must not be negative")
    return np.clip(np.interp(WAVELENGTH_NM, points[:, 0], points[:, 1]), 0.0, 1.0)


def read(path: Path, where: str) -> FloatArray:
    """Points [n, 2] of a CSV file with the header ``wavelength_nm,reflectance``; lines that start with # are comments.

    Raises InputError if the file is missing or has another format; ``where`` is the start of its message.
    """
    lines = [line for line in untrusted.text(path, where).splitlines() if line.strip()]
    rows = [line for line in lines if not line.lstrip().startswith("#")]
    try:
        values = np.array([[float(cell) for cell in row.split(",")] for row in rows[1:]], float)
    except ValueError:
        values = np.empty((0, 0))
    if (
        not rows
        or rows[0].replace(" ", "") != "wavelength_nm,reflectance"
        or values.ndim != 2
        or values.shape[1:] != (2,)
    ):
        raise InputError(f"{where}: must be a CSV with the header wavelength_nm,reflectance and two numbers per line")
    if not np.isfinite(values).all():
        raise InputError(f"{where}: has values that are not finite")
    return values
