"""The table ``captures.csv`` of a calibration folder: reading, and checks for completeness.

The table has one line per file. Columns may be in any order; lines that begin with # are comments:

| column | content |
|---|---|
| ``file`` | path of a raw file (see :mod:`recon.files.raw`) or a capture folder, relative to the folder |
| ``light`` | light behind the pinhole, a name of ``dasim list illuminants`` |
| ``depth_m`` | distance of the pinhole from the lens plane, metres; within ``DEPTH_TOLERANCE`` of a blur level |
| ``exposure_s`` | exposure time, seconds; optional for capture folders |
| ``gain`` | analogue gain, a factor on the camera's; 1 without the column |
| ``position`` | any name for the position of the source: pictures of one light, level and position differ in exposure \
and noise alone; one position without the column |
| ``shift_x_px``, ``shift_y_px`` | instead of ``position``: shift of the source's image in whole pixels |

Lines that agree in all but ``file`` are frames of one picture.

Tested in tests/recon/test_real_camera.py.
"""

from __future__ import annotations

import csv
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from dasim.base import untrusted
from dasim.base.errors import InputError
from dasim.base.suggestions import did_you_mean
from dasim.typing import FloatArray
from recon.levels import level_of

TABLE = "captures.csv"
NEEDED = ("file", "light", "depth_m")
SHIFTS = ("shift_x_px", "shift_y_px")
COLUMNS = (*NEEDED, "exposure_s", "gain", "position", *SHIFTS)
# In levels. Depths between levels are interpolated in dioptres between the measured depths, so the depth of a level may
# differ from its nominal one, but levels must stay well separated.
DEPTH_TOLERANCE = 0.25
ENOUGH_POSITIONS = 4  # per light and level, for an error of 2 % in the encircled energy of small kernels
_DISTANCES_HINT = "(see 'dasim calibrate --print-distances')"


@dataclass(frozen=True)
class Line:
    """One line of the table."""

    label: str  # file, or number of the line, for messages
    path: Path
    light: str
    level: int
    depth_m: float
    exposure_s: float | None
    gain: float | None
    position: str
    shift_px: tuple[int, int] | None


def read_table(
    folder: Path, level_depth_m: FloatArray, known_light: Callable[[str], object], behind: int = 0
) -> tuple[list[Line], list[str]]:
    """Valid lines of the table, and the problems of the others; ``behind`` is the number of levels behind the focus."""
    path = folder / TABLE
    if not path.is_file():
        raise InputError(f"captures {folder}: no table {TABLE}; it needs the columns {', '.join(COLUMNS[:4])}")
    try:
        text = untrusted.text(path, f"captures {path}").splitlines()
        numbers = [number for number, line in enumerate(text, 1) if line.strip() and not line.lstrip().startswith("#")]
        rows = list(csv.reader(text[number - 1] for number in numbers))
    except csv.Error as error:
        raise InputError(f"captures {path}: cannot be read as a table ({error})") from None
    names = [name.strip() for name in rows[0]] if rows else []
    unknown = [name for name in names if name not in COLUMNS]
    missing = [name for name in NEEDED if name not in names]
    if unknown or missing or len(set(names)) != len(names) or not rows[1:]:
        wrong = [f"unknown column '{name}'{did_you_mean(name, COLUMNS)}" for name in unknown] + [
            f"no column '{name}'" for name in missing
        ]
        raise InputError(
            f"captures {path}: {'; '.join(wrong) or 'a column twice, or no lines'}; columns are {', '.join(COLUMNS)}"
        )
    if ("shift_x_px" in names) != ("shift_y_px" in names) or ("position" in names and "shift_x_px" in names):
        raise InputError(f"captures {path}: give position, or shift_x_px with shift_y_px, or neither")
    lines, problems, seen = [], [], set()
    for number, row in zip(numbers[1:], rows[1:], strict=False):  # an entry in quotes may take several lines
        label = f"line {number}"
        if len(row) != len(names):
            problems.append(f"{label} of {TABLE}: has {len(row)} entries, the first line has {len(names)}")
            continue
        cells = {name: cell.strip() for name, cell in zip(names, row, strict=True)}
        label = cells["file"] or f"{label} of {TABLE}"
        if cells["file"] in seen:
            problems.append(f"{label}: occurs twice")
            continue
        seen.add(cells["file"])
        try:
            lines.append(_line(cells, label, folder, level_depth_m, known_light, behind))
        except InputError as error:
            problems.append(f"{label}: {error}")
    return lines, problems


