"""Datasets for the tests (a wall under a lamp, which renders 20 samples per second), and executors for them."""

from __future__ import annotations

import os
import resource
import signal
import time
from collections import deque
from collections.abc import Generator
from pathlib import Path

import numpy as np

from dasim.base.errors import InputError
from dasim.base.executors import Outcome
from dasim.dataset import plan, storage, verify
from dasim.dataset.make import make
from dasim.dataset.sample import Job, provenance
from dasim.dataset.specification import load_spec
from dasim.dataset.work import work
from dasim.render import backend

WALL = """
name = "wall"
focus_cm = 40
[[lights]]
kind = "lamp"
illuminant = "D65"
lux = 1000
position_cm = [0, -30, -60]
target_cm = [0, 0, 40]
radius_cm = 5
[[objects]]
name = "wall"
shape = "plane"
size_cm = [60, 60]
position_cm = [0, 0, 50]
material = "brick"
"""
MESH = """
[[objects]]
name = "thing"
shape = "mesh"
file = "thing.obj"
position_cm = [0, 0, 40]
material = "grey-card"
"""
SQUARE = "v -1 -1 0\nv 1 -1 0\nv 1 1 0\nv -1 1 0\nf 1 3 2\nf 1 4 3\n"
SPEC = """
name = "tiny"
samples = {samples}
size_px = [32, 24]
spp = 4
diffraction = "off"
samples_per_shard = {samples_per_shard}
format = "{format}"
{top}
[scenes]
family = "files"
files = {files}
[exposure]
auto_level = {{uniform = [0.1, 0.3]}}
{more}
"""
WAIT_S = 60.0
SAMPLES = 24  # of the dataset whose last two samples the executor :func:`deadly` ends


def spec_file(folder: Path, *, samples: int = 6, top: str = "", more: str = "", **changes) -> Path:
    """Write the specification of a tiny dataset and its scene into a folder; returns the path of the specification."""
    (folder / "wall.toml").write_text(WALL)
    fields = {"samples_per_shard": 2, "format": "webdataset", "files": ["wall.toml"], **changes}
    path = folder / "spec.toml"
    path.write_text(SPEC.format(samples=samples, top=top, more=more, **fields))
    return path


def job(spec: Path, out: Path | str) -> Job:
    """Job of a dataset, whose manifest is written, as ``dasim dataset make`` passes it to its workers."""
    described = load_spec(spec)
    here = provenance(backend.choose().variant)
    plan.begin(str(out), plan.description(described, here))
    return Job(described, str(out), here)


def inline(job: Job, queue: deque[int]) -> Generator[Outcome]:
    """Executor in this process."""
    while queue:
        yield work(job, queue.popleft())


def backwards(job: Job, queue: deque[int]) -> Generator[Outcome]:
    """Executor in this process that takes the samples in reverse order."""
    while queue:
        yield work(job, queue.pop())


def make_dataset(spec: Path, out: Path | str, executor=inline, **options):
    """Make or continue a dataset; returns the last progress."""
    return make(job(spec, out), executor, log=log_file(out), **options)


def log_file(out: Path | str) -> Path | None:
    """Log of a dataset in a folder; None for other addresses."""
    return storage.local_path(str(out)) / "make.log" if storage.is_local(str(out)) else None


def sums(out: Path | str) -> dict[str, str]:
    """SHA-256 of each file of a dataset by its name, from the list of checksums."""
    lines = storage.read(str(out), plan.SUMS).decode().splitlines()
    return {name: digest for digest, _, name in (line.partition("  ") for line in lines)}


def log_entries(out: Path, start: int = 0) -> list[tuple[int, bool]]:
    """Index of the sample and whether it succeeded, for each line of the log from line ``start``."""
    lines = (out / "make.log").read_text().splitlines()[start:]
    return [(int(line.split()[1]), "failed" not in line) for line in lines]


def spread(job: Job, index: int) -> Outcome:
    """Work that waits until two nodes of a cluster have started, and whose process is killed once, at sample 3."""
    import ray

    folder = Path(job.out).parent / "nodes"
    (folder / ray.get_runtime_context().get_node_id()).touch()
    begin = time.monotonic()
    while len(list(folder.iterdir())) < 2 and time.monotonic() - begin < WAIT_S:
        time.sleep(0.05)
    marker = folder.parent / "killed"
    if index == 3 and not marker.exists():
        marker.touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return work(job, index)


def deadly(job: Job, index: int) -> Outcome:
    """Work whose process dies, as with a renderer that crashes: always at the last of ``SAMPLES``, once at the one
    before.
    """
    marker = Path(job.out) / ".once"
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    if index == SAMPLES - 2 and not marker.exists():
        marker.touch()
        os.abort()
    if index == SAMPLES - 1:
        os.kill(os.getpid(), signal.SIGKILL)
    return work(job, index)


def same_sample(one, other) -> bool:
    """Whether two samples have the same index, description, raw picture and truth."""
    arrays = all(
        np.array_equal(value, other.truth[name], equal_nan=value.dtype.kind == "f")
        if isinstance(value, np.ndarray)
        else value == other.truth[name]
        for name, value in one.truth.items()
    )
    return one.index == other.index and one.meta == other.meta and np.array_equal(one.raw_dn, other.raw_dn) and arrays


def problems(out: Path) -> list[str]:
    """The problems that verify reports, one line each."""
    try:
        return list(verify.problems(str(out)))
    except InputError as error:
        return [str(error)]


def finished_sums(out: Path) -> dict[str, str]:
    """Checksums of a finished dataset, in which everything is as it should be."""
    assert list(verify.problems(str(out))) == []
    left = [path.name for path in out.rglob("*.partial")]
    assert left == [] and not (out / "parts").exists() and not (out / "rows").exists()
    return sums(out)
