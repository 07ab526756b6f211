"""A folder with pictures of a point source, as a user takes them for calibration: raw files and ``captures.csv``.

One line of the table a file. Columns, in any order, lines from # on are remarks:

| column | holds |
|---|---|
| ``file`` | a raw file (see :mod:`recon.raw_files`) or a capture folder, by its path from the folder |
| ``light`` | the light that illuminates the pinhole, a name of ``dasim list illuminants`` |
| ``depth_m`` | distance of the pinhole from the lens plane, metres: within ``DEPTH_TOLERANCE`` of a blur level's own |
| ``exposure_s`` | exposure time, seconds; a capture folder says it itself |
| ``gain`` | analogue, a factor on the camera's own; 1 without the column |
| ``position`` | any name for where the source stood: pictures of one light, level and position differ in exposure and \
noise alone; one position without the column |
| ``shift_x_px``, ``shift_y_px`` | instead of ``position``: whole pixels by which the source's image was moved |

Lines that agree in all but ``file`` are frames of one picture.
"""

from __future__ import annotations

import csv
import json
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from dasim.camera import Camera
from dasim.errors import InputError
from dasim.files import load_capture, new_folder, software_versions, write_png16
from dasim.values import Capture, PointPicture
from recon import point_source
from recon.raw_files import load_raw

FloatArray = NDArray[np.float64]

TABLE = "captures.csv"
KIND = "calibration pictures"
NEEDED = ("file", "light", "depth_m")
SHIFTS = ("shift_x_px", "shift_y_px")
COLUMNS = (*NEEDED, "exposure_s", "gain", "position", *SHIFTS)
# Of a level. Depths between levels are straight lines in dioptres through the depths as measured, so that a level's
# kernels may belong to a depth beside its nominal one; but levels must not come close to each other.
DEPTH_TOLERANCE = 0.25
ENOUGH_POSITIONS = 4  # below, up to a tenth of a small kernel's light is misplaced; from here on, less than 2 %
MOST_PROBLEMS = 30  # that one message lists
_TABLE_OF_LEVELS = "(see 'dasim calibrate --print-distances')"


@dataclass(frozen=True)
class Found:
    """Pictures of a folder, and what a user should know of them."""

    pictures: list[PointPicture]
    notes: tuple[str, ...]


@dataclass(frozen=True)
class _Line:
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


def read_point_pictures(
    folder: Path,
    camera: Camera,
    level_depth_m: FloatArray,
    level_blur_px: FloatArray,
    *,
    known_light: Callable[[str], object],
    kind: str | None = None,
    progress: Callable[[str, float], None] = lambda stage, share: None,
) -> Found:
    """Pictures of a calibration folder, cut to a window about the source, for :func:`recon.calibrate`.

    ``level_depth_m`` and ``level_blur_px`` [level] are the camera's table of levels; ``known_light`` raises InputError
    for a light's name that is unknown; ``kind`` is the format of packed raw files. One InputError lists everything
    that is wrong: lines, files, what shows no source or is saturated, lights and levels without pictures.
    """
    lines, problems = _table(folder, level_depth_m, known_light)
    problems += _incomplete(lines)
    groups: dict[tuple[str, int], list[tuple[_Line, Capture]]] = {}
    for number, line in enumerate(lines):
        try:
            groups.setdefault((line.light, line.level), []).append((line, _load(line, camera, kind)))
        except InputError as error:
            problems.append(f"{line.where}: {error}")
        progress("reading pictures", (number + 1) / len(lines))
    pictures: list[PointPicture] = []
    worst = (np.inf, "")
    half_px = point_source.window_half_px(float(level_blur_px[-1]))
    for (light, _), loaded in groups.items():
        blur_px = _blur_px(loaded[0][0].depth_m, level_depth_m, level_blur_px)
        group, wrong = _cut(loaded, camera, blur_px, half_px)
        problems += wrong
        if not wrong:
            pictures += group
            ratio, channel = point_source.signal_to_noise(group, camera, blur_px)
            worst = min(worst, (ratio, f"{channel} of {light} at {loaded[0][0].depth_m:g} m"))
            if ratio < point_source.LEAST_SNR:
                problems.append(
                    f"{light} at {loaded[0][0].depth_m:g} m: {channel} has a signal-to-noise ratio of {ratio:.2g}, at "
                    f"least {point_source.LEAST_SNR:g} is needed; add longer exposures or more frames"
                )
    if problems:
        shown = "; ".join(problems[:MOST_PROBLEMS])
        more = f"; and {len(problems) - MOST_PROBLEMS} more" if len(problems) > MOST_PROBLEMS else ""
        raise InputError(f"captures {folder}: {shown}{more}")
    return Found(pictures, (f"signal-to-noise ratio at least {worst[0]:.3g} ({worst[1]})", *_few_positions(lines)))


