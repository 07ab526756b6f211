"""What the long commands say of their progress where there is no terminal: what is done, and the time left."""

from __future__ import annotations

import itertools
from types import SimpleNamespace

import pytest

from dasim.cli import options


@pytest.fixture
def clock(monkeypatch):
    """A clock that advances by a minute whenever it is read."""
    minutes = itertools.count()
    monkeypatch.setattr(options, "time", SimpleNamespace(monotonic=lambda: 60.0 * next(minutes)))


def test_stages_say_the_time_left_where_earlier_durations_are_known(clock, capsys):
    """Set-up: three claims of 60, 60 and 120 s in an earlier run, the second stored; the clock runs at their pace.

    Expectation: no estimate beyond the unmeasured claims; the stored one counts as done, not as work.
    """
    with options.stages("claims", {"a": 60.0, "b": 60.0, "c": 120.0}) as progress:
        progress("b", 1.0)
        progress("a", 0.0)
        progress("a", 1.0)
        progress("c", 0.0)
    first, second, third = capsys.readouterr().err.splitlines()
    assert first.startswith("b (1 of 3 claims done") and second.startswith("a (1 of 3 claims done")
    assert third.startswith("c (2 of 3 claims done, 4 min so far, about 8 min left")


def test_stages_of_unknown_length_leave_no_time(clock, capsys):
    with options.stages("claims", {"a": 60.0, "b": None}) as progress:
        progress("a", 0.0)
        progress("b", 0.0)
    assert "left" not in capsys.readouterr().err


def test_pieces_done_before_do_not_count_as_pace(clock, capsys):
    """Set-up: 40 of 50 pictures exist; the clock says one minute per new one.

    Expectation: after one new picture, nine minutes or more are left, not the seconds that 41 per minute would give.
    """
    with options.counted("hole-size") as show:
        show(40, 50, 0)
        show(41, 50, 0)
        show(42, 50, 1)
    first, second, third = capsys.readouterr().err.splitlines()
    assert first == "hole-size: 40 of 50"
    assert second == "hole-size: 41 of 50, 2 min so far, about 18 min left"
    assert third == "hole-size: 42 of 50, 3 min so far, about 7 min left, 1 failed"
