"""Files of a dataset in a folder or at any fsspec address (``s3://...``), written atomically.

Tested in tests/dasim/dataset/test_storage.py, tests/dasim/dataset/test_s3.py and, where runs are stopped while they
write, in tests/dasim/dataset/test_interrupted.py.
"""

from __future__ import annotations

import errno
import fcntl
import os
import shutil
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from functools import lru_cache, wraps
from pathlib import Path
from typing import IO, Any, Concatenate, ParamSpec, TypeVar

import fsspec

from dasim.base import atomic
from dasim.base.atomic import PARTIAL
from dasim.base.errors import InputError

REMOVALS = 20  # tries to remove a folder that other runs change


def _file_system(out: str) -> tuple[Any, str]:
    """File system (fsspec) of an output, and the path of the output in it."""
    # A relative path depends on the working folder. A forked process cannot use the connections of its parent.
    return _file_system_of_process(out, os.getpid(), os.getcwd())


@lru_cache(maxsize=8)
def _file_system_of_process(out: str, process: int, folder: str) -> tuple[Any, str]:
    try:
        fs, root = fsspec.core.url_to_fs(out, use_listings_cache=False)  # other processes write to it at the same time
    except (ImportError, ValueError) as error:
        raise InputError(f"{out}: cannot be opened: {error}") from None
    return fs, root.rstrip("/")


Result = TypeVar("Result")
Others = ParamSpec("Others")


def _with_os_errors(function: Callable[Concatenate[str, Others], Result]) -> Callable[Concatenate[str, Others], Result]:
    """Decorator that turns errors of remote stores, which have their own types, into OSError."""

    @wraps(function)
    def wrapper(out: str, *arguments: Others.args, **options: Others.kwargs) -> Result:
        try:
            return function(out, *arguments, **options)
        except (OSError, InputError):
            raise
        except Exception as error:
            if is_local(out):
                raise
            message = " ".join(f"{type(error).__name__}: {error}".split())
            raise ConnectionError(errno.EIO, message, out) from None

    return wrapper


def is_local(out: str) -> bool:
    """Whether an output is a folder of this computer."""
    return "local" in _file_system(out)[0].protocol or "file" in _file_system(out)[0].protocol


def local_path(out: str) -> Path:
    """Path of an output that is a folder of this computer."""
    return Path(_file_system(out)[1])


@contextmanager
def writing(out: str, name: str) -> Iterator[IO[bytes]]:
    """Open a binary file of the dataset for writing; it appears when the block ends."""
    fs, root = _file_system(out)
    if not is_local(out):
        file = fs.open(f"{root}/{name}", "wb")
        try:
            yield file
        except BaseException:
            file.discard()
            raise
        file.close()
        return
    with atomic.writing(Path(root) / name, clearing=False) as file:  # :func:`sweep` does it once
        yield file


@_with_os_errors
def write(out: str, name: str, data: bytes) -> None:
    """Write a file of the dataset atomically."""
    if is_local(out):
        with writing(out, name) as file:
            file.write(data)
        return
    fs, root = _file_system(out)
    fs.pipe_file(f"{root}/{name}", data)


@contextmanager
def reading(out: str, name: str) -> Iterator[IO[bytes]]:
    """Open a binary file of the dataset for reading."""
    fs, root = _file_system(out)
    with fs.open(f"{root}/{name}", "rb") as file:
        yield file


@_with_os_errors
def read(out: str, name: str) -> bytes:
    """Content of a file; FileNotFoundError where it is missing."""
    fs, root = _file_system(out)
    return bytes(fs.cat_file(f"{root}/{name}"))


@_with_os_errors
def exists(out: str, name: str = "") -> bool:
    """Whether a file or folder of the dataset exists; without ``name``, the dataset itself."""
    fs, root = _file_system(out)
    return bool(fs.exists(f"{root}/{name}" if name else root))


@_with_os_errors
def names(out: str, folder: str = "") -> list[str]:
    """Sorted names of all files below a folder, relative to the dataset, without unfinished files."""
    fs, root = _file_system(out)
    below = f"{root}/{folder}" if folder else root
    paths = fs.find(below) if fs.exists(below) else []
    return sorted(name[len(root) + 1 :] for name in paths if not name.endswith(PARTIAL))


@_with_os_errors
def remove(out: str, name: str) -> None:
    """Remove a file, or a folder with its content, if it exists."""
    fs, root = _file_system(out)
    path = f"{root}/{name}"
    for _ in range(REMOVALS):
        try:
            fs.rm(path, recursive=True)
            return
        except FileNotFoundError:  # another run may remove it too
            if not fs.exists(path):
                return
        except OSError as error:
            if error.errno not in (errno.ENOTEMPTY, errno.EEXIST):  # a file appeared meanwhile
                raise


@contextmanager
def no_empty_folder(out: str) -> Iterator[None]:
    """Remove the folders of an output of this computer that the block has made and left without a file."""
    new = None
    place = local_path(out).absolute() if is_local(out) else Path("/")
    while not place.exists():
        new, place = place, place.parent
    try:
        yield
    finally:
        for folder, _, _ in os.walk(new, topdown=False) if new is not None else ():
            with suppress(OSError):  # it is not empty, or another run has removed it
                os.rmdir(folder)


def sweep(out: str) -> None:
    """Remove unfinished files in a folder of this computer whose writer has ended."""
    if is_local(out):
        atomic.sweep(local_path(out))


@contextmanager
def claimed(out: str, name: str, places: Sequence[int]) -> Iterator[bool]:
    """Hold exclusive locks on numbered slots of a local dataset, each the lock of one byte of a file.

    The operating system releases the locks when the process ends, however it ends. Yields False if another process
    holds one of them, and True without locks if the file system does not support them or ``out`` is a remote store.

    Args:
        out: the dataset.
        name: file whose bytes are locked; it is created, and nothing else may open, remove or replace it.
        places: numbers of the slots, from 0, in ascending order.
    """
    if not is_local(out):
        yield True
        return
    path = local_path(out) / name
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("ab") as file:
        free = True
        try:
            for place in places:
                fcntl.lockf(file, fcntl.LOCK_EX | fcntl.LOCK_NB, 1, place)
        except OSError as error:
            free = error.errno not in (errno.EACCES, errno.EAGAIN)
        yield free


def free_bytes(out: str) -> int | None:
    """Free space of an output in bytes; None where it is unknown."""
    if not is_local(out):
        return None
    path = local_path(out)
    while not path.exists():
        path = path.parent
    return shutil.disk_usage(path).free


def check_writable(out: str) -> None:
    """Raise InputError if files cannot be written to an output."""
    try:
        name = f".writable.{atomic.writer()}{PARTIAL}"
        write(out, name, b"")
        remove(out, name)
    except OSError as error:
        raise InputError(f"{out}: cannot be written: {error.strerror or error}") from None
