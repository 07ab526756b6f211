"""How fast this computer is now: limits on a test's processor time are multiples of a fixed piece of work."""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np


def paces(run: Callable[[], object], repeats: int = 1) -> float:
    """Processor time of a call over that of the reference work, the least of some repeats of each."""
    return min(_seconds(run) for _ in range(repeats)) / min(_seconds(_reference_work) for _ in range(5))


def _seconds(run: Callable[[], object]) -> float:
    begin = time.process_time()
    run()
    return time.process_time() - begin


def _reference_work() -> None:
    """Interpreted code, text, sorting, Fourier transforms, fresh memory: some 0.2 s."""
    total = 0
    for number in range(500_000):
        total += number
    np.array(" ".join(map(str, range(200_000))).split(), dtype=float)
    values = np.random.default_rng(0).random(1_000_000)
    np.sort(values)
    np.fft.fft2(values.reshape(1000, 1000))
    for _ in range(8):
        np.ones(1_000_000)
