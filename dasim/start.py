"""Start of the command ``dasim``, which can be stopped while modules are loaded.

Tested in tests/dasim/cli/test_stopped.py.
"""

from __future__ import annotations

import os
import signal
from typing import Any


def main() -> None:
    """Entry point: :func:`dasim.cli.main`, which replaces these signal handlers."""

    def stop(number: int, frame: Any) -> None:
        os.write(2, b"dasim: stopped; no incomplete output is left\n")
        os._exit(128 + number)  # a library that is interrupted while it is loaded may do anything with an exception

    for name in (signal.SIGINT, signal.SIGTERM):
        signal.signal(name, stop)
    from dasim.cli import main as run  # takes a second

    run()
