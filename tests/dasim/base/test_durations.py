"""Durations in words, and the time left of stages of known and unknown length."""

from __future__ import annotations

import pytest

from dasim.base.durations import left_s, words


@pytest.mark.parametrize(
    ("seconds", "text"),
    [(0.04, "0.0 s"), (3.24, "3.2 s"), (9.96, "10 s"), (89, "89 s"), (99.6, "2 min"), (725, "12 min"),
     (5940, "99 min"), (6000, "1 h 40 min"), (7230, "2 h 0 min")],
)  # fmt: skip
def test_long_times_are_minutes(seconds, text):
    assert words(seconds) == text


def test_time_left_keeps_the_pace_of_what_is_done():
    """Set-up: of stages of 10, 30 and 60 s the first and half of the second took 50 s, twice their 25 s.

    Expectation: the other 75 s take twice as long, too.
    """
    assert left_s({"a": 10, "b": 30, "c": 60}, {"a": 1.0, "b": 0.5}, 50.0) == pytest.approx(150.0)


def test_time_left_before_anything_is_done_is_that_of_the_earlier_run():
    assert left_s({"a": 10, "b": 30}, {}, 0.0) == 40


def test_a_stage_of_unknown_length_leaves_no_estimate_until_it_is_done():
    assert left_s({"a": 10, "b": None}, {"a": 1.0}, 10.0) is None
    assert left_s({"a": 10, "b": None}, {"a": 0.5, "b": 1.0}, 10.0) == pytest.approx(10.0)
