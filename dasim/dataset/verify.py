"""Check a dataset: checksums, shapes, ranges, specification, missing and surplus samples.

Tested in tests/dasim/dataset/test_specification.py.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterator
from fnmatch import fnmatch
from typing import Any

import numpy as np

from dasim.base.errors import InputError
from dasim.dataset import card, draws, plan, reading, storage
from dasim.dataset.plan import LOGS, MANIFEST, SUMS
from dasim.dataset.sample import FILES, key
from dasim.dataset.specification import DatasetSpec

RANGES = {"depth_m": (0.0, 1e6), "blur_px": (-1e4, 1e4), "mean_e": (0.0, 1e9), "sharp_e": (0.0, 1e9)}
SHAPES = {"normal": 3, "mean_e": None, "sharp_e": None, "sharp_srgb": 3}  # last axis; None: a channel each


def problems(out: str, show: Callable[[float], None] = lambda share: None) -> Iterator[str]:
    """Problems of a dataset, one line each, as they are found. InputError where the folder is not a dataset."""
    described = plan.manifest(out)
    spec = reading.spec_of(out)
    if not storage.exists(out, SUMS):
        yield f"is not finished: {SUMS} is missing; run 'dasim dataset make' again"
        return
    if plan.description(spec, {})["spec_sha256"] != described["spec_sha256"]:
        yield f"{MANIFEST}: the specification is not the one that it was written with"
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
        own = {row["index"]: row for row in groups.get(group.name, [])}
        try:
            for index, files in reading.samples_of(out, spec, group, list(own)) if own else ():
                yield from _sample(spec, own[index], files)
                done += 1
                show(done / max(len(rows), 1))
        except Exception as error:  # of tar files, stores and decoders, for damaged files
            yield f"{group.name}: cannot be read: {type(error).__name__}: {error}"


def _files(out: str) -> Iterator[str]:
    """Wrong checksums, and files that do not belong to the dataset."""
    known = set()
    *lines, rest = storage.read(out, SUMS).decode(errors="replace").split("\n")
    if rest:
        yield f"{SUMS}: is damaged at its end"
    for number, line in enumerate(lines, 1):
        digest, _, name = line.partition("  ")
        if len(digest) != 64 or not name:
            yield f"{SUMS}, line {number}: is damaged"
            continue
        known.add(name)
        try:
            if card.sha256(out, name) != digest:
                yield f"{name}: its checksum differs"
        except FileNotFoundError:
            yield f"{name}: is missing"
    for name in storage.names(out):
        if name not in known and name != SUMS and not fnmatch(name, LOGS):
            yield f"{name}: is not part of the dataset"


def _membership(out: str, spec: DatasetSpec, rows: list[dict[str, Any]]) -> Iterator[str]:
    """Samples that the specification asks for, once each and in their shards; scenes in one split each."""
    asked = {index: group for group in plan.shards(spec) for index in group.indices}
    given_up = {int(name.removeprefix("failed/").partition(".")[0]) for name in storage.names(out, "failed")}
    seen: set[int] = set()
    split_of: dict[str, str] = {}
    for row in rows:
        index = row["index"]
        if index in seen:
            yield f"sample {key(index)}: is twice in the index"
        seen.add(index)
        group = asked.get(index)
        if group is None:
            yield f"sample {key(index)}: is not asked for by the specification"
        elif (row["split"], row["shard"]) != (group.split, group.name):
            yield f"sample {key(index)}: is in {row['shard']}, not in {group.name}"
        if split_of.setdefault(row["scene"], row["split"]) != row["split"]:
            yield f"scene {row['scene']}: is in the splits {split_of[row['scene']]} and {row['split']}"
    for index in sorted(set(asked) - seen - given_up):
        yield f"sample {key(index)}: is missing"


def _sample(spec: DatasetSpec, row: dict[str, Any], files: dict[str, bytes]) -> Iterator[str]:
    name = f"sample {row['key']}"
    for file in FILES:
        if hashlib.sha256(files[file]).hexdigest() != row["sha256"][file]:
            yield f"{name}: {file} is not what the index says"
            return
    found = reading.decoded(row, files)
    width, height = spec.size_px
    if found.raw_dn.shape != (height, width) or found.raw_dn.dtype != np.uint16:
        yield f"{name}: raw.png is {found.raw_dn.shape[1]} x {found.raw_dn.shape[0]} of {found.raw_dn.dtype}"
    elif found.raw_dn.max() >= 2 ** found.meta["camera"]["sensor"]["adc_bits"]:
        yield f"{name}: raw.png has numbers beyond the converter's"
    margin = 2 * spec.truth.margin_px
    channels = len(found.truth["channels"])
    for field, array in found.truth.items():
        if not isinstance(array, np.ndarray):
            continue
        wanted = (height - margin, width - margin)
        if field in SHAPES:
            wanted = (*wanted, SHAPES[field] or channels)  # type: ignore[assignment]
        if array.shape != wanted:
            yield f"{name}: truth {field} has the shape {array.shape}, not {wanted}"
        elif field in RANGES:
            valid = found.truth.get("valid", np.isfinite(array if array.ndim == 2 else array[..., 0]))
            values = array[valid]
            low, high = RANGES[field]
            if values.size and not (np.isfinite(values).all() and low <= values.min() and values.max() <= high):
                yield f"{name}: truth {field} is not within {low:g} and {high:g}"
    about, index = found.meta["sample"], row["index"]
    number = draws.scene_number(spec, index)
    facts: tuple[tuple[str, Any, Any], ...] = (
        ("what was drawn", about["drawn"], draws.values(spec, index)),
        ("seed", found.meta["seed"], draws.capture_seed(spec, index)),
        ("split", about["split"], draws.split_of_scene(spec, number)),
        ("scene", about["scene"], draws.scene_key(spec, number)),
    )
    for what, is_now, should in facts:
        if is_now != should:
            yield f"{name}: {what} is not as the specification says"
