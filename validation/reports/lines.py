"""Lines of text for the terminal."""

from __future__ import annotations

from collections.abc import Sequence

from validation.gates.claim import Claim

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
    return f"{claim.value:>10.4g} {spread:<11}{claim.unit:<7}{claim.limit or '':<16}{MARKS[claim.passed]}"
