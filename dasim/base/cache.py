"""Folder for results that are kept between runs and may be deleted at any time.

Tested in tests/dasim/cli/test_commands.py.
"""

from __future__ import annotations

import os
from pathlib import Path

import platformdirs


def cache_dir() -> Path:
    """The user's cache folder for dasim, not necessarily existing; the variable ``DASIM_CACHE_DIR`` overrides it."""
    chosen = os.environ.get("DASIM_CACHE_DIR")
    return Path(chosen) if chosen else Path(platformdirs.user_cache_dir("dasim"))
