"""Results shared by all processes of a test run: the first process computes them, the others read them."""

from __future__ import annotations

import fcntl
import hashlib
import os
import pickle
from collections.abc import Callable
from functools import cache, wraps
from pathlib import Path
from typing import ParamSpec, TypeVar

P, R = ParamSpec("P"), TypeVar("R")
FOLDER = "DASIM_TESTS_SHARED"  # environment variable with the folder of this run, set by the first process


def shared(function: Callable[P, R]) -> Callable[P, R]:
    """Decorator that caches results by arguments, for all processes of a test run.

    The function must be deterministic, with arguments and results that can be pickled. While one process computes a
    result, the others wait for it.
    """

    @cache
    @wraps(function)
    def wrapper(*arguments, **named):
        folder = os.environ.get(FOLDER)
        if folder is None:
            return function(*arguments, **named)
        key = repr((function.__module__, function.__qualname__, arguments, sorted(named.items())))
        path = Path(folder) / f"{function.__name__}-{hashlib.sha256(key.encode()).hexdigest()[:16]}.pickle"
        with open(path.with_suffix(".lock"), "w") as lock:
            fcntl.flock(lock, fcntl.LOCK_EX)
            if not path.exists():
                partial = path.with_suffix(".partial")
                partial.write_bytes(pickle.dumps(function(*arguments, **named)))
                partial.rename(path)
            return pickle.loads(path.read_bytes())

    return wrapper
