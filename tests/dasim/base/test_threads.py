"""Threads that stay: order, errors, threads within threads, forked processes."""

from __future__ import annotations

import os
import signal
import threading

import pytest

from dasim.base.threads import mapped


def test_results_are_in_the_order_of_the_items():
    assert list(mapped(lambda item: item**2, range(50), 4)) == [item**2 for item in range(50)]


def test_errors_reach_the_caller():
    with pytest.raises(ZeroDivisionError):
        list(mapped(lambda item: 1 // item, range(3), 2))


def test_threads_stay():
    """Set-up: every item waits for the other one, so that two threads work."""
    together = threading.Barrier(2)

    def own(item: int) -> int:
        together.wait(20)
        return threading.get_ident()

    first, second = (set(mapped(own, range(2), 2)) for _ in range(2))
    assert first == second
    assert len(first) == 2


@pytest.mark.parametrize(("items", "count"), [(8, 1), (1, 8)])
def test_the_caller_works_alone(items, count):
    assert set(mapped(lambda item: threading.get_ident(), range(items), count)) == {threading.get_ident()}


def test_a_thread_can_call_for_threads():
    """Rationale: with every thread of a pool waiting for others of it, nobody would work."""

    def sums(item: int) -> int:
        return sum(mapped(lambda other: item * other, range(4), 2))

    with_all = threading.Thread(target=lambda: found.extend(mapped(sums, range(8), 2)), daemon=True)
    found: list[int] = []
    with_all.start()
    with_all.join(20)
    assert found == [6 * item for item in range(8)]


@pytest.mark.skipif(not hasattr(os, "fork"), reason="no os.fork on this computer")
def test_forked_processes_have_threads_of_their_own():
    """Rationale: threads do not survive a fork, and a child would wait for them without end."""
    list(mapped(lambda item: item, range(4), 2))
    child = os.fork()
    if not child:
        signal.alarm(20)
        os._exit(0 if list(mapped(lambda item: item + 1, range(4), 2)) == [1, 2, 3, 4] else 1)
    assert os.waitpid(child, 0)[1] == 0
