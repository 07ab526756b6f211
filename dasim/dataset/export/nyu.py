"""Export to the layout of the labelled part of NYU Depth V2 (Silberman et al. 2012): a MATLAB 7.3 file per split.

Tested in tests/dasim/dataset/test_export.py.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dasim.dataset.export.frames import Frame, Picture, check_parts, frames, write_about
from dasim.dataset.export.hdf5 import COMPRESSION, library
from dasim.dataset.reading import Dataset
from dasim.scene.classes import CLASSES

ABOUT = """
`SPLIT.mat` is a MATLAB 7.3 file, which is HDF5, with the variables of `nyu_depth_v2_labeled.mat`. MATLAB's order of
axes: h5py and torch see them in reverse. In h5py `images` is [n, 3, w, h] uint8 sRGB; `depths` and `rawDepths` [n, w,
h] float32, z in metres from the lens, 0 where nothing is hit; `labels` [n, w, h] uint16, numbers of `names` from 1, 0
for nothing; `instances` [n, w, h] the object's number within its picture; `scenes` the name of each scene. Of their
own are `intrinsics` [n, 3, 3] (for pixel centres at whole numbers; transposed in h5py) and `f_numbers`,
`focusDistances` (metres). Deviations: the frames are not 640 x 480, `depths` is measured nowhere and filled nowhere,
so that it equals `rawDepths`; `accelData`, `namesToIds`, `rawDepthFilenames`, `rawRgbFilenames` and `sceneTypes` are
left out.
"""
USERBLOCK = 512  # bytes before the HDF5 file, for MATLAB's header


def write(folder: Path, samples: Dataset, picture: Picture, show: Callable[[float], None]) -> None:
    """Write the samples to ``SPLIT.mat`` files in a folder."""
    check_parts(samples, ("depth",), "--as nyu")
    h5py = library()
    done = 0
    for split in dict.fromkeys(row["split"] for row in samples.rows):
        rows = [row for row in samples.rows if row["split"] == split]
        part = Dataset(samples.path, rows, samples.spec)
        path = folder / f"{split}.mat"
        with h5py.File(path, "w", userblock_size=USERBLOCK) as file:
            share = len(rows) / len(samples)
            _write_split(h5py, file, part, picture, lambda x, at=done, of=share: show(at / len(samples) + x * of))  # type: ignore[misc]
        with path.open("r+b") as file:
            file.write(_header())
        done += len(rows)
    write_about(folder, samples, ABOUT)


def _write_split(h5py: Any, file: Any, samples: Dataset, picture: Picture, show: Callable[[float], None]) -> None:
    count, scenes = len(samples), []
    for number, frame in enumerate(frames(samples, picture, show)):
        values = _values(frame)
        if not number:
            for name, value in values.items():
                made = file.create_dataset(
                    name, (count, *value.shape), value.dtype, chunks=(1, *value.shape), **COMPRESSION
                )
                made.attrs["MATLAB_class"] = np.bytes_(_matlab_class(value.dtype))
        for name, value in values.items():
            file[name][number] = value
        scenes.append(frame.scene)
    _write_cells(h5py, file, "scenes", scenes)
    _write_cells(h5py, file, "names", CLASSES)


def _values(frame: Frame) -> dict[str, NDArray[Any]]:
    """Arrays of a frame in the order of axes that MATLAB reverses."""
    lens = frame.sample.meta["camera"]["lens"]
    depth = np.nan_to_num(frame.depth_m, nan=0.0).T
    values: dict[str, NDArray[Any]] = {"images": frame.picture.transpose(2, 1, 0), "depths": depth, "rawDepths": depth}
    if "object_id" in frame.sample.truth:
        category = np.zeros(frame.object_id.max() + 1, np.uint16)
        for item in frame.objects:
            category[item.number] = item.category
        values["labels"] = category[frame.object_id].T
        values["instances"] = frame.object_id.astype(np.uint16).T
    values["intrinsics"] = frame.intrinsic_px.T
    values["f_numbers"] = np.array([lens["f_number"]])
    values["focusDistances"] = np.array([lens["focus_distance_m"]])
    return values


def _matlab_class(dtype: np.dtype[Any]) -> str:
    return {"float32": "single", "float64": "double"}.get(dtype.name, dtype.name)


def _write_cells(h5py: Any, file: Any, name: str, texts: Sequence[str]) -> None:
    """A cell array of texts, as MATLAB stores it: references to arrays of UTF-16 units."""
    cells = file.create_dataset(name, (1, len(texts)), h5py.ref_dtype)
    cells.attrs["MATLAB_class"] = np.bytes_("cell")
    store = file.require_group("#refs#")
    for place, text in enumerate(texts):
        units = np.frombuffer(text.encode("utf-16-le"), np.uint16)[:, None]
        item = store.create_dataset(f"{name}_{place}", data=units)
        item.attrs["MATLAB_class"] = np.bytes_("char")
        item.attrs["MATLAB_int_decode"] = np.int32(2)
        cells[0, place] = item.ref


def _header() -> bytes:
    """The first 128 bytes of a MATLAB 7.3 file: text, version 2.0 and byte order."""
    text = b"MATLAB 7.3 MAT-file, Platform: dasim, HDF5 schema 1.00 ."
    return text.ljust(116) + bytes(8) + b"\x00\x02IM"
