"""Results that all processes of a test run share: the first process that needs one makes it, the others read it."""

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
FOLDER = "DASIM_TESTS_SHARED"  # variable with the folder of this run, set by the first process


def shared(function: Callable[P, R]) -> Callable[P, R]:
    """Remember results by arguments, in this process and for the others of the same run.

    For functions that always give the same, whose arguments and results pickle. Other processes wait meanwhile.
    """

    @cache
    @wraps(function)
    def remembered(*arguments, **named):
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

    return remembered
