"""Verdicts of claims by the limits of the project."""

from __future__ import annotations

from validation.claims.table import CLAIMS
from validation.gates.claim import Claim
from validation.gates.limits import GATES, judged_all, load_gates


def entries(name: str, run_claim) -> list[Claim]:
    return judged_all(name, run_claim(lambda share: None).figures, load_gates(GATES, CLAIMS))


def verdicts(name: str, run_claim) -> list[bool]:
    return [entry.passed for entry in entries(name, run_claim) if entry.passed is not None]
