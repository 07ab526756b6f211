"""Fake claims for the tests of limits and runs, in a module that a new process imports quickly."""

from __future__ import annotations

import math
import os

from validation.gates.claim import Evidence
from validation.gates.outcome import Measurement
from validation.scores.figures import Figure
from validation.subjects.rendering import NotRun


def good(progress) -> Evidence:
    """A claim that keeps its limit.

    Rationale: something <must> & should be shown.

    Limit: half.
    """
    progress(0.5)
    return Evidence([Figure("size", 0.25, "px", "a size"), Figure("other", 3.0, "1", "reported")])


def bad(progress) -> Evidence:
    """A claim that misses its limit."""
    return Evidence([Figure("size", 0.75, "px", "a size")], tables=[("Sizes", ["a", "b"], [["1", "2"]])])


def free(progress) -> Evidence:
    """A claim without any limit."""
    return Evidence([Figure("size", math.nan, "px", "a size")])


def absent(progress) -> Evidence:
    """A claim that cannot be run here."""
    raise NotRun("there is no renderer")


def broken(progress) -> Evidence:
    """A claim with a defect."""
    raise ZeroDivisionError("by nothing")


def stopped(progress) -> Evidence:
    """A claim during which the user presses Ctrl-C."""
    raise KeyboardInterrupt


def dies(progress) -> Evidence:
    """A claim whose process ends, as one that runs out of memory."""
    os._exit(1)


FAKES = {f.__name__: Measurement(f, quick=f is not bad) for f in (good, bad, free, absent, broken, stopped)}
