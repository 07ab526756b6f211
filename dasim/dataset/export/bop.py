"""Export to the scene-wise format of BOP, the benchmark for 6D object pose (Hodan et al. 2018).

Tested in tests/dasim/dataset/test_export.py.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from dasim.base.errors import InputError
from dasim.dataset.export.coco import box_of
from dasim.dataset.export.frames import (
    Frame,
    Labelled,
    Picture,
    check_parts,
    depth_unit_mm,
    distorting,
    frames,
    write_about,
    write_depth,
    write_json,
    write_picture,
)
from dasim.dataset.reading import Dataset
from dasim.scene.classes import CLASSES
from dasim.typing import FloatArray

ABOUT = """
The scene-wise format of BOP: `SPLIT/SCENE/` with `rgb/`, `depth/` and `mask_visib/` (`IMAGE_ANNOTATION.png`, 255
inside), `scene_camera.json` (`cam_K` row by row for pixel centres at whole numbers, `depth_scale` to millimetres,
`cam_R_w2c` and `cam_t_w2c` in millimetres), `scene_gt.json` (`obj_id`, `cam_R_m2c`, `cam_t_m2c` in millimetres) and
`scene_gt_info.json`. Depth is z from the lens, 0 where nothing is hit. Axes are OpenCV's. `objects.json` says which
object of which scene an `obj_id` is, and its class: objects of different scenes have different numbers.

Deviations: there are no 3D models, so that a pose is that of the object's own axes in its scene file, and nothing
knows an object's hidden part: `mask/`, `bbox_obj`, `px_count_all` and `visib_fract` are left out. Objects of Mitsuba
scenes have no known pose and no annotation.
"""
Table = dict[str, Any]


def write(folder: Path, samples: Dataset, picture: Picture, show: Callable[[float], None]) -> None:
    """Write the samples scene by scene into a folder."""
    check_parts(samples, ("depth", "labels"), "--as bop")
    if names := distorting(samples):
        raise InputError(
            f"--as bop: its cameras are pinholes, but the lens of {', '.join(names)} has distortion_per_mm; export to "
            "hdf5, coco or nyu"
        )
    unit_mm = depth_unit_mm(samples)
    scene_numbers = {name: n for n, name in enumerate(dict.fromkeys(row["scene"] for row in samples.rows))}
    tables: dict[Path, tuple[Table, Table, Table]] = {}
    numbers: dict[tuple[str, str], int] = {}
    objects: Table = {}
    first: Frame | None = None
    for frame in frames(samples, picture, show):
        first = first or frame
        place = folder / frame.sample.split / f"{scene_numbers[frame.scene]:06d}"
        cameras, poses, infos = tables.setdefault(place, ({}, {}, {}))
        image = len(cameras)
        write_picture(place / "rgb" / f"{image:06d}.png", frame.picture)
        write_depth(place / "depth" / f"{image:06d}.png", frame.depth_m, unit_mm)
        cameras[str(image)] = _camera(frame, unit_mm)
        poses[str(image)], infos[str(image)] = [], []
        for item in (item for item in frame.objects if item.to_camera is not None):
            number = numbers.setdefault((frame.scene, item.name), len(numbers) + 1)
            objects[str(number)] = {"scene": frame.scene, "name": item.name, "class": _class(item)}
            mask = frame.object_id == item.number
            annotation = len(poses[str(image)])
            write_picture(place / "mask_visib" / f"{image:06d}_{annotation:06d}.png", mask.astype(np.uint8) * 255)
            poses[str(image)].append({"obj_id": number, **_pose(item.to_camera, "m2c")})
            valid = int((mask & np.isfinite(frame.depth_m)).sum())
            info = {"bbox_visib": box_of(mask), "px_count_visib": int(mask.sum()), "px_count_valid": valid}
            infos[str(image)].append(info)
    for place, parts in tables.items():
        for name, table in zip(("scene_camera", "scene_gt", "scene_gt_info"), parts, strict=True):
            write_json(place / f"{name}.json", table)
    assert first is not None  # check_parts
    write_json(folder / "camera.json", _sensor(first, unit_mm))
    write_json(folder / "objects.json", objects)
    write_about(folder, samples, ABOUT)


def _class(item: Labelled) -> str | None:
    return CLASSES[item.category - 1] if item.category else None


def _pose(matrix: FloatArray | None, name: str) -> Table:
    """Rotation row by row and translation in millimetres of a rigid transform [4, 4] in metres."""
    if matrix is None:
        return {}
    return {f"cam_R_{name}": matrix[:3, :3].ravel().tolist(), f"cam_t_{name}": (1e3 * matrix[:3, 3]).tolist()}


def _camera(frame: Frame, unit_mm: float) -> Table:
    return {
        "cam_K": frame.intrinsic_px.ravel().tolist(),
        "depth_scale": unit_mm,
        **_pose(frame.world_to_camera, "w2c"),
    }


def _sensor(frame: Frame, unit_mm: float) -> Table:
    """The camera of the first frame; that of each frame is in ``scene_camera.json``."""
    matrix, (height, width) = frame.intrinsic_px, frame.picture.shape[:2]
    names = {"fx": (0, 0), "fy": (1, 1), "cx": (0, 2), "cy": (1, 2)}
    values = {name: float(matrix[place]) for name, place in names.items()}
    return {**values, "width": width, "height": height, "depth_scale": unit_mm}
