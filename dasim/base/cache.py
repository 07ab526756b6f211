"""Folder of results that are reused between runs; it may be deleted at any time.

Several processes may use it at once: entries appear whole, and one that is missing or damaged is made again.

Tested in tests/dasim/base/test_cache.py.
"""

from __future__ import annotations

import os
import shutil
from contextlib import suppress
from pathlib import Path

import platformdirs

from dasim.base import atomic

MOST_BYTES = 4_000_000_000  # of one kind of results


def cache_dir() -> Path:
    """Path of the user's cache folder, which need not exist; the variable ``DASIM_CACHE_DIR`` overrides the default."""
    chosen_dir = os.environ.get("DASIM_CACHE_DIR")
    return Path(chosen_dir) if chosen_dir else Path(platformdirs.user_cache_dir("dasim"))


def used(path: Path) -> None:
    """Mark an entry as used now: :func:`bound` removes those first that were not used for the longest time."""
    with suppress(OSError):
        os.utime(path)


def bound(folder: Path, most_bytes: float = MOST_BYTES) -> None:
    """Remove what killed processes left unfinished in a folder of the cache, and its oldest entries above a size.

    An entry is a file or a folder. Another process may do the same, or make and use entries meanwhile.
    """
    atomic.sweep(folder)
    sizes: list[tuple[float, int, Path]] = []
    for path in folder.glob("[!.]*"):
        with suppress(OSError):
            files = [file for file in path.rglob("*") if file.is_file()] if path.is_dir() else [path]
            sizes.append((path.stat().st_mtime, sum(file.stat().st_size for file in files), path))
    total = sum(size for _, size, _ in sizes)
    for _, size, path in sorted(sizes):
        if total <= most_bytes:
            return
        shutil.rmtree(path, ignore_errors=True)
        with suppress(OSError):
            path.unlink(missing_ok=True)
        total -= size