def _line(
    cells: dict[str, str],
    label: str,
    folder: Path,
    level_depth_m: FloatArray,
    known_light: Callable[[str], object],
    behind: int,
) -> Line:
    """A line of the table; raises InputError if it is invalid."""
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
    exact = float(level_of(depth_m, level_depth_m))
    last = len(level_depth_m) - 1
    level = int(np.clip(round(exact), -behind, last))
    if abs(exact - level) > DEPTH_TOLERANCE:
        near = np.array(sorted({max(level - 1, -behind), level, min(level + 1, last)}))
        ends = 1 / level_depth_m[0], 1 / level_depth_m[-1]
        listed = ", ".join(f"{1 / (ends[0] + k / last * (ends[1] - ends[0])):.4g}" for k in near)
        raise InputError(
            f"depth_m {depth_m:g} is not the distance of a level; the nearest are {listed} m {_DISTANCES_HINT}"
        )
    shift: tuple[int, int] | None = None
    if SHIFTS[0] in cells:
        try:
            shift = int(cells[SHIFTS[1]]), int(cells[SHIFTS[0]])
        except ValueError:
            raise InputError(f"{' and '.join(SHIFTS)} must be whole numbers") from None
    position = cells.get("position", "")
    return Line(label, folder / cells["file"], cells["light"], level, depth_m, exposure_s, gain, position, shift)


def _number(cells: dict[str, str], name: str) -> float | None:
    """A number above 0; None for an empty cell."""
    text = cells.get(name, "")
    if not text:
        return None
    try:
        value = float(text)
    except ValueError:
        value = np.nan
    if not (np.isfinite(value) and value > 0):
        raise InputError(f"{name} '{text}' is not a number above 0")
    return value


def incomplete(lines: Sequence[Line]) -> list[str]:
    """Problems of the whole table: missing levels of a light, and different depths within a level."""
    lights = list(dict.fromkeys(line.light for line in lines))
    numbers = [line.level for line in lines]
    first, last = min(numbers, default=0), max(numbers, default=0)
    all_levels = range(min(first, 0), last + 1)
    problems = []
    for light in lights:
        absent = [str(k) for k in all_levels if not any(li.light == light and li.level == k for li in lines)]
        if absent:
            problems.append(f"{light} has no pictures of level {', '.join(absent)} {_DISTANCES_HINT}")
    if lines and last == 0:
        problems.append(f"pictures of two levels or more are needed {_DISTANCES_HINT}")
    for level in all_levels:
        depths = sorted({line.depth_m for line in lines if line.level == level})
        if len(depths) > 1:
            problems.append(f"level {level} has the depths {', '.join(f'{d:g}' for d in depths)} m, but must have one")
    return problems


def few_positions(lines: Sequence[Line]) -> tuple[str, ...]:
    """A note if there are few positions of the source."""
    if any(line.shift_px is not None for line in lines):
        return ()
    positions: dict[tuple[str, int], set[str]] = {}
    for line in lines:
        positions.setdefault((line.light, line.level), set()).add(line.position)
    few = min(len(names) for names in positions.values())
    if few >= ENOUGH_POSITIONS:
        return ()
    return (
        f"{few} position{'s' if few > 1 else ''} of the source per light and distance: errors of up to 10 % in the "
        f"encircled energy of small kernels are possible; with {ENOUGH_POSITIONS} positions, about 2 %",
    )
