"""Export to HDF5: one file per split, one group per sample, with all that the dataset has.

Tested in tests/dasim/dataset/test_export.py.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import numpy as np

from dasim.base.errors import InputError
from dasim.dataset.export.frames import inner, scene_of, write_about
from dasim.dataset.reading import Dataset, Sample
from dasim.dataset.sample import key
from dasim.scene.classes import CLASSES
from dasim.scene.specification import world_to_camera

ABOUT = """
`SPLIT.h5` has a group per sample, named by its key, with `raw_dn` [h, w] (the mosaic, black level included),
`frames_dn` [frame, h, w] where a sample has several, and the parts of the truth by name: `depth_m` (z in metres from
the lens, NaN where nothing is hit), `normal`, `blur_px`, `level`, `object_id`, `class_id`, `valid`, `mean_e` [h, w,
channel] and so on. `objects`, `materials` and `classes` are names: number n of `object_id`, `material_id` and
`class_id` is the n-th, 0 is nothing. Attributes of a group: `scene`, `camera`, `channels`, `f_number`,
`focal_length_mm`, `focus_m`, `exposure_s`, `gain`, `distortion_per_mm`, `intrinsic_px` [3, 3] for pixel centres at
whole numbers (OpenCV) of the truth's frame, and `world_to_camera` [4, 4] in metres where the pose is known. `meta` is
meta.json as text; its own intrinsic matrix has pixel centres at +0.5.

```python
import h5py

with h5py.File("train.h5") as file:
    for key, sample in file.items():
        sample["raw_dn"][:], sample["depth_m"][:], sample.attrs["intrinsic_px"]
```
"""
NAMES = ("objects", "materials")
COMPRESSION: dict[str, Any] = {"compression": "gzip", "compression_opts": 4, "shuffle": True}


def library() -> Any:
    """``h5py``; raises InputError if it is not installed."""
    try:
        import h5py
    except ImportError:
        raise InputError("HDF5 needs h5py; install it with pip install -c constraints.txt -e '.[formats]'") from None
    return h5py


def write(folder: Path, samples: Dataset, show: Callable[[float], None]) -> None:
    """Write the samples to ``SPLIT.h5`` files in a folder."""
    h5py = library()
    with ExitStack() as stack:
        files: dict[str, Any] = {}
        for number, sample in enumerate(samples):
            if sample.split not in files:
                files[sample.split] = stack.enter_context(h5py.File(folder / f"{sample.split}.h5", "w"))
                spec = samples.spec
                about = {"name": spec.name, "version": spec.version, "licence": spec.licence}
                files[sample.split].attrs.update(about)
            _write_sample(h5py, files[sample.split], sample)
            show((number + 1) / len(samples))
    write_about(folder, samples, ABOUT)


def _write_sample(h5py: Any, file: Any, sample: Sample) -> None:
    camera, scene = sample.meta["camera"], scene_of(sample)
    group = file.create_group(key(sample.index))
    arrays = {"raw_dn": sample.raw_dn}
    if len(sample.frames_dn) > 1:
        arrays["frames_dn"] = np.stack(sample.frames_dn)
    arrays |= {name: value for name, value in sample.truth.items() if isinstance(value, np.ndarray)}
    for name, value in arrays.items():
        group.create_dataset(name, data=value, **COMPRESSION)
    group["meta"] = json.dumps(sample.meta)
    for name in NAMES:
        if name in sample.truth:
            group.create_dataset(name, data=list(sample.truth[name]), dtype=h5py.string_dtype())
    group.create_dataset("classes", data=list(CLASSES), dtype=h5py.string_dtype())
    group.attrs.update(
        {
            "scene": sample.meta["sample"]["scene"],
            "camera": camera["name"],
            "channels": list(sample.truth["channels"]),
            "f_number": camera["lens"]["f_number"],
            "focal_length_mm": camera["lens"]["focal_length_mm"],
            "focus_m": camera["lens"]["focus_distance_m"],
            "exposure_s": sample.meta["exposure_s"],
            "gain": sample.meta["gain"],
            "distortion_per_mm": list(camera["lens"].get("distortion_per_mm") or ()),
            "intrinsic_px": inner(sample)[1],
        }
    )
    if scene is not None:
        group.attrs["world_to_camera"] = world_to_camera(scene)
