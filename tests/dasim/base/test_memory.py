"""The peak memory of a process is its own."""

from __future__ import annotations

import subprocess
import sys

import numpy as np

from dasim.base.memory import peak_bytes

MOST_MB = 300


def test_what_is_used_counts():
    before = peak_bytes()
    used = np.ones(before // 8 + 50_000_000)  # more than was ever in memory, by 400 MB
    assert peak_bytes() >= used.nbytes


def test_memory_of_the_process_that_started_another_does_not_count():
    held = np.ones(100_000_000)
    command = [sys.executable, "-c", "from dasim.base.memory import peak_bytes; print(peak_bytes())"]
    found = int(subprocess.run(command, capture_output=True, text=True, check=True).stdout)
    assert 1e6 < found < MOST_MB * 1e6 < held.nbytes
