"""Export to the COCO format for object detection and segmentation (https://cocodataset.org/#format-data).

Tested in tests/dasim/dataset/test_export.py.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dasim.dataset.export.frames import (
    Frame,
    Labelled,
    Picture,
    check_parts,
    depth_unit_mm,
    frames,
    write_about,
    write_depth,
    write_json,
    write_picture,
)
from dasim.dataset.reading import Dataset
from dasim.scene.classes import CLASSES

ABOUT = """
`annotations/instances_SPLIT.json` lists the pictures `SPLIT/KEY.png` (sRGB) and an annotation per visible object,
with its class as category (the number in `dasim.CLASSES`, the same in every dataset), the visible mask as
uncompressed run lengths, area and box [x, y, width, height]. Keys beyond COCO's: of a picture `camera_matrix` [3, 3]
for pixel centres at whole numbers, `world_to_camera` [4, 4] (metres, null where unknown), `f_number`, `focus_m`,
`scene`, and where the dataset has depth `depth_file_name` (16 bits, 0 where nothing is hit) with `depth_scale_m`,
metres per step, z from the lens; of an annotation `object_name`, and `object_to_camera` [4, 4] (metres) of the axes
of the object in its scene file.
"""


def write(folder: Path, samples: Dataset, picture: Picture, show: Callable[[float], None]) -> None:
    """Write pictures and ``annotations/instances_SPLIT.json`` into a folder."""
    check_parts(samples, ("labels",), "--as coco")
    unit_mm = depth_unit_mm(samples) if "depth" in samples.spec.truth.keep else None
    parts: dict[str, dict[str, Any]] = {}
    for frame in frames(samples, picture, show):
        split = frame.sample.split
        part = parts.setdefault(split, {"images": [], "annotations": []})
        write_picture(folder / split / f"{frame.key}.png", frame.picture)
        part["images"].append(_image(frame))
        if unit_mm is not None:
            name = f"{split}/{frame.key}-depth.png"
            write_depth(folder / name, frame.depth_m, unit_mm)
            part["images"][-1] |= {"depth_file_name": Path(name).name, "depth_scale_m": unit_mm * 1e-3}
        for item in frame.objects:
            part["annotations"].append({"id": len(part["annotations"]) + 1, **_annotation(frame, item)})
    spec = samples.spec
    for split, part in parts.items():
        head = {
            "info": {"description": f"{spec.name}, {split}: {spec.description}", "version": spec.version},
            "licenses": [{"id": 1, "name": spec.licence, "url": ""}],
            "categories": [{"id": n, "name": name, "supercategory": "object"} for n, name in enumerate(CLASSES, 1)],
        }
        write_json(folder / "annotations" / f"instances_{split}.json", head | part)
    write_about(folder, samples, ABOUT)


def run_lengths(mask: NDArray[np.bool_]) -> list[int]:
    """COCO's uncompressed run lengths of a mask [h, w]: column by column, pixels outside and inside in turn."""
    values = mask.ravel(order="F")
    ends = np.flatnonzero(np.diff(values)) + 1
    lengths = np.diff([0, *ends, values.size]).tolist()
    return [0, *lengths] if values[0] else lengths


def box_of(mask: NDArray[np.bool_]) -> list[int]:
    """Box [x, y, width, height] of a mask [h, w] that is not empty."""
    rows, columns = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
    return [int(v) for v in (columns[0], rows[0], columns[-1] - columns[0] + 1, rows[-1] - rows[0] + 1)]


def _image(frame: Frame) -> dict[str, Any]:
    lens = frame.sample.meta["camera"]["lens"]
    height, width = frame.picture.shape[:2]
    return {
        "id": frame.sample.index,
        "file_name": f"{frame.key}.png",
        "width": width,
        "height": height,
        "license": 1,
        "scene": frame.scene,
        "camera_matrix": frame.intrinsic_px.tolist(),
        "world_to_camera": None if frame.world_to_camera is None else frame.world_to_camera.tolist(),
        "f_number": lens["f_number"],
        "focus_m": lens["focus_distance_m"],
    }


def _annotation(frame: Frame, item: Labelled) -> dict[str, Any]:
    mask = frame.object_id == item.number
    return {
        "image_id": frame.sample.index,
        "category_id": item.category,
        "segmentation": {"size": list(mask.shape), "counts": run_lengths(mask)},
        "area": int(mask.sum()),
        "bbox": box_of(mask),
        "iscrowd": 0,
        "object_name": item.name,
        "object_to_camera": None if item.to_camera is None else item.to_camera.tolist(),
    }
