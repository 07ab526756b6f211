"""Claim of how fast datasets are made, and of what that costs beside the rendering."""

from __future__ import annotations

import contextlib
import importlib.util
import json
import os
import subprocess
import sys
import tempfile
import time
from collections import deque
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

import dasim
from dasim.base import executors
from dasim.base.cache import cache_dir
from dasim.base.executors import Outcome
from dasim.dataset.sample import Job
from dasim.typing import ShareDone
from validation.gates.claim import Evidence
from validation.scores.figures import Figure

SIZE_PX = (512, 384)
FIXED_SPP = 64
COUNTED = 2  # samples of each run that are measured; others keep the processes busy until these are done
TINY = 200  # samples that memory is watched over
TINY_SIZE_PX = (64, 48)
TINY_SCENES = ("colour-checker", "depth-steps", "desk", "flat")  # lit ones, soon compiled
RENDERING = {
    "translate": ("world",),
    "truth": ("geometry",),
    "passes": ("irradiance_field", "stop_pass", "pinhole_pass"),
}

# A run in a process of its own: what is compiled is kept nowhere else, and one core is one core.
_RUN = """
import json, os, sys
from validation.claims import datasets
kind, processes, spec, out, counted = json.loads(sys.argv[1])
if processes == 1 and hasattr(os, "sched_setaffinity"):
    os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})
print("\\n" + json.dumps(datasets.measured(kind, processes, spec, out, counted)))
"""


def dataset_speed(progress: ShareDone) -> Evidence:
    """A dataset is made at the speed of the renderer, on all cores, in little memory.

    Rationale: training sets have many thousand samples; what is slow or grows beside the rendering is paid for by all.

    Set-up: random scenes at 512 x 384, da-mobile, wave-true, each a new scene whose kernels are compiled, in an empty
    cache. Two local processes at the default noise target and at 64 samples a pixel and stop; the same samples at 64
    in one process that may use one core, and by Ray on two. A rate is that of processes that are always busy: seconds
    of the same two samples, while others keep the remaining process busy. Outside the renderer is what is not in the
    functions of ``dasim.render`` that translate and trace (diffraction kernels are in them): drawing, the sensor,
    writing, checksums. Memory is the largest of a process; it is watched over 200 samples of bundled scenes at
    64 x 48 in one process.

    Expectation: reported in seconds of this computer, which is what was free of it: run alone. Beside it seconds of
    the processor, which a busy computer changes less.

    Limit: 300 samples an hour at the default noise target; 15 % outside the renderer; two processes 1.7 times one;
    1.5 GB; flat within 3 % from the second quarter of the 200 to the last; Ray within 10 % of local.

    Source: the project's own limits.
    """
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        runs = {
            "auto": _run(folder, "local", 2, {"spp": "auto"}),
        }
        progress(0.4)
        runs["two"] = _run(folder, "local", 2, {"spp": FIXED_SPP})
        progress(0.55)
        runs["one"] = _run(folder, "local", 1, {"spp": FIXED_SPP})
        progress(0.75)
        if importlib.util.find_spec("ray"):
            runs["ray"] = _run(folder, "ray", 2, {"spp": FIXED_SPP})
        progress(0.9)
        small: dict[str, Any] = {
            "spp": 4,
            "size_px": TINY_SIZE_PX,
            "scenes": {"family": "bundled", "names": TINY_SCENES},
        }
        tiny = _run(folder, "local", 1, small, TINY)
    progress(1.0)
    return Evidence(figures(runs, tiny), tables=[_table(runs, tiny)])


def figures(runs: dict[str, list[dict[str, float]]], tiny: list[dict[str, float]]) -> list[Figure]:
    """What is judged, of the rows of each run."""
    two, one = (_rate(runs[name], processes) for name, processes in (("two", 2), ("one", 1)))
    peak = [row["peak_mb"] for row in tiny]
    quarter = len(peak) // 4
    large = max(row["peak_mb"] for rows in runs.values() for row in rows)
    figures = [
        Figure("rate-auto", _rate(runs["auto"], 2), "1/h", "samples an hour of two processes, default noise target"),
        Figure("rate-64", two, "1/h", "samples an hour of two processes, 64 samples a pixel and stop"),
        Figure("cpu-auto", _mean(runs["auto"], "cpu_s"), "s", "processor seconds a sample, default noise target"),
        Figure("cpu-64", _mean(runs["two"], "cpu_s"), "s", "processor seconds a sample, 64 samples"),
        Figure("outside-auto", _outside(runs["auto"]), "1", "share of the time outside the renderer, default target"),
        Figure("outside-64", _outside(runs["two"]), "1", "share of the time outside the renderer, 64 samples"),
        Figure("two-over-one", two / one, "1", "rate of two processes over one on one core, the same samples"),
        Figure("memory", large / 1e3, "GB", "largest memory of a process"),
        Figure(
            "growth", max(peak[-quarter:]) / max(peak[quarter : 2 * quarter]) - 1, "1", f"of it over {TINY} samples"
        ),
    ]
    if "ray" in runs:
        figures.append(Figure("ray-over-local", _rate(runs["ray"], 2) / two, "1", "rate of Ray over two processes"))
    return figures