def write_point_pictures(folder: Path, pictures: Iterable[PointPicture], camera: Camera) -> int:
    """Write pictures as such a folder, one 16-bit PNG a frame, ``meta.json`` beside it; how many frames there are."""
    rows: list[list[object]] = []
    shifted = False
    with new_folder(folder, KIND) as made:
        (made / "pictures").mkdir()
        for picture in pictures:
            shifted = shifted or picture.shift_px is not None
            place = picture.position if picture.shift_px is None else ""
            shift = ("", "") if picture.shift_px is None else picture.shift_px[::-1]
            for frame in picture.frames_dn:
                name = f"pictures/{picture.light}-{picture.level:02d}-{len(rows):05d}.png"
                write_png16(made / name, frame)
                said = (picture.light, repr(picture.depth_m), repr(picture.exposure_s), f"{picture.gain:g}")
                rows.append([name, *said, *(shift if shifted else (place,))])
        last = SHIFTS if shifted else ("position",)
        with (made / TABLE).open("w", encoding="utf-8", newline="") as file:
            writer = csv.writer(file, lineterminator="\n")
            writer.writerows([("file", "light", "depth_m", "exposure_s", "gain", *last), *rows])
        meta = {"camera": camera.model_dump(mode="json"), "software": software_versions()}
        (made / "meta.json").write_text(json.dumps(meta, indent=1) + "\n", encoding="utf-8")
    return len(rows)


def level_of(depth_m: float, level_depth_m: FloatArray) -> float:
    """Level, with its fraction, of a depth: levels are even steps in dioptres."""
    first, last = 1 / level_depth_m[0], 1 / level_depth_m[-1]
    return float((1 / depth_m - first) / (last - first) * (len(level_depth_m) - 1))


def _blur_px(depth_m: float, level_depth_m: FloatArray, level_blur_px: FloatArray) -> float:
    """Visible blur diameter of a depth, even steps of the levels' own."""
    return float(level_of(depth_m, level_depth_m) * level_blur_px[-1] / (len(level_blur_px) - 1))


def _table(
    folder: Path, level_depth_m: FloatArray, known_light: Callable[[str], object]
) -> tuple[list[_Line], list[str]]:
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
) -> _Line:
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
    place = level_of(depth_m, level_depth_m)
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
    return _Line(where, folder / cells["file"], cells["light"], level, depth_m, exposure_s, gain, position, shift)


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


def _incomplete(lines: Sequence[_Line]) -> list[str]:
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


def _few_positions(lines: Sequence[_Line]) -> tuple[str, ...]:
    """What is to be said where a source stood at few places."""
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
        f"light may be misplaced; {ENOUGH_POSITIONS} bring that below 2 %",
    )


def _load(line: _Line, camera: Camera, kind: str | None) -> Capture:
    """One picture; of a capture folder, that of this camera and with the table's exposure, if it says one."""
    if not line.path.is_dir():
        return load_raw(line.path, camera, kind=kind, exposure_s=line.exposure_s, gain=line.gain)
    capture = load_capture(line.path)
    size = {"width_px": camera.sensor.width_px, "height_px": camera.sensor.height_px}
    if capture.camera.sensor.model_copy(update=size) != camera.sensor:
        raise InputError(f"is a capture of camera '{capture.camera.name}', whose sensor is another")
    for name, said, own in (("exposure_s", line.exposure_s, capture.exposure_s), ("gain", line.gain, capture.gain)):
        if said is not None and not np.isclose(said, own):
            raise InputError(f"{name} is {said:g} in {TABLE} and {own:g} in the capture")
    return capture


def _cut(
    loaded: list[tuple[_Line, Capture]], camera: Camera, blur_px: float, half_px: int
) -> tuple[list[PointPicture], list[str]]:
    """Pictures of one light and level, cut to windows about the source, and what is wrong with them."""
    problems: list[str] = []
    places: dict[object, list[tuple[_Line, Capture]]] = {}
    for line, capture in loaded:
        # Whole-pixel shifts are those of one window.
        places.setdefault(line.position if line.shift_px is None else None, []).append((line, capture))
    pictures: list[PointPicture] = []
    for group in places.values():
        shapes = {capture.raw_dn.shape for _, capture in group}
        if len(shapes) > 1:
            problems.append(f"{', '.join(line.where for line, _ in group[:3])} ...: have different sizes")
            continue
        wrong = []
        for line, capture in group:
            try:
                point_source.check(capture, camera, blur_px, shortest=_is_shortest(line, capture, group))
            except InputError as error:
                wrong.append(f"{line.where}: {error}")
        problems += wrong
        if wrong:
            continue
        try:
            window = point_source.window([capture for _, capture in group], camera, blur_px, half_px)
        except InputError as error:
            problems.append(f"{group[0][0].where}: {error}")
            continue
        pictures += _stacked(group, window, blur_px)
    return pictures, problems


def _is_shortest(line: _Line, capture: Capture, group: list[tuple[_Line, Capture]]) -> bool:
    """Of its position's pictures, which alone must not be saturated."""
    own = [c.exposure_s * c.gain for other, c in group if other.shift_px == line.shift_px]
    return capture.exposure_s * capture.gain <= min(own)


def _stacked(group: list[tuple[_Line, Capture]], window: tuple[slice, slice], blur_px: float) -> list[PointPicture]:
    """Frames of the same place and exposure as one picture each, in the table's order."""
    frames: dict[tuple[object, ...], list[tuple[_Line, Capture]]] = {}
    for line, capture in group:
        frames.setdefault((line.shift_px, capture.exposure_s, capture.gain), []).append((line, capture))
    return [
        PointPicture(
            frames_dn=np.stack([point_source.without_hot_pixels(c)[window] for _, c in same]),
            light=same[0][0].light,
            level=same[0][0].level,
            depth_m=same[0][0].depth_m,
            blur_px=blur_px,
            shift_px=same[0][0].shift_px,
            exposure_s=same[0][1].exposure_s,
            gain=same[0][1].gain,
            position=same[0][0].position,
        )
        for same in frames.values()
    ]
