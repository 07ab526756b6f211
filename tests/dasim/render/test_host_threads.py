"""Work of the host in threads: order, errors, and as many threads as render."""

from __future__ import annotations

import os
import signal
import threading

import numpy as np
import pytest

from dasim.render import backend, host_threads
from dasim.render.host_threads import in_threads
from dasim.simulation import rendering_noise
from dasim.simulation.rendering_noise import Picture


@pytest.fixture
def threads():
    import drjit

    before = drjit.thread_count()
    yield backend.use_threads
    backend.use_threads(before)


def test_results_are_in_the_order_of_the_items(threads):
    threads(4)
    assert in_threads(lambda item: item**2, range(50)) == [item**2 for item in range(50)]


@pytest.mark.parametrize("count", [1, 3, 64])
def test_there_are_as_many_threads_as_render(threads, count):
    """Rationale: a process of a dataset renders on one thread, because others have the other cores.

    Set-up: every item waits until as many have begun as there should be threads.
    """
    threads(count)
    wanted = min(count, host_threads.MOST_THREADS)
    together = threading.Barrier(wanted)
    found = set(in_threads(lambda item: (together.wait(20), threading.get_ident())[1], range(wanted)))
    assert len(found) == wanted
    assert (found == {threading.get_ident()}) is (count == 1)


def test_errors_reach_the_caller(threads):
    threads(2)
    with pytest.raises(ZeroDivisionError):
        in_threads(lambda item: 1 // item, range(3))


def test_noise_does_not_depend_on_the_threads(threads):
    """Set-up: pictures with 600 rows, which are computed in strips."""
    random = np.random.default_rng(0)
    first, second = (
        Picture(np.full((2, 600, 9), 4), *random.normal(1, 0.1, (2, 2, 600, 9, 3)).astype(np.float32)) for _ in range(2)
    )
    results = []
    for count in (1, 4):
        threads(count)
        sums = rendering_noise.no_pairs(first, 1)
        rendering_noise.add(sums, first, second)
        results.append([*rendering_noise.measured(sums), *rendering_noise.of_sum(sums)])
    for one, several in zip(*results, strict=True):
        assert np.array_equal(one, several)


@pytest.mark.skipif(not hasattr(os, "fork"), reason="no os.fork on this computer")
def test_forked_processes_have_threads_of_their_own(threads):
    """Rationale: threads do not survive a fork, and a child would wait for them without end."""
    threads(2)
    in_threads(lambda item: item, range(4))
    child = os.fork()
    if not child:
        signal.alarm(20)
        os._exit(0 if in_threads(lambda item: item + 1, range(4)) == [1, 2, 3, 4] else 1)
    assert os.waitpid(child, 0)[1] == 0
