"""Lines of text for the terminal.

Tested in tests/validation/gates/test_run.py.
"""

from __future__ import annotations

from validation.gates.claim import Claim

MARKS = {None: "", True: "passed", False: "FAILED"}


def of_claim(claim: Claim) -> str:
    """A figure with its limit and verdict, or the reason why it could not be measured."""
    if claim.limit is None and not claim.unit:
        return f"{claim.id:<44}{claim.source}"
    spread = "" if claim.spread is None else f"+- {claim.spread:.2g}"
    return f"{claim.id:<44}{claim.value:>10.4g} {spread:<11}{claim.unit:<7}{claim.limit or '':<16}{MARKS[claim.passed]}"
