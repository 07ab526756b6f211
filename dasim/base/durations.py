"""Durations in words, and the time that is left of several stages of work.

Tested in tests/dasim/base/test_durations.py.
"""

from __future__ import annotations

from collections.abc import Mapping

TENTHS_BELOW_S, SECONDS_BELOW_S, MINUTES_BELOW_S = 9.95, 99.5, 99.5 * 60


def words(seconds: float) -> str:
    """The duration as text of two significant digits or a few more: ``3.2 s``, ``47 s``, ``12 min``, ``2 h 5 min``."""
    if seconds < SECONDS_BELOW_S:
        return f"{seconds:.1f} s" if seconds < TENTHS_BELOW_S else f"{seconds:.0f} s"
    minutes = round(seconds / 60)
    if seconds < MINUTES_BELOW_S:
        return f"{minutes} min"
    return f"{minutes // 60} h {minutes % 60} min"


def left_s(expected_s: Mapping[str, float | None], share: Mapping[str, float], elapsed_s: float) -> float | None:
    """Estimated remaining time in seconds; None if the expected duration of an unfinished stage is unknown.

    ``expected_s`` are the durations of the stages in earlier runs (None if unknown), ``share`` is the fraction 0..1 of
    each that is completed. The estimate is scaled by the pace so far: ``elapsed_s`` over the expected duration of the
    completed work.
    """
    if any(seconds is None and share.get(stage, 0.0) < 1 for stage, seconds in expected_s.items()):
        return None
    done = sum((seconds or 0.0) * share.get(stage, 0.0) for stage, seconds in expected_s.items())
    whole = sum(seconds or 0.0 for seconds in expected_s.values())
    return (whole - done) * (elapsed_s / done if done > 0 else 1.0)
