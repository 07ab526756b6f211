"""Threads for NumPy, SciPy and compiled functions, which release Python's lock in long operations.

The threads stay for later calls: starting new ones for each of hundreds of short calls takes longer than the work on a
small picture.

Tested in tests/dasim/base/test_threads.py.
"""

from __future__ import annotations

import os
import threading
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from typing import TypeVar

Item = TypeVar("Item")
Result = TypeVar("Result")

_current = threading.local()


def mapped(function: Callable[[Item], Result], items: Iterable[Item], count: int) -> Iterator[Result]:
    """Results of a function for several items, in their order, by ``count`` threads.

    Within one of these threads, for one thread or for one item, the calling thread does the work, item by item as
    results are taken. What the function writes must depend on its item alone.
    """
    tasks = list(items)
    if min(count, len(tasks)) < 2 or getattr(_current, "is_of_pool", False):
        return map(function, tasks)
    return _pool(count).map(function, tasks)


@cache
def _pool(count: int) -> ThreadPoolExecutor:
    return ThreadPoolExecutor(count, "dasim", _mark)


def _mark() -> None:
    """A thread that waited for others of its pool could wait for ever."""
    _current.is_of_pool = True


if hasattr(os, "register_at_fork"):  # a forked process has no threads: calls would wait for them
    os.register_at_fork(after_in_child=_pool.cache_clear)
