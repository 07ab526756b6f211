"""Measure the claims and compare them with their limits."""

from __future__ import annotations

import inspect
import math
import multiprocessing
import statistics
import sys
import time
import traceback
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import replace
from functools import partial
from typing import NamedTuple

from dasim.typing import Progress, ShareDone
from validation.gates import stored
from validation.gates.claim import Claim, Evidence, Gate, judged_all
from validation.gates.outcome import Measurement, Outcome
from validation.scores.figures import Figure
from validation.subjects import shots
from validation.subjects.rendering import NotRun


def measured_claims(
    names: Sequence[str],
    table: Mapping[str, Measurement],
    gates: list[Gate],
    *,
    variant: str = "",
    seeds: int = 1,
    fresh: bool = True,
    jobs: int = 1,
    progress: Progress = lambda stage, share: None,
) -> list[Outcome]:
    """Measure the named claims and compare their figures with the limits.

    Unless ``fresh``, a claim that an earlier run measured with the same code, data, libraries and renderer ``variant``
    is not measured again. ``jobs`` claims are measured at once, each in a process of its own. A claim that depends on
    random numbers is measured with each of the ``seeds`` 0, 1, ...: its figures are means with their spread.
    """
    if fresh:
        shots.forget()
    runs = [(name, seed) for name in names for seed in range(seeds if table[name].seeded else 1)]
    done = dict(_runs(runs, table, variant, fresh=fresh, jobs=jobs, progress=progress))
    return [_outcome(name, table[name], [done[run] for run in runs if run[0] == name], gates) for name in names]


class _Run(NamedTuple):
    """A claim measured with one seed, or the reason why not."""

    evidence: Evidence = Evidence([])
    seconds: float = 0.0
    not_run: str | None = None
    stopped_by: str | None = None
    report: str | None = None
    stored: bool = False


def _runs(
    runs: Sequence[tuple[str, int]],
    table: Mapping[str, Measurement],
    variant: str,
    *,
    fresh: bool,
    jobs: int,
    progress: Progress,
) -> Iterator[tuple[tuple[str, int], _Run]]:
    """Each claim and seed, kept ones first, then those that share the computer, then those that want it alone."""
    keys = {(name, seed): stored.key(table[name].run, variant, seed) for name, seed in runs}
    missing = []
    for run in runs:
        found = None if fresh else stored.load(*run, keys[run])
        if found is None:
            missing.append(run)
            continue
        progress(_stage(*run), 1.0)
        evidence, seconds = found
        yield run, _Run(evidence, seconds, stored=True)
    together = [run for run in missing if not table[run[0]].alone] if jobs > 1 else []
    for run, result in _side_by_side(together, table, jobs, progress):
        yield run, _keep(run, keys[run], result)
    for run in missing:
        if run not in together:
            name, seed = run
            progress(_stage(*run), 0.0)
            yield run, _keep(run, keys[run], measured(name, table[name], seed, partial(progress, _stage(*run))))
            progress(_stage(*run), 1.0)


def _stage(name: str, seed: int) -> str:
    return name if seed == 0 else f"{name}, seed {seed}"


def _side_by_side(
    runs: Sequence[tuple[str, int]], table: Mapping[str, Measurement], jobs: int, progress: Progress
) -> Iterator[tuple[tuple[str, int], _Run]]:
    """Claims measured in ``jobs`` processes; one that dies is a claim that stopped."""
    if not runs:
        return
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(min(jobs, len(runs)), mp_context=context, max_tasks_per_child=1) as pool:
        waiting = {pool.submit(measured, name, table[name], seed, _silent): (name, seed) for name, seed in runs}
        for run in runs:
            progress(_stage(*run), 0.0)
        try:
            for done in as_completed(waiting):
                error = done.exception()
                yield waiting[done], done.result() if error is None else _stopped(0.0, error, str(error))
                progress(_stage(*waiting[done]), 1.0)
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            raise


def _silent(share: float) -> None:
    pass


def _keep(run: tuple[str, int], key: str, result: _Run) -> _Run:
    """Store what was measured; what could not be run, or stopped, is tried again the next time."""
    if result.not_run is None and result.stopped_by is None:
        stored.save(*run, key, result.evidence, result.seconds)
    return result


def measured(name: str, measurement: Measurement, seed: int, progress: ShareDone) -> _Run:
    """Run one claim. What stops it is a claim that failed, and the others go on; Ctrl-C ends all."""
    start = time.perf_counter()
    try:
        evidence = measurement.run(progress, seed) if measurement.seeded else measurement.run(progress)
    except NotRun as reason:
        return _Run(seconds=time.perf_counter() - start, not_run=str(reason))
    except Exception as error:
        report = traceback.format_exc()
        print(f"claim {name} stopped:\n{report}", file=sys.stderr, flush=True)
        return _stopped(time.perf_counter() - start, error, report)
    return _Run(evidence, time.perf_counter() - start)


def _stopped(seconds: float, error: BaseException, report: str) -> _Run:
    return _Run(seconds=seconds, stopped_by=f"{type(error).__name__}: {error}", report=report)


def _outcome(name: str, measurement: Measurement, runs: Sequence[_Run], gates: list[Gate]) -> Outcome:
    """A claim's runs, one a seed, as one: means and spreads, judged; with the pictures and tables of the first."""
    text = inspect.getdoc(measurement.run) or ""
    seconds = sum(run.seconds for run in runs)
    if reason := next((run.not_run for run in runs if run.not_run), None):
        entry = Claim(name, math.nan, None, "", None, f"not run: {reason}")
        return Outcome(name, text, [entry], seconds, not_run=reason)
    if broken := next((run for run in runs if run.stopped_by), None):
        entry = Claim(name, math.nan, None, "", False, f"stopped by {broken.stopped_by}")
        return Outcome(name, text, [entry], seconds, error=broken.report)
    evidence = replace(runs[0].evidence, figures=over_seeds([run.evidence.figures for run in runs]))
    entries = judged_all(name, evidence.figures, gates)
    own = [gate for gate in gates if gate.claim == name]
    kept = all(run.stored for run in runs)
    return Outcome(name, text, entries, seconds, evidence=evidence, gates=own, seeds=len(runs), stored=kept)


def over_seeds(measured: Sequence[list[Figure]]) -> list[Figure]:
    """Mean and standard deviation (of one measurement) of each figure over seeds; a single seed has no spread."""
    if len(measured) == 1:
        return measured[0]
    found = []
    for figure in measured[0]:
        values = [other.value for figures in measured for other in figures if other.id == figure.id]
        found.append(replace(figure, value=statistics.fmean(values), spread=_spread(values)))
    return found


def _spread(values: Sequence[float]) -> float | None:
    return statistics.stdev(values) if len(values) > 1 and all(map(math.isfinite, values)) else None
