"""Atomic writes of files and folders: under a temporary name, which is renamed once the content is complete."""

from __future__ import annotations

import os
import platform
import re
import shutil
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import IO

PARTIAL = ".partial"  # ending of temporary names
RETIRED = ".old"  # ending of the temporary name of a previous folder while a new one replaces it
UNFINISHED_ENDING = rf"\.\d+\..*\.\d+({re.escape(PARTIAL)}|{re.escape(RETIRED)})"  # see :func:`writer`
UNFINISHED = re.compile(rf"\..+{UNFINISHED_ENDING}")
ABANDONED_S = 24 * 3600.0  # age at which an unfinished file of another computer is considered abandoned


_last: Path | None = None  # what this process wrote last, see :func:`last_written`


def last_written() -> Path | None:
    """Absolute path of the file or folder that this process has written last; it is complete."""
    return _last


def write(path: Path, content: bytes | str) -> None:
    """Write a file atomically, text as UTF-8; missing parent folders are created."""
    with writing(path) as file:
        file.write(content.encode() if isinstance(content, str) else content)


@contextmanager
def writing(path: Path, *, clearing: bool = True) -> Iterator[IO[bytes]]:
    """Open a binary file that replaces ``path`` when the block ends, and leaves no trace when the block raises.

    Leftovers of killed processes for the same output are removed first, unless ``clearing`` is off: the search is slow
    in a folder with very many files.
    """
    path = Path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    if clearing:
        clear(path)
    partial = path.with_name(f".{path.name}.{writer()}{PARTIAL}")
    is_whole = False
    try:
        with _named(path):
            with partial.open("wb") as file:
                yield file
            is_whole = True
            partial.replace(path)
    finally:
        _note(path, is_whole and not partial.exists())  # also where a signal came right after the renaming
        partial.unlink(missing_ok=True)


@contextmanager
def new_folder(path: Path) -> Iterator[Path]:
    """Create a temporary folder that becomes ``path`` when the block ends, and is removed when the block raises.

    An existing folder at ``path`` is replaced as a whole. Leftovers of killed processes for the same output are removed
    first.
    """
    path = Path(path).resolve()
    path.parent.mkdir(parents=True, exist_ok=True)
    clear(path)
    temporary = path.with_name(f".{path.name}.{writer()}{PARTIAL}")
    retired = temporary.with_suffix(RETIRED)
    temporary.mkdir(mode=0o700)
    try:
        with _named(path):
            yield temporary
            temporary.chmod(0o755)
            if path.exists():
                os.rename(path, retired)
            os.rename(temporary, path)
        shutil.rmtree(retired, ignore_errors=True)
    finally:
        _note(path, not temporary.exists())
        shutil.rmtree(temporary, ignore_errors=True)
        if retired.exists() and not path.exists():  # interrupted between the two renames
            os.rename(retired, path)


def _note(path: Path, is_written: bool) -> None:
    """Record an output as the last one written, if it was written."""
    global _last
    if is_written:
        _last = path.absolute()


@contextmanager
def _named(path: Path) -> Iterator[None]:
    """Set the file name of write errors to that of the output, if they have none or name a temporary file.

    A write to a full disk raises an error without a file name, because the system call takes a file descriptor.
    """
    try:
        yield
    except OSError as error:
        if error.filename is None and error.errno is not None:
            error.filename = str(path)
        elif isinstance(error.filename, str) and any(mark in error.filename for mark in (PARTIAL, RETIRED)):
            error.filename, error.filename2 = str(path), None
        raise


def writer() -> str:
    """Name of this thread, unique among all threads, processes and computers that write into a folder."""
    return f"{threading.get_ident()}.{platform.node()}.{os.getpid()}"


def sweep(folder: Path) -> None:
    """Remove unfinished files and folders anywhere below a folder whose writer has ended."""
    # Other runs may remove folders meanwhile, which os.walk passes over.
    for place, folders, files in os.walk(folder):
        for left in (Path(place) / name for name in (*folders, *files) if UNFINISHED.fullmatch(name)):
            if _is_abandoned(left):
                _remove(left)


def clear(path: Path) -> None:
    """Remove leftovers of an output, in the same folder, whose writers have ended.

    A previous folder that a writer had moved aside but not yet replaced is moved back.
    """
    mine = re.compile(rf"\.{re.escape(path.name)}{UNFINISHED_ENDING}")
    with suppress(OSError):  # another process may do the same, or the folder may not be read
        for left in [entry for entry in path.parent.iterdir() if mine.fullmatch(entry.name) and _is_abandoned(entry)]:
            if left.suffix == RETIRED and not path.exists():
                os.rename(left, path)
            else:
                _remove(left)


def _remove(left: Path) -> None:
    """Remove a file or a folder, if this user may and no other process does."""
    shutil.rmtree(left, ignore_errors=True)
    with suppress(OSError):
        left.unlink()


def _is_abandoned(left: Path) -> bool:
    """Whether the writer of an unfinished file or folder has ended.

    Processes of other computers cannot be looked up: what they write is abandoned after ``ABANDONED_S``.
    """
    computer, _, process = left.stem.rpartition(".")
    if computer.endswith(f".{platform.node()}") and process.isdigit():
        return not _runs(int(process))
    try:
        return time.time() - left.stat().st_mtime > ABANDONED_S
    except FileNotFoundError:
        return False


def _runs(process: int) -> bool:
    """Whether a process of this number exists on this computer."""
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    except PermissionError:
        return True
    return True
