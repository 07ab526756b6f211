"""Stages of a pipeline that report their progress and measure their time.

Tested in tests/recon/test_pipeline.py.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager

from dasim.typing import Progress

Stage = Callable[[str], AbstractContextManager[None]]


def stages(names: Sequence[str], timings_s: dict[str, float], progress: Progress | None) -> Stage:
    """Context managers by stage name.

    On entry, ``progress`` is called with the name and the share of ``names`` before it; on exit, the wall time goes
    to ``timings_s``.
    """

    @contextmanager
    def stage(name: str) -> Iterator[None]:
        if progress:
            progress(name, names.index(name) / len(names))
        start = time.perf_counter()
        yield
        timings_s[name] = time.perf_counter() - start

    return stage
