"""Folder of results that are reused between runs; it may be deleted at any time.

Tested in tests/dasim/cli/test_recon.py.
"""

from __future__ import annotations

import os
from pathlib import Path

import platformdirs


def cache_dir() -> Path:
    """Path of the user's cache folder, which need not exist; the variable ``DASIM_CACHE_DIR`` overrides the default."""
    chosen_dir = os.environ.get("DASIM_CACHE_DIR")
    return Path(chosen_dir) if chosen_dir else Path(platformdirs.user_cache_dir("dasim"))
