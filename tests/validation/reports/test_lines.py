"""Lines of claims on the terminal."""

from __future__ import annotations

import math

from validation.gates.claim import Claim
from validation.gates.outcome import Outcome
from validation.reports.lines import of_claims, of_outcomes, total


def test_values_stand_below_each_other_whatever_the_length_of_the_ids():
    """Expectation: of two ids, one very long, the units stand in one column; a reason follows its id."""
    long = "a-claim." * 9 + "figure"
    claims = [
        Claim("short", 0.5, "0..1", "px", True, "eq. (1)", spread=0.1),
        Claim(long, 12.25, "0..1", "px", False, "eq. (1)"),
        Claim("none", math.nan, None, "", None, "not run: no renderer"),
    ]
    first, second, third = of_claims(claims)
    assert first.index(" px ") == second.index(" px ") > len(long)
    assert second.startswith(f"{long}  ") and "12.25" in second and second.endswith("FAILED") and "+- 0.1" in first
    assert third.split(maxsplit=1) == ["none", "not run: no renderer"]
    assert of_claims([]) == []


def outcome(name: str, *claims: Claim, seconds: float = 1.0, **options) -> Outcome:
    return Outcome(name, "A claim.", list(claims), seconds, **options)


def test_claims_have_a_line_each_and_failures_stand_last():
    """Set-up: a claim that fails, one that keeps both limits, one without, one that could not be run.

    Expectation: verdict, count and duration in each line; figures only below the failure, which is last; a total.
    """
    kept = Claim("good.size", 0.25, "<= 0.5", "px", True, "a size")
    missed = Claim("bad.size", 0.75, "<= 0.5", "px", False, "a size")
    outcomes = [
        outcome("bad", missed, kept, seconds=125),
        outcome("good", kept, kept, seconds=3, stored=True),
        outcome("free", Claim("free.size", 1.0, None, "px", None, "a size")),
        outcome("absent", Claim("absent", math.nan, None, "", None, "not run: no renderer"), not_run="no renderer"),
    ]
    lines = list(of_outcomes(outcomes))
    assert [line.split()[:2] for line in lines[:4]] == [
        ["not", "run"], ["reported", "free"], ["passed", "good"], ["FAILED", "bad"],
    ]  # fmt: skip
    assert (
        "no renderer" in lines[0]
        and "2 of 2 within limits" in lines[2]
        and lines[2].endswith("3.0 s, in an earlier run")
    )
    assert "1 of 2" in lines[3] and lines[3].endswith("2 min")
    assert len(lines) == 5 and "bad.size" in lines[4] and lines[4].endswith("FAILED")
    assert len(list(of_outcomes(outcomes, every_figure=True))) == 4 + 2 + 2 + 1
    assert total(outcomes, 130) == (
        "4 claims in 2 min: 1 passed, 1 FAILED, 1 without a limit, 1 not run; 3 of 4 figures within their limits"
    )
