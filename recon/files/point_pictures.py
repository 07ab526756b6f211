"""Calibration folders: a user's raw pictures of a point source, with a table of their exposures and distances.

The table ``captures.csv`` is described in :mod:`recon.files.point_table`.
"""

from __future__ import annotations

import csv
import json
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from dasim.base.errors import InputError
from dasim.camera.specification import Camera
from dasim.files.captures import load_capture
from dasim.files.folders import new_folder, software_versions
from dasim.files.png import write_png16
from dasim.typing import FloatArray
from dasim.values import Capture, PointPicture
from recon.calibration import source
from recon.files.point_table import SHIFTS, TABLE, Line, few_positions, incomplete, read_table
from recon.files.raw import load_raw
from recon.levels import level_of

KIND = "calibration pictures"
MOST_PROBLEMS = 30  # largest number of problems in one message


@dataclass(frozen=True)
class PicturesWithNotes:
    """Pictures of a folder, and notes for the user."""

    pictures: list[PointPicture]
    notes: tuple[str, ...]


def read_point_pictures(
    folder: Path,
    camera: Camera,
    level_depth_m: FloatArray,
    level_blur_px: FloatArray,
    *,
    known_light: Callable[[str], object],
    behind: int = 0,
    kind: str | None = None,
    progress: Callable[[str, float], None] = lambda stage, share: None,
) -> PicturesWithNotes:
    """Pictures of a calibration folder, cropped to a window about the source, for :func:`recon.calibrate`.

    A single InputError lists all problems: in the lines of the table, in files, pictures without a source or with a
    saturated one, and lights and levels without pictures.

    Args:
        folder: the folder with ``captures.csv``.
        camera: the camera of the pictures.
        level_depth_m: depth of each blur level, [level] metres.
        level_blur_px: blur diameter of each level, [level] pixels.
        known_light: raises InputError for an unknown light.
        behind: number of levels behind the focus, as far apart as those in front of it.
        kind: format of packed raw files.
        progress: called with the name of the stage and the share of it that is done, 0..1.
    """
    lines, problems = read_table(folder, level_depth_m, known_light, behind)
    problems += incomplete(lines)
    groups: dict[tuple[str, int], list[tuple[Line, Capture]]] = {}
    for number, line in enumerate(lines):
        try:
            capture = _load(line, camera, kind)
            groups.setdefault((line.light, line.level), []).append((line, capture))
        except InputError as error:
            problems.append(f"{line.label}: {error}")
        progress("reading pictures", (number + 1) / len(lines))
    pictures: list[PointPicture] = []
    worst = (np.inf, "")
    half_px = source.window_half_px(float(level_blur_px[-1]))
    for (light, _), loaded in groups.items():
        blur_px = _blur_px(loaded[0][0].depth_m, level_depth_m, level_blur_px)
        group, wrong = _cut(loaded, camera, blur_px, half_px)
        problems += wrong
        if not wrong:
            pictures += group
            ratio, channel = source.signal_to_noise(group, camera, abs(blur_px))
            worst = min(worst, (ratio, f"{channel} of {light} at {loaded[0][0].depth_m:g} m"))
            if ratio < source.LEAST_SNR:
                problems.append(
                    f"{light} at {loaded[0][0].depth_m:g} m: {channel} has a signal-to-noise ratio of {ratio:.2g}, "
                    f"less than {source.LEAST_SNR:g}; add longer exposures or more frames"
                )
    if problems:
        first = "; ".join(problems[:MOST_PROBLEMS])
        more = f"; and {len(problems) - MOST_PROBLEMS} more" if len(problems) > MOST_PROBLEMS else ""
        raise InputError(f"captures {folder}: {first}{more}")
    return PicturesWithNotes(
        pictures, (f"lowest signal-to-noise ratio: {worst[0]:.3g} ({worst[1]})", *few_positions(lines))
    )


