"""Reading of datasets, in either format."""

from __future__ import annotations

import io
import json
import tarfile
import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, overload

import cv2
import numpy as np
from numpy.typing import NDArray

from dasim.base.errors import InputError
from dasim.base.suggestions import did_you_mean
from dasim.base.toml import parse
from dasim.dataset import plan, storage
from dasim.dataset.plan import INDEX, Shard
from dasim.dataset.sample import file_names, frame_name, key
from dasim.dataset.specification import DatasetSpec
from dasim.files.captures import unscaled
from dasim.files.truth import read_truth_parts


@dataclass(frozen=True, eq=False)
class Sample:
    """A capture with its truth, as plain arrays."""

    index: int
    split: str
    raw_dn: NDArray[np.uint16]  # [h, w] the mosaic, the first frame
    truth: dict[str, Any]  # the stored fields of dasim.values.Truth, by name; see dasim.files.truth.truth_of
    meta: dict[str, Any]  # content of meta.json: camera, exposure, levels, provenance
    frames_dn: tuple[NDArray[np.uint16], ...] = ()  # all frames of a bracket or burst, ``raw_dn`` first


class Dataset(Sequence[Sample]):
    """Samples in the order of their indices; ``dataset[k]`` is the k-th sample that exists."""

    def __init__(self, path: str, rows: list[dict[str, Any]], spec: DatasetSpec) -> None:
        self.path, self.rows, self.spec = path, rows, spec

    def __len__(self) -> int:
        return len(self.rows)

    @overload
    def __getitem__(self, place: int) -> Sample: ...
    @overload
    def __getitem__(self, place: slice) -> Dataset: ...
    def __getitem__(self, place: int | slice) -> Sample | Dataset:
        if isinstance(place, slice):
            return Dataset(self.path, self.rows[place], self.spec)
        row = self.rows[place]
        ((_, files),) = _whole(self.path, self.spec, _shard(row), [row["index"]])
        return decode(row, files)

    def arrays(self) -> Arrays:
        """The samples as flat tables of arrays, numbers and texts, which PyTorch's own collate function batches."""
        return Arrays(self)

    def __iter__(self) -> Iterator[Sample]:
        """All samples in order; each shard is read in one pass, which is faster than sample by sample."""
        start = 0
        while start < len(self.rows):
            shard = self.rows[start]["shard"]
            end = start
            while end < len(self.rows) and self.rows[end]["shard"] == shard:
                end += 1
            some = {row["index"]: row for row in self.rows[start:end]}
            for index, files in _whole(self.path, self.spec, _shard(self.rows[start]), list(some)):
                yield decode(some[index], files)
            start = end


class Arrays(Sequence[dict[str, Any]]):
    """The samples of a dataset as :func:`arrays_of` flattens them, for ``torch.utils.data.DataLoader`` as it is."""

    def __init__(self, dataset: Dataset) -> None:
        self.dataset = dataset

    def __len__(self) -> int:
        return len(self.dataset)

    @overload
    def __getitem__(self, place: int) -> dict[str, Any]: ...
    @overload
    def __getitem__(self, place: slice) -> Arrays: ...
    def __getitem__(self, place: int | slice) -> dict[str, Any] | Arrays:
        return Arrays(self.dataset[place]) if isinstance(place, slice) else arrays_of(self.dataset[place])

    def __iter__(self) -> Iterator[dict[str, Any]]:
        return map(arrays_of, self.dataset)


def arrays_of(sample: Sample) -> dict[str, Any]:
    """A sample as a flat table of arrays, numbers and texts, without None, lists or tables in it.

    Whole numbers have a sign, because PyTorch computes with few unsigned types: raw numbers are int32, labels int64.
    Samples of one camera and one size have equal keys and shapes; names of objects and materials are left out.
    ``mosaic`` lists the channels of its rows, as ``G,IR/R,G``; ``frames_exposure_s`` [frame] belongs to ``frames_dn``
    [frame, h, w]; ``truth_offset_px`` (x, y) is the pixel of ``raw_dn`` at which the truth's arrays begin.
    """
    camera, about = sample.meta["camera"], sample.meta["sample"]
    signed = {"u2": np.int32, "u4": np.int64}
    arrays = {"raw_dn": sample.raw_dn, "frames_dn": np.stack(sample.frames_dn or (sample.raw_dn,))}
    arrays |= {name: value for name, value in sample.truth.items() if isinstance(value, np.ndarray)}
    return {
        "index": sample.index,
        "key": key(sample.index),
        "split": sample.split,
        "scene": about["scene"],
        "camera": camera["name"],
        "channels": ",".join(sample.truth["channels"]),
        "illuminant": sample.meta["illuminant"] or "",
        "exposure_s": sample.meta["exposure_s"],
        "gain": sample.meta["gain"],
        "f_number": camera["lens"]["f_number"],
        "focal_length_mm": camera["lens"]["focal_length_mm"],
        "focus_m": camera["lens"]["focus_distance_m"],
        "black_level_dn": camera["sensor"]["black_level_dn"],
        "adc_bits": camera["sensor"]["adc_bits"],
        "mosaic": "/".join(",".join(row) for row in camera["sensor"]["mosaic"]),
        "frames_exposure_s": np.array([frame["exposure_s"] for frame in about["frames"]]),
        "truth_offset_px": np.array(about["truth"]["offset_px"]),
        "intrinsic_matrix_px": np.array(sample.meta["intrinsic_matrix_px"]),
        **{name: about[name] for name in ("capture", "view", "rig_camera") if name in about},
        **({"world_to_camera": np.array(about["world_to_camera"])} if about.get("world_to_camera") else {}),
        **{name: value.astype(signed.get(value.dtype.str[1:], value.dtype)) for name, value in arrays.items()},
    }


