"""Measure the claims, compare them with their limits, and write results.json, report.html and junit.xml."""

from __future__ import annotations

import inspect
import math
import multiprocessing
import statistics
import sys
import time
import traceback
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import NamedTuple
from xml.etree import ElementTree

from dasim.base.errors import InputError
from dasim.files.folders import new_folder
from dasim.typing import Progress, ShareDone
from validation.gates import stored
from validation.gates.claim import GATES, Claim, Evidence, Gate, NotRun, judged_all, load_gates, write_results
from validation.scores.figures import Figure
from validation.subjects import shots


class Measurement(NamedTuple):
    """How a claim is measured, whether that takes less than about 20 s, and whether it is a time that is measured.

    ``run`` takes ``progress``, and also ``seed`` where what it measures depends on random numbers.
    """

    run: Callable[..., Evidence]
    quick: bool
    alone: bool = False  # nothing else may run at the same time

    @property
    def seeded(self) -> bool:
        """Whether another seed gives other figures."""
        return "seed" in inspect.signature(self.run).parameters


@dataclass(frozen=True)
class Outcome:
    """A claim that was measured, or could not be."""

    id: str
    text: str  # the docstring
    claims: list[Claim]
    seconds: float
    evidence: Evidence = field(default_factory=lambda: Evidence([]))
    gates: list[Gate] = field(default_factory=list)
    not_run: str | None = None
    error: str | None = None
    seeds: int = 1
    stored: bool = False  # measured by an earlier run


def title(measurement: Measurement) -> str:
    """First sentence of a claim's docstring."""
    return (inspect.getdoc(measurement.run) or "").split("\n\n")[0].replace("\n", " ")


def chosen(table: Mapping[str, Measurement], only: Sequence[str], *, quick: bool) -> list[str]:
    """Ids to measure, in the table's order; InputError where a name is unknown or nothing is left."""
    for name in only:
        if name not in table:
            raise InputError(f"claim '{name}' is unknown; allowed are {', '.join(table)}")
    names = [name for name in table if (not only or name in only) and (not quick or table[name].quick)]
    if not names:
        raise InputError(f"of {', '.join(only) or 'all claims'} none is quick; leave --quick out")
    return names


def all_gates(table: Mapping[str, Measurement], users: Path | None, bundled: Path = GATES) -> list[Gate]:
    """The bundled limits behind the user's own, which win."""
    own = [] if users is None else load_gates(users, table)
    return [*own, *load_gates(bundled, table)]


def run_claims(
    out: Path,
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
    """Measure the named claims; ``out`` is written as a whole when all are done.

    Unless ``fresh``, a claim that an earlier run measured with the same code, data, libraries and renderer ``variant``
    is not measured again. ``jobs`` claims are measured at once, each in a process of its own. A claim that depends on
    random numbers is measured with each of the ``seeds`` 0, 1, ...: its figures are means with their spread.
    """
    from validation.reports.claims import claims_page

    with new_folder(out, "validation") as folder:
        if fresh:
            shots.forget()
        runs = [(name, seed) for name in names for seed in range(seeds if table[name].seeded else 1)]
        done = dict(_runs(runs, table, variant, fresh=fresh, jobs=jobs, progress=progress))
        outcomes = [_outcome(name, table[name], [done[run] for run in runs if run[0] == name], gates) for name in names]
        entries = [entry for outcome in outcomes for entry in outcome.claims]
        write_results(folder / "results.json", entries, {outcome.id: outcome.seconds for outcome in outcomes})
        (folder / "report.html").write_text(claims_page(outcomes), encoding="utf-8")
        write_junit(folder / "junit.xml", outcomes)
    return outcomes


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


def failed(outcomes: list[Outcome]) -> bool:
    """Whether any gate failed."""
    return any(entry.passed is False for outcome in outcomes for entry in outcome.claims)


def write_junit(path: Path, outcomes: list[Outcome]) -> None:
    """Write the outcomes as JUnit XML: a suite a claim, a case a figure; figures without a limit are skipped cases."""
    root = ElementTree.Element("testsuites", name="dasim validate")
    for outcome in outcomes:
        cases = outcome.claims
        suite = ElementTree.SubElement(
            root,
            "testsuite",
            name=outcome.id,
            tests=str(len(cases)),
            failures=str(sum(c.passed is False and outcome.error is None for c in cases)),
            errors=str(len(cases) if outcome.error else 0),
            skipped=str(sum(c.passed is None for c in cases)),
            time=f"{outcome.seconds:.3f}",
        )
        for claim in cases:
            case = ElementTree.SubElement(suite, "testcase", classname=outcome.id, name=claim.id)
            said = f"{claim.value:.6g} {claim.unit}, limit {claim.limit}; {claim.source}"
            if outcome.error:
                ElementTree.SubElement(case, "error", message=claim.source).text = outcome.error
            elif claim.passed is False:
                ElementTree.SubElement(case, "failure", message=said)
            elif claim.passed is None:
                reason = claim.source if outcome.not_run else f"reported, no limit: {claim.value:.6g} {claim.unit}"
                ElementTree.SubElement(case, "skipped", message=reason)
    ElementTree.indent(root)
    ElementTree.ElementTree(root).write(path, encoding="utf-8", xml_declaration=True)
