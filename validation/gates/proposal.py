"""Proposed limits: the mean over seeds and a margin that follows from the spread.

Tested in tests/validation/gates/test_comparison.py.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from decimal import ROUND_CEILING, ROUND_FLOOR, Decimal

from validation.gates.claim import Claim

CONFIDENCE = 0.99  # that one more seed keeps the limit


def proposed(claim: Claim, seeds: int) -> str | None:
    """A limit that a further seed meets with the probability ``CONFIDENCE``; None if the spread is unknown.

    The prediction interval of a normal variable is mean +- t s sqrt(1 + 1/n), with Student's t of n - 1 degrees of
    freedom. It is one-sided if the claim's limit is, and two-sided for a range or no limit.
    """
    from scipy.stats import t as student

    if claim.spread is None or seeds < 2 or not math.isfinite(claim.value):
        return None
    sides = 1 if claim.limit and ".." not in claim.limit else 2
    quantile = float(student.ppf(1 - (1 - CONFIDENCE) / sides, seeds - 1))
    margin = quantile * claim.spread * math.sqrt(1 + 1 / seeds)
    low, high = (
        _outwards(claim.value - margin, margin, ROUND_FLOOR),
        _outwards(claim.value + margin, margin, ROUND_CEILING),
    )
    if sides == 2:
        return f"{low}..{high}"
    return f"<= {high}" if claim.limit and claim.limit.lstrip().startswith("<") else f">= {low}"


def _outwards(limit: float, margin: float, rounding: str) -> str:
    """A limit as text, rounded away from the measured value by less than a hundredth of the margin."""
    if margin == 0:
        return repr(limit)
    step = Decimal(1).scaleb(math.floor(math.log10(margin)) - 2)
    return f"{(Decimal(limit) / step).to_integral_value(rounding) * step:f}"


def gate_file(measured: Sequence[tuple[Claim, int]]) -> str:
    """Text of a file for ``--gates``: a limit, with its origin, for each figure (claim, seeds) whose
    spread is known.
    """
    lines = ["# Limits from measured values and their spread over seeds, by dasim validate --propose-gates."]
    for claim, seeds in measured:
        limit = proposed(claim, seeds)
        if limit is None:
            continue
        why = f"measured {claim.value:.4g} +- {claim.spread:.2g} {claim.unit} over {seeds} seeds"
        lines += [
            "",
            f'["{claim.id}"]',
            f'limit = "{limit}"',
            f'why = "{why}; {CONFIDENCE:.0%} of further seeds keep it"',
        ]
    return "\n".join(lines) + "\n"
