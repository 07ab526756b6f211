"""Small studies, measured without rendering."""

from __future__ import annotations

import math
from collections import deque

from dasim.base.executors import Outcome
from validation.studies.sweep import run as sweep
from validation.studies.sweep.point import FIGURES, Sweep, file_of
from validation.studies.sweep.specification import units

STUDY = """
name = "small"
question = "Which <hole> & why?"
seeds = 2
pareto = ["light-loss", "depth-median"]
[parameters]
"camera.stops.hole.radius_ratio" = [0.3, 0.46]
"light.lux" = { log_grid = [100.0, 10000.0, 3] }
[[curves]]
x = "camera.stops.hole.radius_ratio"
y = "depth-median"
by = "light.lux"
log_y = true
"""


HOLE = "camera.stops.hole.radius_ratio"
REFERENCE = f'[reference]\n"{HOLE}" = 0.46\n'
GRIDS = f"""
name = "grids"
[design]
"{HOLE}" = 0.46
"light.illuminant" = "D65"
[[parameters]]
"{HOLE}" = [0.3, 0.46, 0.6]
[[parameters]]
"light.illuminant" = ["D65", "A"]
[quick]
"{HOLE}" = [0.6]
"""


def measured(job: Sweep, index: int, broken=()) -> Outcome:
    """A worker that knows a formula: error falls with the hole and with light, loss with the hole."""
    from dasim.dataset import sample, storage

    unit = units(job.spec)[index]
    if index in broken:
        return Outcome(index, "no such luck")
    rows = []
    for point in unit.points:
        alpha, lux = point["camera.stops.hole.radius_ratio"], point["light.lux"]
        values = dict.fromkeys(FIGURES, 1.0) | {"light-loss": (1 - alpha**2) / 4, "depth-median": 1 / alpha / lux}
        values["depth-median"] *= 1 + 0.1 * unit.seed
        values |= {"depth-bound": values["depth-median"] ** 0.5, "depth-seen": values["depth-median"]}
        rows.append({"point": point, "seed": unit.seed, "light_chosen": "D55", "figures": values})
    storage.write(job.out, file_of(job, unit), sample.json_bytes(rows))
    return Outcome(index)


def inline(calls: list[int], broken=()):
    def run_all(job, queue: deque[int]):
        while queue:
            calls.append(queue[0])
            yield measured(job, queue.popleft(), broken)

    return run_all


def swept(spec, out, broken=()) -> tuple[list[int], dict[str, str]]:
    calls: list[int] = []
    failed = sweep.sweep(Sweep(spec, str(out), {"variant": "any"}), inline(calls, broken), lambda *counts: None)
    return calls, failed


def rows_of(spec, errors, figure="depth-median"):
    """Rows with an error for each hole and seed: errors[hole][seed]."""
    rows = []
    for hole, by_light in errors.items():
        for seed, value in enumerate(by_light):
            row = dict.fromkeys(FIGURES, math.nan) | {figure: value, "seed": seed, "light.lux": 100.0}
            rows.append(row | {"camera.stops.hole.radius_ratio": hole})
    return rows
