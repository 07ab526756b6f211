"""Lines of text for the terminal.

Tested in tests/validation/reports/test_lines.py.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from dasim.base.durations import words
from validation.gates.claim import Claim
from validation.gates.outcome import Outcome, by_verdict, verdict
from validation.reports.headlines import Headline

MARKS = {None: "", True: "passed", False: "FAILED"}
GAP = 2  # spaces between the longest id and the values


def of_claims(claims: Sequence[Claim]) -> list[str]:
    """Figures with their limits and verdicts, or the reasons why they could not be measured, in aligned columns."""
    width = max((len(claim.id) for claim in claims), default=0) + GAP
    return [f"{claim.id:<{width}}{_result(claim)}".rstrip() for claim in claims]


def _result(claim: Claim) -> str:
    if claim.limit is None and not claim.unit:
        return claim.source
    spread = "" if claim.spread is None else f"+- {claim.spread:.2g}"
    if claim.passed is False and not claim.unit:  # a limit of a figure that there is not
        return f"{claim.value:>10.4g} {'':<18}{claim.limit or '':<16}{MARKS[False]}  {claim.source}"
    return f"{claim.value:>10.4g} {spread:<11}{claim.unit:<7}{claim.limit or '':<16}{MARKS[claim.passed]}"


def of_headlines(figures: Sequence[Headline], seconds: float) -> Iterator[str]:
    """A line per headline figure, value first, and a line with their total and the duration of the run."""
    for figure in figures:
        mark = MARKS[figure.claim.passed] or "reported"
        limit = f" (limit: {figure.limit})" if figure.limit else ""
        yield f"{mark:<10}{figure.value:>12}  {figure.title}{limit}"
    limited = [figure.claim.passed for figure in figures if figure.claim.passed is not None]
    yield f"{sum(limited)} of {len(limited)} figures within their limits, in {words(seconds)}"


def of_outcomes(outcomes: Sequence[Outcome], *, every_figure: bool = False) -> Iterator[str]:
    """A line per claim with its verdict, figures within their limits and duration, and below it the figures that
    failed, or ``every_figure``; claims that failed come last, above the total.
    """
    width = max((len(outcome.id) for outcome in outcomes), default=0) + GAP
    for outcome in reversed(by_verdict(outcomes)):
        mark = "not run" if outcome.not_run else MARKS[verdict(outcome.claims)] or "reported"
        figures = outcome.not_run or within_limits(outcome)
        yield f"{mark:<10}{outcome.id:<{width}}{figures:<30}{duration(outcome)}".rstrip()
        shown = [claim for claim in outcome.claims if every_figure or claim.passed is False]
        yield from (f"{'':<10}{line}" for line in of_claims([] if outcome.not_run else shown))


def within_limits(outcome: Outcome) -> str:
    """How many of a claim's figures keep their limits, in words; how many there are, if none has a limit."""
    limited = [claim for claim in outcome.claims if claim.passed is not None]
    if not limited:
        count = len(outcome.claims)
        return "1 figure, no limit" if count == 1 else f"{count} figures, no limit"
    return f"{sum(claim.passed is True for claim in limited)} of {len(limited)} within limits"


def duration(outcome: Outcome) -> str:
    """How long measuring a claim took, empty if it could not be run."""
    if outcome.not_run:
        return ""
    return words(outcome.seconds) + (", in an earlier run" if outcome.stored else "")


def total(outcomes: Sequence[Outcome], seconds: float) -> str:
    """One line on all claims: their verdicts, the figures within their limits, and the duration of the run."""
    verdicts = [verdict(outcome.claims) for outcome in outcomes if not outcome.not_run]
    counts = {
        "passed": verdicts.count(True),
        "FAILED": verdicts.count(False),
        "without a limit": verdicts.count(None),
        "not run": len(outcomes) - len(verdicts),
    }
    limited = [claim for outcome in outcomes for claim in outcome.claims if claim.passed is not None]
    kept = sum(claim.passed is True for claim in limited)
    listed = ", ".join(f"{count} {name}" for name, count in counts.items() if count)
    claims = "1 claim" if len(outcomes) == 1 else f"{len(outcomes)} claims"
    return f"{claims} in {words(seconds)}: {listed}; {kept} of {len(limited)} figures within their limits"
