"""Lines of claims on the terminal."""

from __future__ import annotations

import math

from validation.gates.claim import Claim
from validation.reports.lines import of_claims


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
