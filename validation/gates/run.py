"""Measurement of claims and comparison with their limits."""

from __future__ import annotations

import inspect
import math
import multiprocessing
import statistics
import sys
import time
import traceback
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from dataclasses import fields, replace
from functools import partial
from itertools import islice
from typing import Any, NamedTuple

from dasim.base.errors import InputError
from dasim.typing import Progress, ShareDone
from validation.gates import stored
from validation.gates.claim import Claim, Evidence
from validation.gates.limits import Gate, judged_all
from validation.gates.outcome import Measurement, Outcome
from validation.methods import NamedMethod, function
from validation.scores.figures import Figure
from validation.subjects import shots
from validation.subjects.rendering import NotRun


class Job(NamedTuple):
    """A claim, a seed, and a user's depth method that replaces the bundled ones."""

    claim: str
    seed: int
    method: NamedMethod | None = None

    @property
    def stage(self) -> str:
        """Name of the job in the progress display."""
        suffix = "" if self.method is None else f", {self.method}"
        return self.claim + suffix + (f", seed {self.seed}" if self.seed else "")


class Run(NamedTuple):
    """A claim measured with one seed, or the reason why it was not measured."""

    evidence: Evidence = Evidence([])
    seconds: float = 0.0
    not_run: str | None = None
    stopped_by: str | None = None
    report: str | None = None
    stored: bool = False


def measured_claims(
    names: Sequence[str],
    table: Mapping[str, Measurement],
    gates: list[Gate],
    *,
    variant: str = "",
    seeds: int = 1,
    fresh: bool = True,
    jobs: int = 1,
    methods: Sequence[NamedMethod] = (),
    progress: Progress = lambda stage, share: None,
) -> list[Outcome]:
    """Measure the named claims and compare their figures with the limits.

    Unless ``fresh``, a claim that an earlier run measured with the same code, data, libraries and renderer ``variant``
    is not measured again. ``jobs`` claims are measured at once, each in its own process. A claim that depends on random
    numbers is measured with each of the ``seeds`` 0, 1, ...; its figures are the means, with their spread. Claims about
    depth methods measure each of ``methods`` in addition to the bundled ones.
    """
    if fresh:
        shots.forget()
    planned = [job for name in names for job in _jobs(name, table[name], seeds, methods)]
    done = dict(_runs(planned, table, variant, fresh=fresh, jobs=jobs, progress=progress))
    return [
        _outcome(name, table[name], {job: done[job] for job in planned if job.claim == name}, gates) for name in names
    ]


def earlier_durations(
    names: Sequence[str], table: Mapping[str, Measurement], seeds: int = 1, methods: Sequence[NamedMethod] = ()
) -> dict[str, float | None]:
    """Seconds that each stage of :func:`measured_claims` took when it was measured last; None if that is not known."""
    planned = [job for name in names for job in _jobs(name, table[name], seeds, methods)]
    return {job.stage: stored.earlier_seconds(_file(job), job.seed) for job in planned}


def _jobs(name: str, measurement: Measurement, seeds: int, methods: Sequence[NamedMethod]) -> list[Job]:
    users_methods = [method for method in methods if measurement.methods and method not in measurement.methods]
    return [
        Job(name, seed, method)
        for method in (None, *users_methods)
        for seed in range(seeds if measurement.seeded else 1)
    ]


def _runs(
    planned: Sequence[Job],
    table: Mapping[str, Measurement],
    variant: str,
    *,
    fresh: bool,
    jobs: int,
    progress: Progress,
) -> Iterator[tuple[Job, Run]]:
    """Run the jobs: first those with stored results, then those that can share the computer, then those that need it
    alone.
    """
    keys = {job: _key(job, table[job.claim], variant) for job in planned}
    missing = []
    for job in planned:
        earlier = None if fresh else stored.load(_file(job), job.seed, keys[job])
        if earlier is None:
            missing.append(job)
            continue
        progress(job.stage, 1.0)
        yield job, Run(*earlier, stored=True)
    together = [job for job in missing if not table[job.claim].alone] if jobs > 1 else []
    for job, run in _side_by_side(together, table, jobs, progress):
        yield job, _stored(job, keys[job], run)
    for job in missing:
        if job not in together:
            progress(job.stage, 0.0)
            yield job, _stored(job, keys[job], measured(job, table[job.claim], partial(progress, job.stage)))
            progress(job.stage, 1.0)


def _key(job: Job, measurement: Measurement, variant: str) -> str:
    """Hash of all that the result depends on, including the name and code of a user's method."""
    functions = () if job.method is None else (function(job.method),)
    key = stored.key(measurement.run, variant, job.seed, uses=functions)
    return key if job.method is None else stored.text_hash([key, job.method.name])


def _file(job: Job) -> str:
    """Stem of the file that stores the result of a job."""
    return job.claim if job.method is None else f"{job.claim}-{stored.text_hash([job.method.name])[:8]}"


