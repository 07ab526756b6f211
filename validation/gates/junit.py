"""Outcomes of claims as JUnit XML, which test runners and build servers read.

Tested in tests/validation/gates/test_run.py.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from xml.etree import ElementTree

from dasim.base import atomic
from validation.gates.outcome import Outcome


def write_junit(path: Path, outcomes: Sequence[Outcome], name: str) -> None:
    """Write the outcomes as JUnit XML: one suite per claim, one case per figure; figures without a limit are skipped
    cases.
    """
    root = ElementTree.Element("testsuites", name=name)
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
            statement = f"{claim.value:.6g} {claim.unit}, limit {claim.limit}; {claim.source}"
            if outcome.error:
                ElementTree.SubElement(case, "error", message=claim.source).text = outcome.error
            elif claim.passed is False:
                ElementTree.SubElement(case, "failure", message=statement)
            elif claim.passed is None:
                reason = claim.source if outcome.not_run else f"reported, no limit: {claim.value:.6g} {claim.unit}"
                ElementTree.SubElement(case, "skipped", message=reason)
    ElementTree.indent(root)
    with atomic.writing(path) as file:
        ElementTree.ElementTree(root).write(file, encoding="utf-8", xml_declaration=True)
