"""Work of the host in threads: as many as render, and the same results."""

from __future__ import annotations

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
