"""The table of a folder with pictures of a point source, ``captures.csv``: read, and checked for what is missing.

One line per file. Columns may be in any order; lines that begin with # are comments:

| column | holds |
|---|---|
| ``file`` | a raw file (see :mod:`recon.files.raw`) or a capture folder, by its path from the folder |
| ``light`` | the light that illuminates the pinhole, a name of ``dasim list illuminants`` |
| ``depth_m`` | distance of the pinhole from the lens plane, metres: within ``DEPTH_TOLERANCE`` of a blur level's own |
| ``exposure_s`` | exposure time, seconds; a capture folder says it itself |
| ``gain`` | analogue, a factor on the camera's own; 1 without the column |
| ``position`` | any name for where the source stood: pictures of one light, level and position differ in exposure and \
noise alone; one position without the column |
| ``shift_x_px``, ``shift_y_px`` | instead of ``position``: whole pixels by which the source's image was moved |

Lines that agree in all but ``file`` are frames of one picture.

Tested in tests/recon/test_real_camera.py.
"""

from __future__ import annotations

import csv
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from dasim.base.errors import InputError
from dasim.typing import FloatArray
from recon.levels import level_of

TABLE = "captures.csv"
NEEDED = ("file", "light", "depth_m")
SHIFTS = ("shift_x_px", "shift_y_px")
COLUMNS = (*NEEDED, "exposure_s", "gain", "position", *SHIFTS)
# Of a level. Depths between levels are straight lines in dioptres through the depths as measured, so that a level's
# kernels may belong to a depth beside its nominal one; but levels must not come close to each other.
DEPTH_TOLERANCE = 0.25
ENOUGH_POSITIONS = 4  # below, up to a tenth of a small kernel's light is misplaced; from here on, about 2 %
_TABLE_OF_LEVELS = "(see 'dasim calibrate --print-distances')"


@dataclass(frozen=True)
class Line:
    """One line of the table."""

    where: str
    path: Path
    light: str
    level: int
    depth_m: float
    exposure_s: float | None
    gain: float | None
    position: str
    shift_px: tuple[int, int] | None


def read_table(
    folder: Path, level_depth_m: FloatArray, known_light: Callable[[str], object]
) -> tuple[list[Line], list[str]]:
    """Lines of the table that can be used, and what is wrong with the others."""
    path = folder / TABLE
    if not path.is_file():
        raise InputError(f"captures {folder}: needs a table {TABLE} with the columns {', '.join(COLUMNS[:4])}")
    try:
        text = [line for line in path.read_text(encoding="utf-8-sig").splitlines() if line.strip()]
        rows = list(csv.reader(line for line in text if not line.lstrip().startswith("#")))
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise InputError(f"captures {path}: cannot be read as a table ({error})") from None
    names = [name.strip() for name in rows[0]] if rows else []
    unknown = [name for name in names if name not in COLUMNS]
    missing = [name for name in NEEDED if name not in names]
    if unknown or missing or len(set(names)) != len(names) or not rows[1:]:
        wrong = [f"unknown column '{name}'" for name in unknown] + [f"no column '{name}'" for name in missing]
        raise InputError(
            f"captures {path}: {'; '.join(wrong) or 'names twice, or no lines'}; columns are {', '.join(COLUMNS)}"
        )
    if ("shift_x_px" in names) != ("shift_y_px" in names) or ("position" in names and "shift_x_px" in names):
        raise InputError(f"captures {path}: give position, or shift_x_px with shift_y_px, or none of them")
    lines, problems, seen = [], [], set()
    for number, row in enumerate(rows[1:], 2):
        where = f"line {number}"
        if len(row) != len(names):
            problems.append(f"{where} of {TABLE}: has {len(row)} entries, the first line {len(names)}")
            continue
        cells = {name: cell.strip() for name, cell in zip(names, row, strict=True)}
        where = cells["file"] or f"{where} of {TABLE}"
        if cells["file"] in seen:
            problems.append(f"{where}: is named twice")
            continue
        seen.add(cells["file"])
        try:
            lines.append(_line(cells, where, folder, level_depth_m, known_light))
        except InputError as error:
            problems.append(f"{where}: {error}")
    return lines, problems


def _line(
    cells: dict[str, str], where: str, folder: Path, level_depth_m: FloatArray, known_light: Callable[[str], object]
) -> Line:
    """One line of the table; InputError for what is wrong in it."""
    if not cells["file"]:
        raise InputError("file is empty")
    if not (folder / cells["file"]).exists():
        raise InputError("no such file")
    known_light(cells["light"])
    depth_m = _number(cells, "depth_m")
    exposure_s, gain = _number(cells, "exposure_s"), _number(cells, "gain")
    if depth_m is None:
        raise InputError("depth_m is empty")
    if exposure_s is None and not (folder / cells["file"]).is_dir():
        raise InputError("exposure_s is missing")
    place = float(level_of(depth_m, level_depth_m))
    level = int(np.clip(round(place), 0, len(level_depth_m) - 1))
    if abs(place - level) > DEPTH_TOLERANCE:
        near = sorted({max(level - 1, 0), level, min(level + 1, len(level_depth_m) - 1)})
        listed = ", ".join(f"{level_depth_m[k]:.4g}" for k in near)
        raise InputError(f"depth_m {depth_m:g} is no level's distance; the nearest are {listed} m {_TABLE_OF_LEVELS}")
    shift: tuple[int, int] | None = None
    if SHIFTS[0] in cells:
        try:
            shift = int(cells[SHIFTS[1]]), int(cells[SHIFTS[0]])
        except ValueError:
            raise InputError(f"{' and '.join(SHIFTS)} must be whole numbers") from None
    position = cells.get("position", "")
    return Line(where, folder / cells["file"], cells["light"], level, depth_m, exposure_s, gain, position, shift)


def _number(cells: dict[str, str], name: str) -> float | None:
    """A number above 0, None where the cell is empty."""
    text = cells.get(name, "")
    if not text:
        return None
    try:
        value = float(text)
    except ValueError:
        value = np.nan
    if not (np.isfinite(value) and value > 0):
        raise InputError(f"{name} '{text}' is no number above 0")
    return value


def incomplete(lines: Sequence[Line]) -> list[str]:
    """Levels that a light lacks, and depths that differ within a level."""
    lights = list(dict.fromkeys(line.light for line in lines))
    last = max((line.level for line in lines), default=0)
    problems = []
    for light in lights:
        absent = [str(k) for k in range(last + 1) if not any(li.light == light and li.level == k for li in lines)]
        if absent:
            problems.append(f"{light} has no pictures of level {', '.join(absent)} {_TABLE_OF_LEVELS}")
    if lines and last == 0:
        problems.append(f"needs pictures of two levels or more {_TABLE_OF_LEVELS}")
    for level in range(last + 1):
        depths = sorted({line.depth_m for line in lines if line.level == level})
        if len(depths) > 1:
            problems.append(f"level {level} has the depths {', '.join(f'{d:g}' for d in depths)} m, must have one")
    return problems


def few_positions(lines: Sequence[Line]) -> tuple[str, ...]:
    """A note where the source stood at few places."""
    if any(line.shift_px is not None for line in lines):
        return ()
    places: dict[tuple[str, int], set[str]] = {}
    for line in lines:
        places.setdefault((line.light, line.level), set()).add(line.position)
    few = min(len(found) for found in places.values())
    if few >= ENOUGH_POSITIONS:
        return ()
    return (
        f"{few} position{'s' if few > 1 else ''} of the source a light and distance: up to a tenth of a small kernel's "
        f"light may be misplaced; {ENOUGH_POSITIONS} bring that to about 2 %",
    )
