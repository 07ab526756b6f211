"""Claim on the speed and memory of dataset generation, and on its overhead beside rendering."""

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
from dasim.base.executors import Outcome
from dasim.dataset.sample import Job
from dasim.typing import ShareDone
from validation.gates.claim import Evidence
from validation.scores.figures import Figure

SIZE_PX = (512, 384)
FIXED_SPP = 64
COUNTED = 2  # samples measured in each run; further samples keep the processes busy until these are finished
TINY = 200  # samples over which memory is observed
TINY_SIZE_PX = (64, 48)
TINY_SCENES = ("colour-checker", "depth-steps", "desk", "flat")  # scenes with lights whose kernels compile quickly
RENDERING = {
    "translate": ("world",),
    "truth": ("geometry",),
    "passes": ("irradiance_field", "stop_ratios", "sharp_pass", "pinhole_pass", "control_of"),
}

# A separate process per run, so that memory is that of the run and processor affinity can be set.
_RUN = """
import json, os, sys
from validation.claims.cost import datasets
kind, processes, spec, out, counted = json.loads(sys.argv[1])
if processes == 1 and hasattr(os, "sched_setaffinity"):
    os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})
print("\\n" + json.dumps(datasets.measured(kind, processes, spec, out, counted)))
"""


def dataset_speed(progress: ShareDone) -> Evidence:
    """Datasets are generated nearly as fast as the renderer permits, on all cores, in little memory.

    Rationale: training sets have many thousand samples, so every overhead beside rendering and every growth of memory
    multiplies.

    Set-up: random scenes at 512 x 384 px, da-mobile, wave-optics blur. Each sample is a new scene. All runs share
    compiled kernels; the same scenes, rendered at 64 x 48 px beforehand, fill this cache, because a dataset compiles
    its kernels only once (claim ``compiled-kernels``). The runs are: two local processes at the default noise target;
    two local processes at 64 samples per pixel and stop; the same samples in one process bound to one core; and the
    same samples by Ray on two cores. Rates assume processes that are always busy: they follow from the times of the
    first two samples, while further samples keep idle processes busy. Time outside the renderer is time outside the
    functions of ``dasim.render`` that translate and trace scenes (diffraction kernels included): scene generation,
    sensor model, files, checksums. Memory is the largest resident set of a process; its growth is measured over 200
    samples of bundled scenes at 64 x 48 px in one process.

    Expectation: times are those of this computer with its present load, so run this claim alone. Processor seconds are
    reported as well, since they depend less on other load.

    Limit: at least 300 samples per hour at the default noise target; at most 10 % of the time outside the renderer; two
    processes at least 1.7 times as fast as one; at most 1 GB; growth of at most 3 % from the second quarter of the
    200 samples to the last; Ray within 10 % of local processes.

    Source: the project's own limits.
    """
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        _run(folder, "local", 1, {"spp": FIXED_SPP, "size_px": TINY_SIZE_PX})  # compiles the kernels
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
    """The claim's figures from the measured samples of each run, and of the run over which memory is observed.

    A sample has ``seconds``, ``cpu_s`` (processor), ``render_s`` (in the renderer) and ``peak_mb`` (memory so far).
    """
    two, one = (_rate(runs[name], processes) for name, processes in (("two", 2), ("one", 1)))
    peak = [row["peak_mb"] for row in tiny]
    quarter = len(peak) // 4
    large = max(row["peak_mb"] for rows in runs.values() for row in rows)
    figures = [
        Figure("rate-auto", _rate(runs["auto"], 2), "1/h", "samples per hour, two processes, default noise target"),
        Figure("rate-64", two, "1/h", "samples per hour, two processes, 64 samples per pixel and stop"),
        Figure("cpu-auto", _mean(runs["auto"], "cpu_s"), "s", "processor seconds per sample, default noise target"),
        Figure("cpu-64", _mean(runs["two"], "cpu_s"), "s", "processor seconds per sample, 64 samples per pixel"),
        Figure("outside-auto", _outside(runs["auto"]), "1", "share of time outside the renderer, default noise target"),
        Figure("outside-64", _outside(runs["two"]), "1", "share of time outside the renderer, 64 samples per pixel"),
        Figure("two-over-one", two / one, "1", "rate of two processes over that of one on one core, same samples"),
        Figure("memory", large / 1e3, "GB", "largest memory of a process"),
        Figure(
            "growth",
            max(peak[-quarter:]) / max(peak[quarter : 2 * quarter]) - 1,
            "1",
            f"relative growth of memory from the second to the last quarter of {TINY} samples",
        ),
    ]
    if "ray" in runs:
        text = "rate of Ray on two cores over that of two local processes"
        figures.append(Figure("ray-over-local", _rate(runs["ray"], 2) / two, "1", text))
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
            *(f"{_mean(samples, key):.1f}" for key in ("seconds", "cpu_s", "render_s")),
            f"{_outside(samples):.1%}",
            f"{max(sample['peak_mb'] for sample in samples) / 1e3:.2f}",
        ]
        for name, samples in (*runs.items(), ("tiny", tiny))
    ]
    head = [
        "run",
        "seconds per sample",
        "processor seconds",
        "seconds in the renderer",
        "share outside the renderer",
        "memory, GB",
    ]
    return f"Time per sample on {os.cpu_count()} cores", head, rows


