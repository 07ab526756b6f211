"""What all exports share: a sample as a colour picture with depth, labels, intrinsics and pose, and its files.

Conventions of all exports: camera axes x right, y down, z forward (OpenCV); depth is z from the lens, never range;
intrinsic matrices hold for pixel centres at whole numbers, (0, 0) the first, as in OpenCV and COCO.

Tested in tests/dasim/dataset/test_export.py.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from dasim.base.errors import InputError, shortened
from dasim.base.toml import parse
from dasim.dataset.reading import Dataset, Sample
from dasim.dataset.sample import key
from dasim.files.png import write_png16
from dasim.scene.classes import CLASSES
from dasim.scene.specification import Scene, object_to_camera, world_to_camera
from dasim.typing import FloatArray

Picture = Callable[[Sample], NDArray[np.uint8]]  # of a sample: sRGB [h, w, 3], of the size of the raw picture
FINE_MM, COARSE_MM = 0.1, 1.0  # units of 16-bit depth: up to 6.5 m, and up to 65 m

DISTORTED = """
Distortion: the lens of {} has `distortion_per_mm`, and pictures and maps are distorted as the sensor records them. The
intrinsic matrix holds for the pinhole picture. A pixel at r mm from the axis shows what a pinhole shows at
r (1 + a1 r^2 + a2 r^4 + ...) mm, with a1, a2, ... the coefficients of the camera file: convert pixels with
`dasim.camera.distortion.to_pinhole_px` before the matrix is applied.
"""


class Labelled(NamedTuple):
    """An object that a frame shows."""

    number: int  # in ``object_id``
    name: str
    category: int  # number in ``dasim.CLASSES``, from 1; 0 for datasets without classes
    to_camera: FloatArray | None  # [4, 4] of its own axes into camera axes, metres; None for Mitsuba scenes


@dataclass(frozen=True)
class Frame:
    """A sample for an export; arrays are those of the truth without its margin, [h, w]."""

    sample: Sample
    key: str
    scene: str
    picture: NDArray[np.uint8]  # [h, w, 3] sRGB
    intrinsic_px: FloatArray  # [3, 3]
    world_to_camera: FloatArray | None  # [4, 4], metres; None for Mitsuba scenes
    objects: tuple[Labelled, ...]

    @property
    def depth_m(self) -> NDArray[np.float32]:
        """Depth, NaN where nothing is hit."""
        return np.asarray(self.sample.truth["depth_m"], np.float32)

    @property
    def object_id(self) -> NDArray[np.uint32]:
        """Number of the object, 0 for none."""
        return np.asarray(self.sample.truth["object_id"], np.uint32)


def check_parts(samples: Dataset, parts: tuple[str, ...], what: str) -> None:
    """Raise InputError where a dataset lacks parts of the truth that an export needs, has no samples, or names in its
    index a split that it does not have: splits become folders.
    """
    if stray := sorted({str(row["split"]) for row in samples.rows} - set(samples.spec.splits)):
        raise InputError(
            f"{samples.path}: the index has samples of a split {shortened(stray[0])}, which does not exist"
        )
    if missing := [part for part in parts if part not in samples.spec.truth.keep]:
        raise InputError(
            f"{samples.path}: lacks {', '.join(missing)} of the truth (truth.keep), which {what} needs; it has "
            f"{', '.join(samples.spec.truth.keep)}"
        )
    if not len(samples):
        raise InputError(f"{samples.path}: has no samples to export")


def frames(samples: Dataset, picture: Picture, show: Callable[[float], None]) -> Iterator[Frame]:
    """The samples as frames, in their order; ``show`` is called with the share that is done."""
    for number, sample in enumerate(samples):
        yield frame_of(sample, picture)
        show((number + 1) / len(samples))


def frame_of(sample: Sample, picture: Picture) -> Frame:
    """A sample as a frame."""
    part, intrinsic = inner(sample)
    scene = scene_of(sample)
    to_camera = {} if scene is None else {item.name: object_to_camera(item, scene) for item in scene.objects}
    classes = {item["object_id"]: item["class"] for item in sample.meta["provenance"].get("objects", ())}
    seen = np.unique(sample.truth["object_id"]) if "object_id" in sample.truth else np.empty(0, np.uint32)
    names = sample.truth["objects"]
    objects = tuple(
        Labelled(n, names[n - 1], CLASSES.index(classes[n]) + 1 if n in classes else 0, to_camera.get(names[n - 1]))
        for n in map(int, seen)
        if n > 0
    )
    return Frame(
        sample=sample,
        key=key(sample.index),
        scene=sample.meta["sample"]["scene"],
        picture=np.ascontiguousarray(picture(sample)[part]),
        intrinsic_px=intrinsic,
        world_to_camera=None if scene is None else world_to_camera(scene),
        objects=objects,
    )


def inner(sample: Sample) -> tuple[tuple[slice, slice], FloatArray]:
    """Where the truth lies in the raw picture, and its intrinsic matrix [3, 3] for pixel centres at whole numbers."""
    left, top = sample.meta["sample"]["truth"]["offset_px"]
    height, width = sample.raw_dn.shape
    intrinsic = np.array(sample.meta["intrinsic_matrix_px"], np.float64)
    intrinsic[:2, 2] -= (left + 0.5, top + 0.5)
    return (slice(top, height - top), slice(left, width - left)), intrinsic


def sharp(sample: Sample) -> NDArray[np.uint8]:
    """The picture of a sample through a pinhole, without blur and noise, of the size of the raw picture."""
    part, _ = inner(sample)
    whole = np.zeros((*sample.raw_dn.shape, 3), np.uint8)
    whole[part] = eight_bits(sample.truth["sharp_srgb"])
    return whole


def eight_bits(srgb: NDArray[Any]) -> NDArray[np.uint8]:
    """A picture 0..1 in 8 bits."""
    return np.rint(np.clip(srgb, 0, 1) * 255).astype(np.uint8)


def depth_unit_mm(samples: Dataset) -> float:
    """Millimetres that a step of 16-bit depth stands for, the same in all samples."""
    return FINE_MM if max(row["depth_max_m"] for row in samples.rows) * 1e3 / FINE_MM < 2**16 else COARSE_MM


def write_depth(path: Path, depth_m: NDArray[np.float32], unit_mm: float) -> None:
    """Depth as a 16-bit PNG in steps of ``unit_mm``; 0 where nothing is hit or the depth does not fit."""
    steps = np.rint(np.nan_to_num(depth_m, nan=0.0).astype(np.float64) * 1e3 / unit_mm)
    write_png16(path, np.where(steps < 2**16, steps, 0).astype(np.uint16))


def write_picture(path: Path, picture: NDArray[np.uint8]) -> None:
    """An sRGB picture [h, w, 3], or a grey one [h, w], as an 8-bit PNG."""
    order = picture if picture.ndim == 2 else picture[..., ::-1]
    path.parent.mkdir(parents=True, exist_ok=True)
    _, data = cv2.imencode(".png", np.ascontiguousarray(order))
    path.write_bytes(data.tobytes())


def write_json(path: Path, value: Any) -> None:
    """A plain value as JSON."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(value, indent=1) + "\n", encoding="utf-8")


def distorting(samples: Dataset) -> list[str]:
    """Names of a dataset's cameras whose lens has distortion, which an intrinsic matrix alone does not describe.

    It is that of the first sample of each camera.
    """
    first: dict[str, int] = {}
    for number, row in enumerate(samples.rows):
        first.setdefault(str(row["camera"]), number)
    return [name for name, number in first.items() if samples[number].meta["camera"]["lens"].get("distortion_per_mm")]


def write_about(folder: Path, samples: Dataset, text: str) -> None:
    """README.md of an export: what it was made from, and the conventions of its layout."""
    spec = samples.spec
    if names := distorting(samples):
        text = f"{text.strip()}\n\n{DISTORTED.format(', '.join(names)).strip()}"
    (folder / "README.md").write_text(
        f"# {spec.name} {spec.version}\n\nLicence: {spec.licence}. Exported by dasim.\n\n{text.strip()}\n",
        encoding="utf-8",
    )


def scene_of(sample: Sample) -> Scene | None:
    """The scene that a sample shows, as data; None for a Mitsuba scene, whose objects have no known pose."""
    data = sample.meta["provenance"]["scene"]
    return parse(Scene, data, f"sample {key(sample.index)}: scene") if "objects" in data else None
