"""Measure the claims, compare them with their limits, and write results.json, report.html and junit.xml."""

from __future__ import annotations

import inspect
import math
import multiprocessing
import sys
import time
import traceback
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import NamedTuple
from xml.etree import ElementTree

from dasim.errors import InputError
from dasim.files import new_folder
from validation import stored
from validation.claim import GATES, Claim, Evidence, Gate, NotRun, Progress, judged_all, load_gates, write_results

StageProgress = Callable[[str, float], None]


class Measurement(NamedTuple):
    """How a claim is measured, whether that takes less than about 20 s, and whether it is a time that is measured."""

    run: Callable[[Progress], Evidence]
    quick: bool
    alone: bool = False  # nothing else may run at the same time


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
    fresh: bool = True,
    jobs: int = 1,
    progress: StageProgress = lambda stage, share: None,
) -> list[Outcome]:
    """Measure the named claims; ``out`` is written as a whole when all are done.

    Unless ``fresh``, a claim that an earlier run measured with the same code, data, libraries and renderer ``variant``
    is not measured again. ``jobs`` claims are measured at once, each in a process of its own.
    """
    from validation.claims_report import claims_page

    with new_folder(out, "validation") as folder:
        by_name = dict(_outcomes(names, table, gates, variant, fresh=fresh, jobs=jobs, progress=progress))
        outcomes = [by_name[name] for name in names]
        entries = [entry for outcome in outcomes for entry in outcome.claims]
        write_results(folder / "results.json", entries, {outcome.id: outcome.seconds for outcome in outcomes})
        (folder / "report.html").write_text(claims_page(outcomes), encoding="utf-8")
        write_junit(folder / "junit.xml", outcomes)
    return outcomes


def _outcomes(
    names: Sequence[str],
    table: Mapping[str, Measurement],
    gates: list[Gate],
    variant: str,
    *,
    fresh: bool,
    jobs: int,
    progress: StageProgress,
) -> Iterator[tuple[str, Outcome]]:
    """Each claim's outcome, kept ones first, then those that share the computer, then those that want it alone."""
    keys = {name: stored.key(table[name].run, variant) for name in names}
    missing = []
    for name in names:
        found = None if fresh else stored.load(name, keys[name])
        if found is None:
            missing.append(name)
            continue
        progress(name, 1.0)
        evidence, seconds = found
        yield name, _judged(name, table[name], evidence, seconds, gates, stored=True)
    together = [name for name in missing if not table[name].alone] if jobs > 1 else []
    for name, outcome in _side_by_side(together, table, gates, jobs, progress):
        yield name, _keep(outcome, keys[name])
    for name in missing:
        if name not in together:
            progress(name, 0.0)
            yield name, _keep(measured(name, table[name], gates, partial(progress, name)), keys[name])
            progress(name, 1.0)


def _side_by_side(
    names: Sequence[str], table: Mapping[str, Measurement], gates: list[Gate], jobs: int, progress: StageProgress
) -> Iterator[tuple[str, Outcome]]:
    """Claims measured in ``jobs`` processes; one that dies is a claim that stopped."""
    if not names:
        return
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(min(jobs, len(names)), mp_context=context, max_tasks_per_child=1) as pool:
        waiting = {pool.submit(measured, name, table[name], gates, _silent): name for name in names}
        for name in names:
            progress(name, 0.0)
        try:
            for done in as_completed(waiting):
                name = waiting[done]
                error = done.exception()
                yield name, done.result() if error is None else _stopped(name, table[name], 0.0, error, str(error))
                progress(name, 1.0)
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            raise


def _silent(share: float) -> None:
    pass


def _keep(outcome: Outcome, key: str) -> Outcome:
    """Store what was measured; what could not be run, or stopped, is tried again the next time."""
    if outcome.not_run is None and outcome.error is None:
        stored.save(outcome.id, key, outcome.evidence, outcome.seconds)
    return outcome


def measured(name: str, measurement: Measurement, gates: list[Gate], progress: Progress) -> Outcome:
    """Run one claim. What stops it is a claim that failed, and the others go on; Ctrl-C ends all."""
    start = time.perf_counter()
    try:
        evidence = measurement.run(progress)
    except NotRun as reason:
        entry = Claim(name, math.nan, None, "", None, f"not run: {reason}")
        seconds = time.perf_counter() - start
        return Outcome(name, _text(measurement), [entry], seconds, not_run=str(reason))
    except Exception as error:
        report = traceback.format_exc()
        print(f"claim {name} stopped:\n{report}", file=sys.stderr, flush=True)
        return _stopped(name, measurement, time.perf_counter() - start, error, report)
    return _judged(name, measurement, evidence, time.perf_counter() - start, gates)


def _judged(
    name: str, measurement: Measurement, evidence: Evidence, seconds: float, gates: list[Gate], *, stored: bool = False
) -> Outcome:
    entries = judged_all(name, evidence.figures, gates)
    own = [gate for gate in gates if gate.claim == name]
    return Outcome(name, _text(measurement), entries, seconds, evidence=evidence, gates=own, stored=stored)


def _stopped(name: str, measurement: Measurement, seconds: float, error: BaseException, report: str) -> Outcome:
    entry = Claim(name, math.nan, None, "", False, f"stopped by {type(error).__name__}: {error}")
    return Outcome(name, _text(measurement), [entry], seconds, error=report)


def _text(measurement: Measurement) -> str:
    return inspect.getdoc(measurement.run) or ""


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