def _table(runs: dict[str, list[dict[str, float]]], tiny: list[dict[str, float]]) -> tuple[str, list[str], list[Any]]:
    names = {
        "auto": "two processes, default noise target",
        "two": "two processes, 64 samples",
        "one": "one process on one core, 64 samples",
        "ray": "Ray on two cores, 64 samples",
        "tiny": f"{TINY} small samples of bundled scenes",
    }
    rows = [
        [
            names[name],
            *(f"{_mean(found, key):.1f}" for key in ("seconds", "cpu_s", "render_s")),
            f"{_outside(found):.1%}",
            f"{max(row['peak_mb'] for row in found) / 1e3:.2f}",
        ]
        for name, found in (*runs.items(), ("tiny", tiny))
    ]
    head = ["run", "seconds a sample", "of the processor", "in the renderer", "outside it", "memory, GB"]
    return f"{os.cpu_count()} cores", head, rows


def _mean(rows: list[dict[str, float]], key: str) -> float:
    return float(np.mean([row[key] for row in rows]))


def _rate(rows: list[dict[str, float]], processes: int) -> float:
    """Samples an hour of so many processes that are always busy."""
    return 3600 * processes / _mean(rows, "seconds")


def _outside(rows: list[dict[str, float]]) -> float:
    return 1 - sum(row["render_s"] for row in rows) / sum(row["seconds"] for row in rows)


def _run(
    folder: Path, kind: str, processes: int, changes: dict[str, Any], counted: int = COUNTED
) -> list[dict[str, float]]:
    """What each of the first samples of a run took, in a process and with a cache of its own."""
    home = Path(tempfile.mkdtemp(dir=folder))  # Dr.Jit keeps what it compiled below it
    data = {"name": "speed", "samples": 10 * counted, "seed": 7, "size_px": SIZE_PX} | changes
    request = json.dumps([kind, processes, data, str(home / "out"), counted])
    here = os.environ | {"HOME": str(home), "DASIM_CACHE": str(cache_dir())}
    here["PYTHONPATH"] = os.pathsep.join([str(Path(dasim.__file__).parents[1]), *sys.path])
    done = subprocess.run([sys.executable, "-c", _RUN, request], env=here, capture_output=True, text=True)
    if done.returncode != 0:
        raise RuntimeError(f"dataset: {(done.stderr.strip().splitlines() or ['was killed'])[-1]}")
    return list(json.loads(done.stdout.splitlines()[-1]))


def measured(kind: str, processes: int, data: dict[str, Any], out: str, counted: int) -> list[dict[str, float]]:
    """Rows of the first samples: seconds, of them in the renderer, of the processor, and largest memory so far."""
    from dasim.base.toml import parse
    from dasim.dataset.sample import environment
    from dasim.dataset.specification import DatasetSpec
    from dasim.render import backend

    job = Job(parse(DatasetSpec, data, "speed"), out, environment(backend.choose().variant))
    Path(out).mkdir()
    found: dict[int, dict[str, float]] = {}
    with _executor(kind, processes) as run, contextlib.closing(run(job, deque(range(job.spec.samples)))) as outcomes:
        for outcome in outcomes:
            if outcome.error:
                raise RuntimeError(f"sample {outcome.index}: {outcome.error}")
            found[outcome.index] = dict(outcome.row or {})
            if set(range(counted)) <= set(found):
                break
    return [found[index] for index in range(counted)]


@contextlib.contextmanager
def _executor(kind: str, processes: int) -> Iterator[executors.Executor]:
    if kind == "local":
        yield executors.local(processes, timed)
        return
    import ray
    from ray.cluster_utils import Cluster

    cluster = Cluster(initialize_head=True, head_node_args={"num_cpus": processes, "include_dashboard": False})
    os.environ["RAY_ADDRESS"] = cluster.address
    try:
        yield executors.ray("auto", timed)
    finally:
        ray.shutdown()
        cluster.shutdown()


_rendering = [0.0]


def timed(job: Job, index: int) -> Outcome:
    """The executors' work, with seconds in all, in the renderer and of the processor as the row."""
    from dasim.dataset import sample
    from dasim.dataset.work import work

    sample.activate(job.environment["variant"])
    _watch()
    _rendering[0] = 0.0
    begin, cpu = time.perf_counter(), time.process_time()
    done = work(job, index)
    row = {
        "seconds": time.perf_counter() - begin,
        "cpu_s": time.process_time() - cpu,
        "render_s": _rendering[0],
        "peak_mb": done.peak_mb,
    }
    return replace(done, row=row)


def _watch() -> None:
    """Have the functions that translate and trace scenes add up their time, once in a process."""
    for name, functions in RENDERING.items():
        module = importlib.import_module(f"dasim.render.{name}")
        for function in functions:
            real = getattr(module, function)
            if not hasattr(real, "watched"):
                setattr(module, function, _added_up(real))


def _added_up(real: Any) -> Any:
    def call(*arguments: Any, **options: Any) -> Any:
        begin = time.perf_counter()
        try:
            return real(*arguments, **options)
        finally:
            _rendering[0] += time.perf_counter() - begin

    call.watched = True  # type: ignore[attr-defined]
    return call
