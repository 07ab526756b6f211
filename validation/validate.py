"""Measure claims and write the folder that ``dasim validate`` leaves: results.json, report.html, junit.xml.

Tested in tests/validation/gates/test_run.py.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from dasim.files.folders import new_folder
from validation.gates.claim import write_results
from validation.gates.junit import write_junit
from validation.gates.outcome import Outcome
from validation.reports.claims import claims_page


def write_claims(out: Path, measure: Callable[[], list[Outcome]]) -> list[Outcome]:
    """Measure claims (:func:`validation.gates.run.measured_claims`); ``out`` is written once all are done."""
    with new_folder(out, "validation") as folder:
        outcomes = measure()
        entries = [entry for outcome in outcomes for entry in outcome.claims]
        write_results(folder / "results.json", entries, {outcome.id: outcome.seconds for outcome in outcomes})
        (folder / "report.html").write_text(claims_page(outcomes), encoding="utf-8")
        write_junit(folder / "junit.xml", outcomes, "dasim validate")
    return outcomes
