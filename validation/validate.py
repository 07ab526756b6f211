"""Measure claims and write the folder that ``dasim validate`` leaves: results.json, report.html, junit.xml.

Tested in tests/validation/gates/test_run.py.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from dasim.files.folders import new_folder
from dasim.typing import Progress
from validation.gates.claim import write_results
from validation.gates.junit import write_junit
from validation.gates.limits import Gate
from validation.gates.outcome import Measurement, Outcome
from validation.gates.run import measured_claims
from validation.methods import NamedMethod
from validation.reports.claims import claims_page


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
    methods: Sequence[NamedMethod] = (),
    progress: Progress = lambda stage, share: None,
) -> list[Outcome]:
    """Measure the named claims (:func:`validation.gates.run.measured_claims`); ``out`` is written once all are done."""
    with new_folder(out, "validation") as folder:
        outcomes = measured_claims(
            names, table, gates,
            variant=variant, seeds=seeds, fresh=fresh, jobs=jobs, methods=methods, progress=progress,
        )  # fmt: skip
        entries = [entry for outcome in outcomes for entry in outcome.claims]
        write_results(folder / "results.json", entries, {outcome.id: outcome.seconds for outcome in outcomes})
        (folder / "report.html").write_text(claims_page(outcomes), encoding="utf-8")
        write_junit(folder / "junit.xml", outcomes, "dasim validate")
    return outcomes
