"""Verification of a dataset: checksums, shapes, ranges, specification, missing and extra samples."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterator
from fnmatch import fnmatch
from typing import Any

import numpy as np

from dasim.base.errors import InputError
from dasim.dataset import card, draws, plan, reading, storage
from dasim.dataset.plan import DESCRIPTION, LOGS, MANIFEST, SUMS
from dasim.dataset.sample import file_names, frame_name, key
from dasim.dataset.specification import DatasetSpec
from dasim.files.truth import PER_CHANNEL

ELECTRONS = dict.fromkeys(PER_CHANNEL, (0.0, 1e9))
RANGES = {"depth_m": (0.0, 1e6), "blur_px": (-1e4, 1e4), **ELECTRONS}
HARMLESS = (LOGS, "parts/*", "rows/*", DESCRIPTION)  # allowed files without a checksum
SHAPES = {"normal": 3, "sharp_srgb": 3, **dict.fromkeys(PER_CHANNEL)}  # last axis; None: one per channel


def problems(out: str, show: Callable[[float], None] = lambda share: None) -> Iterator[str]:
    """Problems of a dataset, one line each; ``show`` gets the share that is done.

    Raises InputError if the folder is not a dataset.
    """
    manifest = plan.manifest(out)
    spec = reading.spec_of(out)
    if not storage.exists(out, SUMS):
        yield f"is not finished: {SUMS} is missing; run 'dasim dataset make' again"
        return
    if plan.digest(manifest["spec"]) != manifest["spec_sha256"]:
        yield f"{MANIFEST}: the specification was changed after the dataset was made"
    yield from _files(out)
    try:
        rows = reading.index_rows(out)
    except InputError as error:
        yield str(error)
        return
    yield from _membership(out, spec, rows)
    groups: dict[str, list[dict[str, Any]]] = {}
    for row in rows:
        groups.setdefault(row["shard"], []).append(row)
    done = 0
    for group in plan.shards(spec):
        group_rows = {row["index"]: row for row in groups.get(group.name, [])}
        try:
            for index, files in reading.samples_of(out, spec, group, list(group_rows)) if group_rows else ():
                yield from _sample(spec, group_rows[index], files)
                done += 1
                show(done / max(len(rows), 1))
        except Exception as error:  # tar files, stores and decoders raise many types for damaged files
            yield f"{group.name}: cannot be read: {type(error).__name__}: {error}"


def _files(out: str) -> Iterator[str]:
    """Problems with checksums, and files that are not part of the dataset."""
    listed = set()
    *lines, rest = storage.read(out, SUMS).decode(errors="replace").split("\n")
    if rest:
        yield f"{SUMS}: is damaged at its end"
    for number, line in enumerate(lines, 1):
        digest, _, name = line.partition("  ")
        if len(digest) != 64 or not name:
            yield f"{SUMS}, line {number}: is damaged"
            continue
        listed.add(name)
        try:
            if card.sha256(out, name) != digest:
                yield f"{name}: its checksum differs"
        except FileNotFoundError:
            yield f"{name}: is missing"
    for name in storage.names(out):
        # A killed run may leave parts or rows in a finished dataset; nothing reads them, and the next run removes them.
        if name not in listed and name != SUMS and not any(fnmatch(name, known) for known in HARMLESS):
            yield f"{name}: is not part of the dataset"


def _membership(out: str, spec: DatasetSpec, rows: list[dict[str, Any]]) -> Iterator[str]:
    """Problems with the set of samples: each must occur once and in its shard, and each scene in one split."""
    expected = {index: group for group in plan.shards(spec) for index in group.indices}
    failed = {int(name.removeprefix("failed/").partition(".")[0]) for name in storage.names(out, "failed")}
    present: set[int] = set()
    split_of: dict[str, str] = {}
    for row in rows:
        index = row["index"]
        if index in present:
            yield f"sample {key(index)}: is twice in the index"
        present.add(index)
        group = expected.get(index)
        if group is None:
            yield f"sample {key(index)}: is not in the specification"
        elif (row["split"], row["shard"]) != (group.split, group.name):
            yield f"sample {key(index)}: is in {row['shard']}, not in {group.name}"
        if split_of.setdefault(row["scene"], row["split"]) != row["split"]:
            yield f"scene {row['scene']}: is in the splits {split_of[row['scene']]} and {row['split']}"
    for index in sorted(set(expected) - present - failed):
        yield f"sample {key(index)}: is missing"


def _sample(spec: DatasetSpec, row: dict[str, Any], files: dict[str, bytes]) -> Iterator[str]:
    """Problems of a sample with the row ``row`` of the index and ``files`` (bytes by name)."""
    name = f"sample {row['key']}"
    for file in file_names(spec):
        if hashlib.sha256(files[file]).hexdigest() != row["sha256"][file]:
            yield f"{name}: {file} does not have the checksum of the index"
            return
    sample = reading.decode(row, files)
    width, height = spec.size_px
    for number, raw in enumerate(sample.frames_dn):
        if raw.shape != (height, width) or raw.dtype != np.uint16:
            yield f"{name}: {frame_name(number)} is {raw.shape[1]} x {raw.shape[0]} of {raw.dtype}"
        elif raw.max() >= 2 ** sample.meta["camera"]["sensor"]["adc_bits"]:
            yield f"{name}: {frame_name(number)} has numbers beyond the range of the converter"
    margin = 2 * spec.truth.margin_px
    channels = len(sample.truth["channels"])
    for field, array in sample.truth.items():
        if not isinstance(array, np.ndarray):
            continue
        expected = (height - margin, width - margin)
        if field in SHAPES:
            expected = (*expected, SHAPES[field] or channels)  # type: ignore[assignment]
        if array.shape != expected:
            yield f"{name}: truth {field} has the shape {array.shape}, not {expected}"
        elif field in RANGES:
            valid = sample.truth.get("valid", np.isfinite(array if array.ndim == 2 else array[..., 0]))
            values = array[valid]
            low, high = RANGES[field]
            if values.size and not (np.isfinite(values).all() and low <= values.min() and values.max() <= high):
                yield f"{name}: truth {field} is not between {low:g} and {high:g}"
    about, index = sample.meta["sample"], row["index"]
    number, seeds = draws.scene_number(spec, index), draws.frame_seeds(spec, index)
    facts: tuple[tuple[str, Any, Any], ...] = (
        ("drawn", about["drawn"], draws.values(spec, index)),
        ("seed", sample.meta["seed"], draws.capture_seed(spec, index)),
        ("seeds of frames", [frame["seed"] for frame in about.get("frames", [sample.meta])], seeds),
        ("split", about["split"], draws.split_of_scene(spec, number)),
        ("scene", about["scene"], draws.scene_key(spec, number)),
    )
    for what, value, expectation in facts:
        if value != expectation:
            yield f"{name}: {what} differs from the specification"
