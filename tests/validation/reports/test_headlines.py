"""Headline figures of the demo: their words, values and limits."""

from __future__ import annotations

import math

from validation import demo
from validation.gates.claim import Claim
from validation.reports.headlines import IDS, headlines
from validation.reports.lines import of_headlines


def claim(name: str, value: float, limit: str | None, passed: bool | None) -> Claim:
    return Claim(f"demo.{name}", value, limit, "1", passed, "a figure")


def test_limits_are_said_in_the_unit_of_the_value():
    """Expectation: shares become percent in value and limit alike; strict limits and ranges have their own words."""
    shown = headlines(
        [
            claim("raw.all.level-ratio", 0.318, "<= 0.5", True),
            claim("raw.all.coverage", 0.2, ">= 0.25", False),
            claim("all-in-focus.blurred.psnr-gain", 2.77, "> 0", True),
            claim("all-in-focus.blurred.ciede2000", 2.76, "1..4", True),
            claim("all-in-focus.blurred.ssim", math.nan, None, None),
            claim("raw.all.blur-bad-1", 0.3, None, None),
            claim("raw.all.level-median", 0.5, "<= 2", True),
            claim("regularised.error-surer-half", 0.5, "<= 1", True),
        ]
    )
    assert [(one.value, one.limit) for one in shown] == [
        ("20 %", "at least 25 %"),
        ("0.50 levels", "at most 2 levels"),
        ("32 %", "at most 50 %"),
        ("0.50 levels", "at most 1 level"),
        ("2.8 dB", "more than 0 dB"),
        ("not measured", ""),
        ("2.8", "from 1 to 4"),
    ]


def test_every_headline_has_a_limit():
    assert set(IDS) == set(demo.LIMITS) and len(IDS) == 8


def test_lines_say_what_failed_and_how_long_it_took():
    shown = headlines(
        [claim("raw.all.coverage", 0.2, ">= 0.25", False), claim("raw.all.level-median", 1, "<= 2", True)]
    )
    *lines, total = of_headlines(shown, 200)
    assert [line.split()[0] for line in lines] == ["FAILED", "passed"]
    assert total == "1 of 2 figures within their limits, in 3 min"
