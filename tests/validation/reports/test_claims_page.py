"""The report of the claims in a browser: its height with all claims, verdicts first, folded; the dark theme."""

from __future__ import annotations

import inspect

import numpy as np
import pytest

from tests.support import devtools
from validation.claims.table import CLAIMS
from validation.gates.claim import Claim, Evidence
from validation.gates.outcome import Outcome
from validation.reports.claims import claims_page
from validation.reports.plots import plot
from validation.scores.figures import Figure

FIGURES = 60  # per claim, more than any has


def outcomes() -> list[Outcome]:
    """All claims with their own texts and many made-up figures, of which one in seven claims fails one."""
    picture = "a plot", plot(lambda axes: axes[0].plot(np.arange(3)), columns=3)
    table = "a wide table", [f"column {i}" for i in range(30)], [["1.2345"] * 30] * 40
    made = []
    for number, (name, measurement) in enumerate(CLAIMS.items()):
        entries = [
            Claim(f"{name}.figure-{i}", 0.5, "<= 1", "px", i > 0 or number % 7 > 0, "what it means")
            for i in range(FIGURES)
        ]
        evidence = Evidence([Figure("size", 0.5, "px", "a size")], pictures=[picture], tables=[table])
        made.append(Outcome(name, inspect.getdoc(measurement.run) or "", entries, 100.0 * number, evidence=evidence))
    return made


def test_failed_claims_and_their_figures_come_first():
    page = claims_page(outcomes())
    rows = page[page.index("<h2>Claims</h2>") :].split("<details")[1:]
    failed = ['class="failed"' in row.partition("</summary>")[0] for row in rows]
    assert failed == sorted(failed, reverse=True) and sum(failed) == -(-len(CLAIMS) // 7)
    assert rows[0].index("figure-0<") < rows[0].index("figure-1<") and rows[0].index(">failed<") < rows[0].index(
        ">passed<"
    )


@pytest.mark.slow
@pytest.mark.parametrize(("width", "height", "most"), [(1280, 900, 6000), (390, 844, 12_000)])
@pytest.mark.parametrize("dark", [False, True])
def test_report_of_all_claims_opens_in_a_browser(tmp_path, width, height, most, dark):
    """Expectation: with every claim folded not higher than allowed; unfolded no wider than the screen, each table
    within it; no word on the console.
    """
    (tmp_path / "report.html").write_text(claims_page(outcomes()), encoding="utf-8")
    with devtools.browsing(tmp_path / "profile") as page:
        page.screen(width, height, dark=dark, touch=width < 500)
        page.open(tmp_path / "report.html", "true")
        assert page.run("document.documentElement.scrollHeight") < most
        page.run("document.querySelectorAll('details').forEach((one, i) => { one.open = i < 5 })")
        assert page.run("document.documentElement.scrollWidth") <= width
        assert page.run("[...document.querySelectorAll('.scroll')].every((one) => one.clientHeight < 700)")
        corner = page.picture()[2, 2]
        assert corner.max() < 40 if dark else corner.min() > 250
        assert page.messages == []
