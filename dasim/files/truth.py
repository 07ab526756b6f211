"""Ground truth as a multi-part EXR.

Tested in tests/dasim/files/test_captures.py.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from dasim.base import untrusted
from dasim.base.errors import InputError
from dasim.camera import geometry
from dasim.camera.depth_blur import boundary, signed_blur_px
from dasim.camera.specification import Camera
from dasim.files.exr import write_exr
from dasim.scene.classes import CLASSES
from dasim.values import TRUTH_PARTS, Truth

_XYZ = ("X", "Y", "Z")


# Attributes in the header of the first part.
NAMES = "objectAndMaterialNames"  # JSON: names of the numbers 1, 2, ... of objects, materials, classes in ``labels``
CHANNEL_ORDER = "channelOrder"  # names of the channels in our order; EXR stores them alphabetically

PER_CHANNEL = ("mean_e", "mean_e_variance", "sharp_e", "focus_e")  # parts with one layer per channel of the camera


def write_truth(path: Path, truth: Truth, keep: Sequence[str] = tuple(TRUTH_PARTS), *, half: bool = False) -> None:
    """Write the ground truth as a multi-part EXR; ``Z`` of the part ``depth`` is the depth in metres.

    Args:
        path: the file.
        truth: the ground truth.
        keep: names of the parts to write, of ``TRUTH_PARTS``; those that the truth lacks are left out.
        half: whether all parts except depth and labels are 16-bit floats, which have a precision of 11 bits.
    """
    import OpenEXR

    dtype = np.float16 if half else np.float32
    largest = np.finfo(dtype).max
    arrays: dict[str, dict[str, np.ndarray]] = {}
    if truth.has("depth_m"):
        arrays["depth"] = {"Z": truth.depth_m}
    if truth.has("normal"):
        arrays["normal"] = {axis: truth.normal[..., i] for i, axis in enumerate(_XYZ)}
    if truth.has(*TRUTH_PARTS["blur"]):
        arrays["blur"] = {"blur_px": truth.blur_px, "level": truth.level}
    if truth.has(*TRUTH_PARTS["labels"]):
        arrays["labels"] = {
            "object_id": truth.object_id,
            "material_id": truth.material_id,
            "valid": truth.valid.astype(np.uint32),
            "boundary": truth.boundary.astype(np.uint32),
        }
    if truth.has("sharp_srgb"):
        arrays["sharp_srgb"] = {name: truth.sharp_srgb[..., i] for i, name in enumerate("RGB")}
    for part in PER_CHANNEL:
        if truth.has(part):
            arrays[part] = {name: getattr(truth, part)[..., i] for i, name in enumerate(truth.channels)}
    if "labels" in arrays and truth.class_id is not None:
        arrays["labels"]["class_id"] = truth.class_id
    parts = []
    if not any(name in arrays for name in keep):
        truth.require(*TRUTH_PARTS[keep[0]])
    for name in (name for name in keep if name in arrays):
        channels = arrays[name]
        if name not in ("depth", "labels"):
            channels = {key: np.clip(value, -largest, largest).astype(dtype) for key, value in channels.items()}
        header = {"name": name, "type": OpenEXR.scanlineimage, "compression": OpenEXR.ZIP_COMPRESSION}
        parts.append(OpenEXR.Part(header, {key: np.ascontiguousarray(value) for key, value in channels.items()}))
    parts[0].header[CHANNEL_ORDER] = ",".join(truth.channels)
    parts[0].header[NAMES] = json.dumps({"objects": truth.objects, "materials": truth.materials, "classes": CLASSES})
    write_exr(path, parts)


def truth_of(values: dict[str, Any], camera: Camera, where: str) -> Truth:
    """A truth from the fields in a file, and from those that can be derived from its depth and the camera.

    Without the part ``blur``, blur and levels are computed from the depth. Without ``labels``, pixels with a depth are
    valid, and boundaries are computed from the blur. Fields of other parts are absent if ``values`` lacks them;
    messages about absent fields begin with ``where``.
    """
    found = dict(values)
    if "depth_m" in found:
        found.setdefault("valid", np.isfinite(found["depth_m"]))
        if "blur_px" not in found or "level" not in found:
            depth_m = found["depth_m"].astype(np.float64)
            blur = signed_blur_px(np.where(depth_m > 0, depth_m, np.nan), camera)
            found |= {"blur_px": blur.astype(np.float32)}
            found |= {"level": (blur / geometry.level_blur_px(camera)[1]).astype(np.float32)}
        if "boundary" not in found:
            found["boundary"] = boundary(found["blur_px"].astype(np.float64))
    return Truth.of_parts(found, where)


def read_truth_parts(path: Path) -> dict[str, Any]:
    """The fields of :class:`Truth` that a ground-truth EXR contains, by name; raises InputError if it
    cannot be read.
    """
    import OpenEXR

    if not path.exists():
        raise InputError(f"{path}: is missing")
    untrusted.check_exr(path, str(path))
    try:
        with untrusted.quiet(), OpenEXR.File(str(path), separate_channels=True) as file:
            parts = {p.name(): {k: c.pixels for k, c in p.channels.items()} for p in file.parts}
            names = tuple(file.parts[0].header[CHANNEL_ORDER].split(","))
            labels = json.loads(file.parts[0].header[NAMES])
        values: dict[str, Any] = {"channels": names}
        values |= {key: tuple(labels[key]) for key in ("objects", "materials")}
        if "depth" in parts:
            values["depth_m"] = parts["depth"]["Z"]
        if "blur" in parts:
            values |= {key: _single(parts["blur"][key]) for key in ("blur_px", "level")}
        if "labels" in parts:
            values |= {key: parts["labels"][key] for key in ("object_id", "material_id")}
            if "class_id" in parts["labels"]:
                values["class_id"] = parts["labels"]["class_id"]
            values |= {key: parts["labels"][key].astype(bool) for key in ("valid", "boundary")}
        orders: dict[str, Sequence[str]] = {"normal": _XYZ, "sharp_srgb": "RGB", **dict.fromkeys(PER_CHANNEL, names)}
        for part, order in orders.items():
            if part in parts:
                values[part] = np.stack([_single(parts[part][name]) for name in order], axis=-1)
        return values
    except KeyError as error:
        raise InputError(f"{path}: lacks {error}; it is not a truth file of dasim") from None
    except Exception as error:  # the library raises RuntimeError and other types for damaged files
        raise InputError(f"{path}: cannot be read, or is truncated ({error})") from None


def _single(channel: np.ndarray) -> np.ndarray:
    """A channel of half floats as single floats; single floats unchanged."""
    return channel.astype(np.float32, copy=False)
