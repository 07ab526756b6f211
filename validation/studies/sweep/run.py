"""Run a sweep: measure the points that are missing, gather them in a table, and draw its report.

Tested in tests/validation/studies/test_sweep.py.
"""

from __future__ import annotations

import csv
import io
import json
import math
from collections import deque
from collections.abc import Callable
from contextlib import closing
from typing import Any

import numpy as np

from dasim.base.errors import InputError
from dasim.base.executors import Executor
from dasim.dataset import storage
from validation.studies.sweep import findings, report
from validation.studies.sweep.point import FIGURES, Sweep, file_of
from validation.studies.sweep.specification import StudySpec, Unit, units

Row = dict[str, Any]

TABLE, PARQUET, PAGE = "results.csv", "results.parquet", "report.html"


def sweep(job: Sweep, executor: Executor, show: Callable[[int, int, int], None]) -> dict[str, str]:
    """Measure what is missing and write table and report; what failed, and why, by the point's words.

    What was measured before is not measured again. The unit is a picture with all points that share it, so that one
    more level of light measures that picture anew. ``show`` gets how many units are done, how many there are, and how
    many failed.
    """
    storage.check_writable(job.out)
    storage.sweep(job.out)
    everyone = units(job.spec)
    queue = deque(i for i, unit in enumerate(everyone) if _kept(job, unit) is None)
    total, done, failed = len(everyone), len(everyone) - len(queue), dict[str, str]()
    show(done, total, 0)
    with closing(executor(job, queue)) as outcomes:
        for outcome in outcomes:
            if outcome.fatal:
                raise InputError(f"{job.out}: {outcome.error}; nothing is lost: put it right, and run the same again")
            if outcome.error:
                unit = everyone[outcome.index]
                failed[f"{_said(unit.render)}, seed {unit.seed}"] = outcome.error
            else:
                done += 1
            show(done, total, len(failed))
    rows = gathered(job)
    if rows:
        storage.write(job.out, TABLE, table(rows).encode())
        _write_parquet(job.out, rows)
        storage.write(job.out, PAGE, report.page(job.spec, rows, failed).encode())
    return failed


def summary(job: Sweep) -> list[str]:
    """What the sweep says, in lines: where the study's reference stands, and whether the bound ranks alike."""
    rows = gathered(job)
    lines = findings.said(job.spec, findings.findings(job.spec, rows)) if rows else []
    ranked = findings.ranking(job.spec, means(rows, job.spec)) if rows else None
    if ranked:
        lines.append(ranked.said)
    return lines


def _said(point: dict[str, Any]) -> str:
    return ", ".join(f"{key} = {value}" for key, value in point.items()) or "the study's own design"


def gathered(job: Sweep) -> list[Row]:
    """Rows of all points that are measured, flat: parameters, seed, figures."""
    rows = []
    for unit in units(job.spec):
        rows += _kept(job, unit) or []
    return rows


def _kept(job: Sweep, unit: Unit) -> list[Row] | None:
    """Rows of a unit that was measured; None where it was not, or where its file is damaged."""
    name = file_of(job, unit)
    if not storage.exists(job.out, name):
        return None
    rows = []
    try:
        for row in json.loads(storage.read(job.out, name)):
            figures = {key: _number(row["figures"].get(key)) for key in FIGURES}
            rows.append({**row["point"], "seed": row["seed"], "light_chosen": row["light_chosen"], **figures})
    except (ValueError, TypeError, KeyError, AttributeError):
        return None
    return rows if len(rows) == len(unit.points) else None


def _number(value: float | None) -> float:
    return math.nan if value is None else float(value)


def table(rows: list[Row]) -> str:
    """The rows as CSV; units stand in the heads."""
    buffer = io.StringIO()
    writer = csv.writer(buffer, lineterminator="\n")
    heads = list(rows[0])
    writer.writerow([f"{head} ({FIGURES[head][0]})" if head in FIGURES else head for head in heads])
    for row in rows:
        writer.writerow([f"{row[head]:.6g}" if isinstance(row[head], float) else row[head] for head in heads])
    return buffer.getvalue()


def _write_parquet(out: str, rows: list[Row]) -> None:
    """The same as parquet, where pyarrow is installed."""
    try:
        import pyarrow
        import pyarrow.parquet
    except ImportError:
        return
    with storage.writing(out, PARQUET) as file:
        pyarrow.parquet.write_table(pyarrow.Table.from_pylist(rows), file)


def means(rows: list[Row], spec: StudySpec) -> list[Row]:
    """One row a point: the mean of each figure over seeds, and its standard deviation as FIGURE:spread."""
    groups: dict[tuple[Any, ...], list[Row]] = {}
    for row in rows:
        groups.setdefault(tuple(row[key] for key in spec.parameters), []).append(row)
    found = []
    for values, own in groups.items():
        one: Row = dict(zip(spec.parameters, values, strict=True))
        for key in FIGURES:
            every = np.array([row[key] for row in own], float)
            known = every[np.isfinite(every)]
            one[key] = float(known.mean()) if known.size else math.nan
            one[f"{key}:spread"] = float(known.std(ddof=1)) if known.size > 1 else 0.0
        found.append(one)
    return found


def pareto(rows: list[Row], first: str, second: str) -> list[Row]:
    """Rows that no other one beats in both figures, the smaller the better; sorted by the first."""
    good = [row for row in rows if math.isfinite(row[first]) and math.isfinite(row[second])]
    front: list[Row] = []
    for row in sorted(good, key=lambda r: (r[first], r[second])):
        if not front or row[second] < front[-1][second]:
            front.append(row)
    return front
