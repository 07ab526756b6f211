"""Stages of a pipeline, with progress reports and timings.

Tested in tests/recon/test_pipeline.py.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager

from dasim.typing import Progress

Stage = Callable[[str], AbstractContextManager[None]]


def stages(names: Sequence[str], timings_s: dict[str, float], progress: Progress | None) -> Stage:
    """A function that returns the context manager of a stage in ``names``.

    On entry, ``progress`` is called with the name and the share of stages before it, 0..1. On exit, ``timings_s``
    receives the wall time in seconds.
    """

    @contextmanager
    def stage(name: str) -> Iterator[None]:
        if progress:
            progress(name, names.index(name) / len(names))
        start = time.perf_counter()
        yield
        timings_s[name] = time.perf_counter() - start

    return stage
