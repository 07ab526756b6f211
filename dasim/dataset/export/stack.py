"""Export of stacks of focus and aperture: one folder per scene, as networks for depth from focus and defocus read them.

Tested in tests/dasim/dataset/test_export.py and, with views, tests/dasim/dataset/test_views.py.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from dasim.base.errors import InputError
from dasim.dataset.export.frames import (
    Frame,
    Picture,
    check_parts,
    frame_of,
    sharp,
    write_about,
    write_json,
    write_picture,
)
from dasim.dataset.reading import Dataset
from dasim.typing import FloatArray

ABOUT = """
One folder per scene, `SPLIT/SCENE/` (`SCENE-CAMERA/`, `SCENE-CAMERA-view-NUMBER/` where there are several cameras or
views), with a picture per capture, `NUMBER_focus-METRESm_f-NUMBER.png` (sRGB), `depth.npy` (float32 [h, w], z in metres
from the lens, NaN where nothing is hit), `intrinsics.txt` (3 x 3, pixel centres at whole numbers), `all-in-focus.png`
where the dataset has sharp pictures, and `stack.json`: scene, lens, pixel pitch, `world_to_camera` (4 x 4, metres,
OpenCV's axes; null for Mitsuba scenes), and of each picture file, focus distance, f-number, exposure, sample, and
`scale`.

A lens that focuses nearer stands farther from the sensor and shows less (focus breathing). All pictures are scaled
about the optical axis to the frame of the nearest focus, so that one `depth.npy` and one matrix hold for all of them;
blur in pixels is that of the sensor times `scale`. Distortion of the lens is not taken into account. Every picture
has its own exposure and white balance.
"""
Group = list[dict[str, Any]]


def write(folder: Path, samples: Dataset, picture: Picture, show: Callable[[float], None]) -> None:
    """Write the captures of each scene by each camera into a folder of their own."""
    check_parts(samples, ("depth",), "--as stack")
    groups: dict[tuple[str, str, str], Group] = {}
    for row in samples.rows:
        taken_by = f"{row['camera']}-view-{row['view']}" if row.get("view") else str(row["camera"])
        groups.setdefault((row["split"], row["scene"], taken_by), []).append(row)
    several = len({key[2] for key in groups}) > 1
    done = 0
    for (split, scene, taken_by), rows in groups.items():
        if len({(row["focus_m"], row["f_number"]) for row in rows}) < 2:
            raise InputError(
                f"{samples.path}: scene {scene} has one focus and f-number; a stack needs several: give "
                "scenes.captures_per_scene, and each = [...] for focus.distance_m or lens.f_number"
            )
        name = re.sub(r"[^\w.-]+", "-", f"{scene}-{taken_by}" if several else scene).lstrip(".") or "scene"
        while (folder / split / name).exists():  # two scenes whose names differ in other characters
            name += "-"
        _write_stack(folder / split / name, Dataset(samples.path, rows, samples.spec), picture)
        done += len(rows)
        show(done / len(samples))
    write_about(folder, samples, ABOUT)


def _write_stack(folder: Path, samples: Dataset, picture: Picture) -> None:
    folder.mkdir(parents=True)
    reference = min(range(len(samples)), key=lambda number: samples.rows[number]["focus_m"])
    nearest = frame_of(samples[reference], picture)
    np.save(folder / "depth.npy", nearest.depth_m)
    np.savetxt(folder / "intrinsics.txt", nearest.intrinsic_px)
    if "sharp_srgb" in nearest.sample.truth:
        write_picture(folder / "all-in-focus.png", frame_of(nearest.sample, sharp).picture)
    pictures = []
    for number, sample in enumerate(samples):
        frame = nearest if number == reference else frame_of(sample, picture)
        lens = sample.meta["camera"]["lens"]
        file = f"{number:03d}_focus-{lens['focus_distance_m']:.4f}m_f-{lens['f_number']:.2f}.png"
        write_picture(folder / file, aligned(frame, nearest.intrinsic_px))
        pictures.append(
            {
                "file": file,
                "focus_m": lens["focus_distance_m"],
                "f_number": lens["f_number"],
                "exposure_s": sample.meta["exposure_s"],
                "gain": sample.meta["gain"],
                "scale": float(nearest.intrinsic_px[0, 0] / frame.intrinsic_px[0, 0]),
                "sample": frame.key,
            }
        )
    camera = nearest.sample.meta["camera"]
    about = {
        "scene": nearest.scene,
        "camera": camera["name"],
        "focal_length_mm": camera["lens"]["focal_length_mm"],
        "pixel_pitch_um": camera["sensor"]["pixel_pitch_um"],
        "intrinsics": nearest.intrinsic_px.tolist(),
        "world_to_camera": None if nearest.world_to_camera is None else nearest.world_to_camera.tolist(),
        "pictures": pictures,
    }
    write_json(folder / "stack.json", about)


def aligned(frame: Frame, intrinsic_px: FloatArray) -> NDArray[np.uint8]:
    """The picture of a frame as a pinhole with another intrinsic matrix [3, 3] shows it, of the same size."""
    change = intrinsic_px @ np.linalg.inv(frame.intrinsic_px)
    if np.allclose(change, np.eye(3), atol=1e-12):
        return frame.picture
    size = frame.picture.shape[1::-1]
    scaled = cv2.warpAffine(frame.picture, change[:2], size, flags=cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE)
    return np.asarray(scaled, np.uint8)
