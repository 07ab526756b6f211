"""Plan of a dataset before it is made: shards, size, manifest, and whether the output fits.

Tested in tests/dasim/dataset/test_make.py and tests/dasim/dataset/test_draws.py.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Sequence
from typing import Any, NamedTuple

from dasim.base.errors import InputError
from dasim.base.fingerprint import fingerprint
from dasim.dataset import storage
from dasim.dataset.draws import scene_number, split_of_scene
from dasim.dataset.sample import json_bytes
from dasim.dataset.specification import DatasetSpec, noise_model

SCHEMA = 1
MANIFEST = "dataset.json"
INDEX = "index.parquet"
SUMS = "SHA256SUMS"
DESCRIPTION = "croissant.json"  # by an export, of index and checksums
LOGS = "make*.log"  # one per run of several simultaneous ones
CLAIMS = "make-claims.log"  # empty; its bytes are locked, one per shard, by the run that makes the shard
# Bytes per pixel of each part of the truth with EXR's ZIP compression, measured on random scenes.
PART_BYTES = {
    "depth": 3.0,
    "normal": 5.0,
    "blur": 6.0,
    "labels": 0.5,
    "mean_e": 15.0,
    "mean_e_variance": 14.0,
    "sharp_e": 14.0,
    "focus_e": 14.0,
    "sharp_srgb": 11.0,
}
HALF_SHARE = 0.5  # size with half floats over that with single floats
RAW_BYTES = 1.5  # per pixel of raw.png
META_BYTES = 60_000
SPARE = 1.1  # safety factor: a shard exists twice while it is written, and sizes are estimates


class Shard(NamedTuple):
    """Samples that are stored together."""

    name: str  # split and number
    split: str
    indices: tuple[int, ...]


def shards(spec: DatasetSpec) -> tuple[Shard, ...]:
    """All shards, ordered by split and sample."""
    members: dict[str, list[int]] = {split: [] for split in spec.splits}
    for index in range(spec.made):
        members[split_of_scene(spec, scene_number(spec, index))].append(index)
    result = []
    for split, indices in members.items():
        for number, start in enumerate(range(0, len(indices), spec.samples_per_shard)):
            chunk = tuple(indices[start : start + spec.samples_per_shard])
            result.append(Shard(f"{split}-{number:06d}", split, chunk))
    return tuple(result)


def sample_bytes(spec: DatasetSpec) -> float:
    """Estimated size of a sample in bytes."""
    pixels = spec.size_px[0] * spec.size_px[1]
    margin = 2 * spec.truth.margin_px
    inner_pixels = (spec.size_px[0] - margin) * (spec.size_px[1] - margin)
    per_pixel = sum(
        PART_BYTES[part] * (HALF_SHARE if spec.truth.half and part not in ("depth", "labels") else 1.0)
        for part in spec.truth.keep
    )
    return pixels * RAW_BYTES * spec.frames.count + inner_pixels * per_pixel + META_BYTES


def check_space(spec: DatasetSpec, out: str, samples: int) -> None:
    """Raise InputError if ``samples`` further samples need more space than is free."""
    free, needed = storage.free_bytes(out), SPARE * samples * sample_bytes(spec)
    if free is not None and needed > free:
        raise InputError(
            f"{out}: {samples} samples need about {needed / 1e9:.3g} GB, {free / 1e9:.3g} GB are free; make room, or "
            "take fewer samples, fewer parts of the truth (truth.keep) or half floats (truth.half)"
        )


def log_name(part: tuple[int, int]) -> str:
    """Name of the log of a run; ``part`` is (k, n) for the k-th of n simultaneous runs."""
    return LOGS.replace("*", "" if part == (1, 1) else f"-{part[0]}-of-{part[1]}")


def description(spec: DatasetSpec, environment: dict[str, Any]) -> dict[str, Any]:
    """Manifest of a dataset: schema, specification and its hash, and what else determines pixels.

    That is the environment and, of a user's own noise model, the content of its files.
    """
    data = spec.model_dump(mode="json")
    own = {} if spec.noise is None else {"noise": fingerprint(noise_model(spec), variant=environment["variant"])}
    return {"schema": SCHEMA, "spec": data, "spec_sha256": digest(data), **own, **environment}


def digest(data: Any) -> str:
    """SHA-256 of a specification as plain values, with the keys that it was written with."""
    return hashlib.sha256(json.dumps(data, sort_keys=True).encode()).hexdigest()


def manifest(out: str) -> dict[str, Any]:
    """The manifest of a dataset; raises InputError if there is none, or one of a newer version."""
    try:
        content = storage.read(out, MANIFEST)
    except (FileNotFoundError, NotADirectoryError):
        raise InputError(f"{out}: is not a dataset, because it has no {MANIFEST}") from None
    try:
        data = json.loads(content)
        schema = int(data["schema"])
    except (ValueError, KeyError, TypeError, RecursionError) as error:
        raise InputError(f"{out}/{MANIFEST}: is damaged ({error})") from None
    if schema > SCHEMA:
        raise InputError(f"{out}: is of schema {schema}, newer than this dasim knows ({SCHEMA}); update dasim")
    return dict(data)


def begin(out: str, new: dict[str, Any]) -> None:
    """Write the manifest of a new dataset, or check that an existing one is the same.

    Raises InputError with the differences in the specification, variant, instruction set, libraries or code.
    """
    if not storage.exists(out, MANIFEST):
        there = [name for name in storage.names(out) if not name.startswith(".")]
        if there and not storage.exists(out, MANIFEST):  # another run may just have written it
            raise InputError(f"{out}: is neither a dataset nor empty ({there[0] or 'a file'}); choose another folder")
        storage.check_writable(out)
        storage.write(out, MANIFEST, json_bytes(new))
        return
    old = manifest(out)
    lines = differences(old, new)
    if lines and not differences(old | {"code": new.get("code")}, new):
        raise InputError(
            f"{out}: was begun by other code than this dasim's; continue it with that code, or choose another folder"
        )
    if lines:
        raise InputError(f"{out}: holds a different dataset: {'; '.join(lines[:8])}; choose another folder")
    storage.check_writable(out)


def differences(old: Any, new: Any, place: Sequence[str] = ()) -> list[str]:
    """Differences between two plain values, one line per key; ``place`` is the key path of the two values."""
    if isinstance(old, dict) and isinstance(new, dict):
        keys = [key for key in (*old, *(key for key in new if key not in old)) if key != "spec_sha256"]
        return [text for key in keys for text in differences(old.get(key), new.get(key), (*place, key))]
    if isinstance(old, list) and isinstance(new, list) and len(old) == len(new):
        pairs = enumerate(zip(old, new, strict=True))
        return [text for number, (a, b) in pairs for text in differences(a, b, (*place, str(number)))]
    return [] if old == new else [f"{'.'.join(place)} was {_short(old)}, now {_short(new)}"]


def _short(value: Any) -> str:
    text = json.dumps(value)
    return text if len(text) <= 60 else text[:57] + "..."