def _side_by_side(
    planned: Sequence[Job], table: Mapping[str, Measurement], jobs: int, progress: Progress
) -> Iterator[tuple[Job, Run]]:
    """Measure claims in ``jobs`` processes; a claim whose process dies has stopped."""
    if not planned:
        return
    context, waiting = multiprocessing.get_context("spawn"), iter(planned)
    running: dict[Future[Run], tuple[Job, ProcessPoolExecutor]] = {}
    try:
        while True:
            for job in islice(waiting, jobs - len(running)):
                progress(job.stage, 0.0)
                own = ProcessPoolExecutor(1, mp_context=context)  # a process that dies takes no other claim with it
                running[own.submit(measured, job, table[job.claim], _silent)] = job, own
            if not running:
                return
            for done in wait(running, return_when=FIRST_COMPLETED).done:
                (job, own), error = running.pop(done), done.exception()
                own.shutdown()
                yield job, done.result() if error is None else _stopped(0.0, error, str(error))
                progress(job.stage, 1.0)
    finally:
        for _, own in running.values():
            own.shutdown(wait=False, cancel_futures=True)


def _silent(share: float) -> None:
    pass


def _stored(job: Job, key: str, run: Run) -> Run:
    """Store a measured result; claims that could not be run or that stopped are run again next time."""
    if run.not_run is None and run.stopped_by is None:
        stored.save(_file(job), job.seed, key, run.evidence, run.seconds)
    return run


def measured(job: Job, measurement: Measurement, progress: ShareDone) -> Run:
    """Run one claim. An exception makes this claim fail and the others continue; Ctrl-C ends the run."""
    start = time.perf_counter()
    options: dict[str, Any] = {"seed": job.seed} if measurement.seeded else {}
    if job.method is not None:
        options["methods"] = (job.method,)
    try:
        evidence = measurement.run(progress, **options)
    except NotRun as reason:
        return Run(seconds=time.perf_counter() - start, not_run=str(reason))
    except Exception as error:
        seconds = time.perf_counter() - start
        if job.method is not None and isinstance(error, InputError):  # the user's code, not the claim's
            print(f"claim {job.claim}: {error}", file=sys.stderr, flush=True)
            return Run(seconds=seconds, stopped_by=str(error))
        report = traceback.format_exc()
        print(f"claim {job.stage} stopped:\n{report}", file=sys.stderr, flush=True)
        return _stopped(seconds, error, report)
    return Run(evidence, time.perf_counter() - start)


def _stopped(seconds: float, error: BaseException, report: str) -> Run:
    return Run(seconds=seconds, stopped_by=f"stopped by {type(error).__name__}: {error}", report=report)


def _outcome(name: str, measurement: Measurement, runs: Mapping[Job, Run], gates: list[Gate]) -> Outcome:
    """Combine the runs of a claim: figures averaged over seeds and compared with their limits, pictures and tables of
    the first seed.
    """
    text = inspect.getdoc(measurement.run) or ""
    seconds = sum(run.seconds for run in runs.values())
    without_method = [run for job, run in runs.items() if job.method is None]
    if reason := next((run.not_run for run in without_method if run.not_run), None):
        entry = Claim(name, math.nan, None, "", None, f"not run: {reason}")
        return Outcome(name, text, [entry], seconds, not_run=reason)
    if broken := next((run for run in without_method if run.stopped_by), None):
        entry = Claim(name, math.nan, None, "", False, broken.stopped_by or "")
        return Outcome(name, text, [entry], seconds, error=broken.report)
    evidence, failures = _over_seeds(without_method), []
    users = list(dict.fromkeys(job.method for job in runs if job.method is not None))
    for method in users:
        theirs = [run for job, run in runs.items() if job.method == method]
        if broken := next((run for run in theirs if run.stopped_by), None):
            failures.append(Claim(f"{name}.{method}", math.nan, None, "", False, broken.stopped_by or ""))
        else:
            evidence = joined(evidence, _over_seeds(theirs))
    return Outcome(
        name,
        text,
        [*judged_all(name, evidence.figures, gates), *failures],
        seconds,
        evidence=evidence,
        gates=[gate for gate in gates if gate.claim == name],
        seeds=len(without_method),
        stored=all(run.stored for run in runs.values()),
        bundled=tuple(method.name for method in measurement.methods),
        users=tuple(method.name for method in users),
    )


def joined(first: Evidence, second: Evidence) -> Evidence:
    """Evidence of two runs, one after the other."""
    return Evidence(*(getattr(first, one.name) + getattr(second, one.name) for one in fields(Evidence)))


def _over_seeds(runs: Sequence[Run]) -> Evidence:
    return replace(runs[0].evidence, figures=over_seeds([run.evidence.figures for run in runs]))


def over_seeds(measured: Sequence[list[Figure]]) -> list[Figure]:
    """Mean and standard deviation (of a single measurement) of each figure over seeds; one seed gives no spread.

    Figures named ``p`` are probabilities, of which the smallest counts, times their number (Bonferroni). A figure that
    is missing for some seeds is NaN.
    """
    if len(measured) == 1:
        return measured[0]
    results = []
    for figure in {figure.id: figure for figures in measured for figure in figures}.values():
        values = [other.value for figures in measured for other in figures if other.id == figure.id]
        if len(values) < len(measured):
            results.append(replace(figure, value=math.nan))
        elif figure.id.rpartition(".")[2] == "p":
            results.append(replace(figure, value=min(1.0, len(values) * min(values))))
        else:
            results.append(replace(figure, value=statistics.fmean(values), spread=_spread(values)))
    return results


def _spread(values: Sequence[float]) -> float | None:
    return statistics.stdev(values) if len(values) > 1 and all(map(math.isfinite, values)) else None