def write_point_pictures(folder: Path, pictures: Iterable[PointPicture], camera: Camera) -> int:
    """Write a calibration folder with one 16-bit PNG per frame and ``meta.json``; returns the number of frames."""
    rows: list[list[object]] = []
    places: list[tuple[object, ...]] = []
    shifted = False
    with new_folder(folder, KIND) as new:
        (new / "pictures").mkdir()
        for picture in pictures:
            shifted = shifted or picture.shift_px is not None
            for frame in picture.frames_dn:
                name = f"pictures/{picture.light}-{picture.level:02d}-{len(rows):05d}.png"
                write_png16(new / name, frame)
                cells = (picture.light, repr(picture.depth_m), repr(picture.exposure_s), f"{float(picture.gain)!r}")
                rows.append([name, *cells])
                places.append((picture.position, *(picture.shift_px or ("", ""))[::-1]))
        last = SHIFTS if shifted else ("position",)
        with (new / TABLE).open("w", encoding="utf-8", newline="") as file:
            writer = csv.writer(file, lineterminator="\n")
            writer.writerow(("file", "light", "depth_m", "exposure_s", "gain", *last))
            of_place = slice(1, None) if shifted else slice(1)
            writer.writerows([*row, *place[of_place]] for row, place in zip(rows, places, strict=True))
        meta = {"camera": camera.model_dump(mode="json"), "software": software_versions()}
        (new / "meta.json").write_text(json.dumps(meta, indent=1) + "\n", encoding="utf-8")
    return len(rows)


def _blur_px(depth_m: float, level_depth_m: FloatArray, level_blur_px: FloatArray) -> float:
    """Visible blur diameter in pixels at a depth, linear in its level, negative behind the focus."""
    return float(level_of(depth_m, level_depth_m) * level_blur_px[-1] / (len(level_blur_px) - 1))


def _load(line: Line, camera: Camera, kind: str | None) -> Capture:
    """The picture of a line; a capture folder must match the camera, and the exposure of the table if given."""
    if not line.path.is_dir():
        return load_raw(line.path, camera, kind=kind, exposure_s=line.exposure_s, gain=line.gain)
    capture = load_capture(line.path)
    size = {"width_px": camera.sensor.width_px, "height_px": camera.sensor.height_px}
    if capture.camera.sensor.model_copy(update=size) != camera.sensor:
        raise InputError(f"is a capture of camera '{capture.camera.name}', which has another sensor")
    for name, in_table, in_capture in (
        ("exposure_s", line.exposure_s, capture.exposure_s),
        ("gain", line.gain, capture.gain),
    ):
        if in_table is not None and not np.isclose(in_table, in_capture):
            raise InputError(f"{name} is {in_table:g} in {TABLE} and {in_capture:g} in the capture")
    return capture


def _cut(
    loaded: list[tuple[Line, Capture]], camera: Camera, blur_px: float, half_px: int
) -> tuple[list[PointPicture], list[str]]:
    """Pictures of one light and level, cropped to windows about the source, and their problems."""
    problems: list[str] = []
    positions: dict[object, list[tuple[Line, Capture]]] = {}
    for line, capture in loaded:
        # Pictures with whole-pixel shifts share one window.
        positions.setdefault(line.position if line.shift_px is None else None, []).append((line, capture))
    pictures: list[PointPicture] = []
    for group in positions.values():
        shapes = {capture.raw_dn.shape for _, capture in group}
        if len(shapes) > 1:
            problems.append(f"{', '.join(line.label for line, _ in group[:3])} ...: have different sizes")
            continue
        wrong = []
        for line, capture in group:
            try:
                source.check(capture, camera, abs(blur_px), shortest=_is_shortest(line, capture, group))
            except InputError as error:
                wrong.append(f"{line.label}: {error}")
        problems += wrong
        if wrong:
            continue
        try:
            window = source.window([capture for _, capture in group], camera, abs(blur_px), half_px)
        except InputError as error:
            problems.append(f"{group[0][0].label}: {error}")
            continue
        pictures += _stacked(group, window, blur_px)
    return pictures, problems


def _is_shortest(line: Line, capture: Capture, group: list[tuple[Line, Capture]]) -> bool:
    """Whether a picture has the shortest exposure of its position, the only one that must not be saturated."""
    exposures = [c.exposure_s * c.gain for other, c in group if other.shift_px == line.shift_px]
    return capture.exposure_s * capture.gain <= min(exposures)


def _stacked(group: list[tuple[Line, Capture]], window: tuple[slice, slice], blur_px: float) -> list[PointPicture]:
    """Pictures [frame, h, w] of the frames with the same position and exposure, in the order of the table."""
    frames: dict[tuple[object, ...], list[tuple[Line, Capture]]] = {}
    for line, capture in group:
        frames.setdefault((line.shift_px, capture.exposure_s, capture.gain), []).append((line, capture))
    return [
        PointPicture(
            frames_dn=np.stack([source.without_hot_pixels(c)[window] for _, c in same]),
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