def open_dataset(path: str | Path, split: str | None = None) -> Dataset:
    """A dataset, or one split of it, in a folder or at an fsspec address (``s3://...``).

    Raises InputError if there is no dataset, or it is not finished or has no such split.
    """
    where = str(path)
    spec = spec_of(where)
    if split is not None and split not in spec.splits:
        hint = did_you_mean(split, spec.splits)
        raise InputError(f"{where}: has no split '{split}'; it has {', '.join(spec.splits)}{hint}")
    rows = [row for row in index_rows(where) if split in (None, row["split"])]
    return Dataset(where, rows, spec)


def spec_of(where: str) -> DatasetSpec:
    """Specification of a dataset, from its manifest."""
    return parse(DatasetSpec, plan.manifest(where).get("spec"), f"{where}/{plan.MANIFEST}: spec")


def index_rows(where: str) -> list[dict[str, Any]]:
    """Rows of the index; raises InputError if it is missing."""
    parquet = parquet_library()
    try:
        table = parquet.read_table(io.BytesIO(storage.read(where, INDEX)))
    except FileNotFoundError:
        raise InputError(f"{where}: is not finished, it has no {INDEX}; run 'dasim dataset make' again") from None
    except Exception as error:  # the library raises many types for damaged files
        raise InputError(f"{where}/{INDEX}: cannot be read: {' '.join(str(error).split())}") from None
    return [dict(row) for row in table.to_pylist()]


def parquet_library() -> Any:
    """``pyarrow.parquet``; raises InputError if it is not installed."""
    try:
        import pyarrow.parquet
    except ImportError:
        raise InputError(
            "datasets need pyarrow; install it with pip install -c constraints.txt -e '.[dataset]'"
        ) from None
    return pyarrow.parquet


def samples_of(
    where: str, spec: DatasetSpec, group: Shard, indices: Sequence[int]
) -> Iterator[tuple[int, dict[str, bytes]]]:
    """Index and files (bytes by name) of samples of a shard; FileNotFoundError or KeyError where one is missing."""
    if not indices:
        return
    if spec.format == "folders":
        for index in indices:
            files = file_names(spec)
            yield index, {name: storage.read(where, f"{group.split}/{key(index)}/{name}") for name in files}
        return
    missing = {key(index): index for index in indices}
    with storage.reading(where, f"{group.name}.tar") as file, tarfile.open(fileobj=file, mode="r:") as tar:
        members: dict[str, dict[str, bytes]] = {}
        for info in tar:
            name, _, part = info.name.partition(".")
            member = tar.extractfile(info) if name in missing else None
            if member is None:
                continue
            members.setdefault(name, {})[part] = member.read()
            if part == file_names(spec)[-1]:
                yield missing.pop(name), members.pop(name)
                if not missing:
                    return
    if missing:
        raise KeyError(f"{group.name}.tar lacks {', '.join(missing)}")


def _whole(
    where: str, spec: DatasetSpec, group: Shard, indices: Sequence[int]
) -> Iterator[tuple[int, dict[str, bytes]]]:
    """The same as :func:`samples_of`, but with InputError for missing or damaged files."""
    try:
        yield from samples_of(where, spec, group, indices)
    except (OSError, EOFError, KeyError, tarfile.TarError) as error:
        text = " ".join(str(error.args[0] if isinstance(error, KeyError) else error).split())
        raise InputError(
            f"{where}: {group.name} is damaged or not whole ({text}); see 'dasim dataset verify'"
        ) from None


def decode(row: dict[str, Any], files: dict[str, bytes]) -> Sample:
    """A sample from its row of the index and its files (bytes by name)."""
    frames, meta = [], json.loads(files["meta.json"])
    for name in map(frame_name, range(row.get("frames", 1))):
        stored = cv2.imdecode(np.frombuffer(files[name], np.uint8), cv2.IMREAD_UNCHANGED)
        if stored is None:
            raise InputError(f"sample {row['key']}: {name} cannot be read")
        frames.append(unscaled(stored, meta, f"sample {row['key']}: {name}"))
    truth = truth_of(files["truth.exr"], f"sample {row['key']}: truth.exr")
    return Sample(row["index"], row["split"], frames[0], truth, meta, tuple(frames))


def truth_of(content: bytes, name: str = "truth.exr") -> dict[str, Any]:
    """Fields of the truth in a truth file, by name; raises InputError if it is damaged, which begins with ``name``.

    The content is written to a temporary file, because OpenEXR reads from disk only.
    """
    with tempfile.NamedTemporaryFile(suffix=".exr") as file:
        file.write(content)
        file.flush()
        try:
            return read_truth_parts(Path(file.name))
        except InputError as error:
            detail = str(error).removeprefix(f"{file.name}: ")
            raise InputError(f"{name}: is damaged ({detail}); see 'dasim dataset verify'") from None


def _shard(row: dict[str, Any]) -> Shard:
    return Shard(row["shard"], row["split"], ())