def _mean(rows: list[dict[str, float]], key: str) -> float:
    return float(np.mean([row[key] for row in rows]))


def _rate(rows: list[dict[str, float]], processes: int) -> float:
    """Samples per hour of ``processes`` processes that are always busy."""
    return 3600 * processes / _mean(rows, "seconds")


def _outside(rows: list[dict[str, float]]) -> float:
    return 1 - sum(row["render_s"] for row in rows) / sum(row["seconds"] for row in rows)


def _run(
    folder: Path, kind: str, processes: int, changes: dict[str, Any], count: int = COUNTED
) -> list[dict[str, float]]:
    """Time and memory of the first ``count`` samples of a run, which has a process of its own."""
    home = Path(tempfile.mkdtemp(dir=folder))
    random = {"random": {"floating": True}}  # the scenes that the figures were measured on
    data = {"name": "speed", "samples": 10 * count, "seed": 7, "size_px": SIZE_PX, "scenes": random} | changes
    request = json.dumps([kind, processes, data, str(home / "out"), count])
    environment = os.environ | {"DRJIT_CACHE_DIR": str(folder / "kernels")}
    environment["PYTHONPATH"] = os.pathsep.join([str(Path(dasim.__file__).parents[1]), *sys.path])
    process = subprocess.run([sys.executable, "-c", _RUN, request], env=environment, capture_output=True, text=True)
    if process.returncode != 0:
        message = (process.stderr.strip().splitlines() or ["the process was killed"])[-1]
        raise RuntimeError(f"generation of the dataset failed: {message}")
    return list(json.loads(process.stdout.splitlines()[-1]))


def measured(kind: str, processes: int, data: dict[str, Any], out: str, count: int) -> list[dict[str, float]]:
    """Time and memory of the first ``count`` samples of a dataset; see :func:`figures` for their keys."""
    from dasim.base.toml import parse
    from dasim.dataset.sample import provenance
    from dasim.dataset.specification import DatasetSpec
    from dasim.render import backend

    job = Job(parse(DatasetSpec, data, "speed"), out, provenance(backend.choose().variant))
    Path(out).mkdir()
    samples: dict[int, dict[str, float]] = {}
    with _executor(kind, processes) as run, contextlib.closing(run(job, deque(range(job.spec.samples)))) as outcomes:
        for outcome in outcomes:
            if outcome.error:
                raise RuntimeError(f"sample {outcome.index}: {outcome.error}")
            samples[outcome.index] = dict(outcome.row or {})
            if set(range(count)) <= set(samples):
                break
    return [samples[index] for index in range(count)]


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


_rendering = [0.0]  # seconds that the present sample has spent in the renderer


def timed(job: Job, index: int) -> Outcome:
    """Generate a sample as the executors do; the outcome's row holds its time and memory (see :func:`figures`)."""
    from dasim.dataset import sample
    from dasim.dataset.work import work

    sample.activate(job.environment["variant"])
    _watch()
    _rendering[0] = 0.0
    begin, cpu = time.perf_counter(), time.process_time()
    outcome = work(job, index)
    row = {
        "seconds": time.perf_counter() - begin,
        "cpu_s": time.process_time() - cpu,
        "render_s": _rendering[0],
        "peak_mb": outcome.peak_mb,
    }
    return replace(outcome, row=row)


def _watch() -> None:
    """Wrap the functions that translate and trace scenes in a timer, once per process."""
    for name, functions in RENDERING.items():
        module = importlib.import_module(f"dasim.render.{name}")
        for function in functions:
            original = getattr(module, function)
            if not hasattr(original, "has_timer"):
                setattr(module, function, _with_timer(original))


def _with_timer(function: Any) -> Any:
    """The function, adding the time of each call to ``_rendering``."""

    def call(*arguments: Any, **options: Any) -> Any:
        begin = time.perf_counter()
        try:
            return function(*arguments, **options)
        finally:
            _rendering[0] += time.perf_counter() - begin

    call.has_timer = True  # type: ignore[attr-defined]
    return call
