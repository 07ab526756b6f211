"""Measure the claims, compare them with their limits, and write results.json, report.html and junit.xml."""

from __future__ import annotations

import inspect
import math
import sys
import time
import traceback
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import NamedTuple
from xml.etree import ElementTree

from dasim.errors import InputError
from dasim.files import new_folder
from validation.claim import GATES, Claim, Evidence, Gate, NotRun, Progress, judged_all, load_gates, write_results

StageProgress = Callable[[str, float], None]


class Measurement(NamedTuple):
    """How a claim is measured, and whether that takes less than about 20 s."""

    run: Callable[[Progress], Evidence]
    quick: bool


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
    progress: StageProgress = lambda stage, share: None,
) -> list[Outcome]:
    """Measure the named claims one after the other; ``out`` is written as a whole when all are done."""
    from validation.claims_report import claims_page

    with new_folder(out, "validation") as folder:
        outcomes = []
        for name in names:
            progress(name, 0.0)
            outcomes.append(measured(name, table[name], gates, partial(progress, name)))
            progress(name, 1.0)
        entries = [entry for outcome in outcomes for entry in outcome.claims]
        write_results(folder / "results.json", entries, {outcome.id: outcome.seconds for outcome in outcomes})
        (folder / "report.html").write_text(claims_page(outcomes), encoding="utf-8")
        write_junit(folder / "junit.xml", outcomes)
    return outcomes


def measured(name: str, measurement: Measurement, gates: list[Gate], progress: Progress) -> Outcome:
    """Run one claim. What stops it is a claim that failed, and the others go on; Ctrl-C ends all."""
    text = inspect.getdoc(measurement.run) or ""
    start = time.perf_counter()
    try:
        evidence = measurement.run(progress)
    except NotRun as reason:
        entry = Claim(name, math.nan, None, "", None, f"not run: {reason}")
        return Outcome(name, text, [entry], time.perf_counter() - start, not_run=str(reason))
    except Exception as error:
        report = traceback.format_exc()
        print(f"claim {name} stopped:\n{report}", file=sys.stderr, flush=True)
        entry = Claim(name, math.nan, None, "", False, f"stopped by {type(error).__name__}: {error}")
        return Outcome(name, text, [entry], time.perf_counter() - start, error=report)
    entries = judged_all(name, evidence.figures, gates)
    own = [gate for gate in gates if gate.claim == name]
    return Outcome(name, text, entries, time.perf_counter() - start, evidence=evidence, gates=own)


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
