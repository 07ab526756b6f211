"""Work on the host between launches of the renderer, in several threads.

A third of the processor time of a capture is NumPy and SciPy on pictures: transforms, sums, statistics of noise. On a
computer of many cores, or with a graphics card, a capture would wait for it most of the time.

Tested in tests/dasim/render/test_host_threads.py.
"""

from __future__ import annotations

import contextlib
import ctypes
from collections.abc import Callable, Iterable
from functools import cache
from typing import TypeVar

from dasim.base.threads import mapped

MOST_THREADS = 8  # each takes up to 50 MB
M_ARENA_MAX = -8  # of glibc's malloc.h

Item = TypeVar("Item")
Result = TypeVar("Result")


def in_threads(function: Callable[[Item], Result], items: Iterable[Item]) -> list[Result]:
    """Results of a function for several items, in their order.

    There are as many threads as render (:func:`dasim.render.backend.use_threads`), ``MOST_THREADS`` at most: a process
    of a dataset has one. NumPy and SciPy release Python's lock in long operations. The function must use neither
    the renderer nor other threads, and what it writes must depend on its item alone, so that the bytes do not depend on
    the threads.
    """
    import drjit

    count = min(drjit.thread_count(), MOST_THREADS)
    if count > 1:
        _share_memory()
    return list(mapped(function, items, count))


@cache
def _share_memory() -> None:
    """With a pool of memory for each thread, which glibc gives them, a capture would take 120 MB more."""
    with contextlib.suppress(OSError, AttributeError, TypeError):  # glibc alone has it
        ctypes.CDLL(None).mallopt(M_ARENA_MAX, 2)
