"""Claim on compiled kernels: random scenes share them."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import NamedTuple

import dasim
from dasim.typing import ShareDone
from validation.gates.claim import Evidence
from validation.scores.figures import Figure
from validation.subjects import rendering

SIZE_PX = (64, 48)
SPP = 8
FIRST = (5, 6, 2, 0, 8)  # random scenes: two alone; under a lamp, an overcast sky, and lamps of several spectra
LATER = tuple(range(16, 31))

_RUN = """
import json, sys
from validation.claims.cost import compilation
print("\\n" + json.dumps([compilation.measured(number) for number in json.loads(sys.argv[1])]))
"""


class Cost(NamedTuple):
    """What a random scene costs."""

    number: int
    kernels: int  # distinct ones that it needs
    compiled: int
    compilation_s: float  # elapsed time
    cpu_s: float  # processor time of the picture


def compiled_kernels(progress: ShareDone) -> Evidence:
    """No kernel is compiled for one random scene: all find those of the first ones.

    Rationale: a kernel takes several processor seconds to compile, as much as a picture of a random scene. A dataset
    of a thousand scenes must not pay that a thousand times.

    Set-up: a separate process with an empty kernel cache; da-mobile, central 64 x 48 px, 8 samples per pixel and stop.
    First, two random scenes on their own, which compile their kernels, and three scenes that need different shared
    kernels: a lamp, an overcast sky, and lamps of several spectra. Then scenes 16 to 30 of the same seed, with metals,
    glass, coats, photographs and windows.

    Expectation: none of the later scenes compiles a kernel. Times depend on this computer and its current load.

    Limit: 0 kernels.

    Source: Dr.Jit's record of the kernels that it launched.
    """
    if rendering.activate().startswith("scalar"):
        raise rendering.NotRun("only scalar_spectral works here, which compiles nothing; install LLVM 17 or newer")
    costs = _costs([*FIRST, *LATER])
    progress(1.0)
    return Evidence(figures(costs), tables=[_table(costs)])


def figures(costs: list[Cost]) -> list[Figure]:
    """The claim's figures; the first ``len(FIRST)`` scenes are those that may compile."""
    first, later = costs[: len(FIRST)], costs[len(FIRST) :]
    text = f"kernels compiled for random scenes {later[0].number} to {later[-1].number}"
    return [
        Figure("later", float(sum(cost.compiled for cost in later)), "1", text),
        Figure("first", float(sum(cost.compiled for cost in first)), "1", "kernels compiled for the first scenes"),
        Figure("first-seconds", sum(cost.compilation_s for cost in first), "s", "time to compile these"),
        Figure(
            "later-cpu",
            sum(cost.cpu_s for cost in later) / len(later),
            "s",
            f"processor seconds per later scene, {SIZE_PX[0]} x {SIZE_PX[1]} px, {SPP} samples",
        ),
    ]


def _table(costs: list[Cost]) -> tuple[str, list[str], list[list[str]]]:
    rows = [
        [str(cost.number), str(cost.kernels), str(cost.compiled), f"{cost.compilation_s:.2f}", f"{cost.cpu_s:.2f}"]
        for cost in costs
    ]
    head = ["random scene", "kernels", "compiled", "time to compile, s", "processor seconds of the picture"]
    return "Kernels of random scenes, in the order of rendering", head, rows


def _costs(numbers: list[int]) -> list[Cost]:
    """Costs of random scenes, rendered one after another in a process with an empty cache of kernels."""
    with tempfile.TemporaryDirectory() as folder:
        environment = os.environ | {"DRJIT_CACHE_DIR": folder}
        environment["PYTHONPATH"] = os.pathsep.join([str(Path(dasim.__file__).parents[1]), *sys.path])
        command = [sys.executable, "-c", _RUN, json.dumps(numbers)]
        process = subprocess.run(command, env=environment, capture_output=True, text=True)
    if process.returncode != 0:
        message = (process.stderr.strip().splitlines() or ["the process was killed"])[-1]
        raise RuntimeError(f"rendering random scenes failed: {message}")
    return [Cost(*row) for row in json.loads(process.stdout.splitlines()[-1])]


def measured(number: int) -> Cost:
    """Cost of random scene ``number`` of seed 0, rendered in this process."""
    from dasim.render.shared_kernels import recorded

    rendering.activate()
    camera = dasim.cropped(dasim.load_camera("da-mobile"), *SIZE_PX)
    scene = dasim.random_scene(0, number, dasim.RandomScenes(floating=True))
    begin = time.process_time()
    with recorded() as kernels:
        dasim.simulate(scene, dasim.focused(camera, scene), spp=SPP)
    cpu_s = time.process_time() - begin
    compiled = [kernel for kernel in kernels if kernel.is_new]
    seconds = sum(kernel.compilation_s for kernel in compiled)
    return Cost(number, len({kernel.name for kernel in kernels}), len(compiled), seconds, cpu_s)
