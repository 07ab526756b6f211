"""Run a sweep: measure the missing points, and write their table and report.

Tested in tests/validation/studies/sweep/test_run.py.
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
    """Measure the missing points, write table and report, and return the failures, {point and seed: error}.

    Measured points are read from their files. The unit of work is a picture with all points that share it, so an
    additional light level measures that picture again. ``show`` receives the numbers of finished, of all and of failed
    units.
    """
    with storage.no_empty_folder(job.out):
        return _measured(job, executor, show)


def _measured(job: Sweep, executor: Executor, show: Callable[[int, int, int], None]) -> dict[str, str]:
    """:func:`sweep` in a folder that may remain empty, where it is stopped before the first point."""
    storage.check_writable(job.out)
    storage.sweep(job.out)
    everyone = units(job.spec)
    queue = deque(i for i, unit in enumerate(everyone) if _cached_rows(job, unit) is None)
    total, done, failed = len(everyone), len(everyone) - len(queue), dict[str, str]()
    show(done, total, 0)
    with closing(executor(job, queue)) as outcomes:
        for outcome in outcomes:
            if outcome.fatal:
                raise InputError(
                    f"{job.out}: {outcome.error}; finished points are stored: remove the cause and run the same command"
                )
            if outcome.error:
                unit = everyone[outcome.index]
                failed[f"{_label(unit.render)}, seed {unit.seed}"] = outcome.error
            else:
                done += 1
            show(done, total, len(failed))
    rows = measured_rows(job)
    if rows:
        storage.write(job.out, TABLE, table(rows).encode())
        _write_parquet(job.out, rows)
        storage.write(job.out, PAGE, report.page(job.spec, rows, failed).encode())
    return failed


def summary(job: Sweep) -> list[str]:
    """The results of a sweep in sentences: how the reference ranks, and whether the bound ranks designs alike."""
    rows = measured_rows(job)
    lines = findings.sentences(job.spec, findings.findings(job.spec, rows)) if rows else []
    ranked = findings.ranking(job.spec, means(rows, job.spec)) if rows else None
    if ranked:
        lines.append(ranked.sentence)
    return lines


def _label(point: dict[str, Any]) -> str:
    return ", ".join(f"{key} = {value}" for key, value in point.items()) or "the study's base design"


def measured_rows(job: Sweep) -> list[Row]:
    """One row per measured point and seed, with its parameters, seed and figures."""
    rows = []
    for unit in units(job.spec):
        rows += _cached_rows(job, unit) or []
    return rows


def _cached_rows(job: Sweep, unit: Unit) -> list[Row] | None:
    """The stored rows of a unit; None if it has not been measured or its file is damaged."""
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
    """The rows as CSV, with units in the column heads."""
    buffer = io.StringIO()
    writer = csv.writer(buffer, lineterminator="\n")
    heads = list(rows[0])
    writer.writerow([f"{head} ({FIGURES[head][0]})" if head in FIGURES else head for head in heads])
    for row in rows:
        writer.writerow([f"{row[head]:.6g}" if isinstance(row[head], float) else row[head] for head in heads])
    return buffer.getvalue()


def _write_parquet(out: str, rows: list[Row]) -> None:
    """Write the rows as a Parquet file if pyarrow is installed."""
    try:
        import pyarrow
        import pyarrow.parquet
    except ImportError:
        return
    with storage.writing(out, PARQUET) as file:
        pyarrow.parquet.write_table(pyarrow.Table.from_pylist(rows), file)


def means(rows: list[Row], spec: StudySpec) -> list[Row]:
    """One row per point: the mean of each figure over seeds, and its standard deviation as FIGURE:spread.

    Both are NaN if a seed has no finite value; the deviation also with a single seed.
    """
    groups: dict[tuple[Any, ...], list[Row]] = {}
    for row in rows:
        groups.setdefault(tuple(row[key] for key in spec.parameters), []).append(row)
    averaged = []
    for values, group in groups.items():
        one: Row = dict(zip(spec.parameters, values, strict=True))
        for key in FIGURES:
            every = np.array([row[key] for row in group], float)
            known = bool(np.isfinite(every).all())
            one[key] = float(every.mean()) if known else math.nan
            one[f"{key}:spread"] = float(every.std(ddof=1)) if known and len(every) > 1 else math.nan
        averaged.append(one)
    return averaged
