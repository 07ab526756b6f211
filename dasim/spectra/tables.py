"""Bundled tables of spectra: CSV files with comments, which state source, licence and unit.

Tested in tests/dasim/spectra/test_tables.py.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from dasim.typing import FloatArray


def columns(path: Path) -> dict[str, FloatArray]:
    """Columns of a table by their names in its header; the first is ``wavelength_nm``."""
    lines = [line for line in path.read_text(encoding="utf-8").splitlines() if not line.startswith("#")]
    values = np.loadtxt(lines[1:], delimiter=",", ndmin=2).T
    return dict(zip(lines[0].split(","), np.ascontiguousarray(values), strict=True))
