"""Files of a dataset, in a folder or at any address of fsspec (``s3://...``); written whole or not at all.

Tested in tests/dasim/dataset/test_make.py and tests/dasim/dataset/test_s3.py.
"""

from __future__ import annotations

import errno
import os
import shutil
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from functools import lru_cache, wraps
from pathlib import Path
from typing import IO, Any, Concatenate, ParamSpec, TypeVar

import fsspec

from dasim.base import atomic
from dasim.base.atomic import PARTIAL
from dasim.base.errors import InputError


def _opened(out: str) -> tuple[Any, str]:
    return _opened_in(out, os.getpid())  # connections do not outlive a fork


@lru_cache(maxsize=8)
def _opened_in(out: str, process: int) -> tuple[Any, str]:
    try:
        fs, root = fsspec.core.url_to_fs(out, use_listings_cache=False)  # other processes write there at the same time
    except (ImportError, ValueError) as error:
        raise InputError(f"{out}: cannot be opened: {error}") from None
    return fs, root.rstrip("/")


Result = TypeVar("Result")
Others = ParamSpec("Others")


def _asked(function: Callable[Concatenate[str, Others], Result]) -> Callable[Concatenate[str, Others], Result]:
    """Turn errors of stores, which have types of their own, into OSError."""

    @wraps(function)
    def ask(out: str, *arguments: Others.args, **options: Others.kwargs) -> Result:
        try:
            return function(out, *arguments, **options)
        except (OSError, InputError):
            raise
        except Exception as error:
            if is_local(out):
                raise
            message = " ".join(f"{type(error).__name__}: {error}".split())
            raise ConnectionError(errno.EIO, message, out) from None

    return ask


def is_local(out: str) -> bool:
    """Whether it is a folder of this computer."""
    return "local" in _opened(out)[0].protocol or "file" in _opened(out)[0].protocol


def local_path(out: str) -> Path:
    """The folder that it is on this computer."""
    return Path(_opened(out)[1])


@contextmanager
def writing(out: str, name: str) -> Iterator[IO[bytes]]:
    """A file of the dataset to write into; it appears as a whole when all is written."""
    fs, root = _opened(out)
    if not is_local(out):
        file = fs.open(f"{root}/{name}", "wb")
        try:
            yield file
        except BaseException:
            file.discard()
            raise
        file.close()
        return
    with atomic.writing(Path(root) / name) as file:
        yield file


@_asked
def write(out: str, name: str, data: bytes) -> None:
    """Write a file of the dataset as a whole."""
    if is_local(out):
        with writing(out, name) as file:
            file.write(data)
        return
    fs, root = _opened(out)
    fs.pipe_file(f"{root}/{name}", data)


@contextmanager
def reading(out: str, name: str) -> Iterator[IO[bytes]]:
    """A file of the dataset to read from."""
    fs, root = _opened(out)
    with fs.open(f"{root}/{name}", "rb") as file:
        yield file


@_asked
def read(out: str, name: str) -> bytes:
    """A file's content; FileNotFoundError where it is missing."""
    fs, root = _opened(out)
    return bytes(fs.cat_file(f"{root}/{name}"))


@_asked
def exists(out: str, name: str = "") -> bool:
    """Whether there is such a file or folder."""
    fs, root = _opened(out)
    return bool(fs.exists(f"{root}/{name}" if name else root))


@_asked
def names(out: str, folder: str = "") -> list[str]:
    """Names of all files below a folder, relative to the dataset, sorted; without unfinished files."""
    fs, root = _opened(out)
    below = f"{root}/{folder}" if folder else root
    found = fs.find(below) if fs.exists(below) else []
    return sorted(name[len(root) + 1 :] for name in found if not name.endswith(PARTIAL))


@_asked
def remove(out: str, name: str) -> None:
    """Remove a file or a folder with all that is in it, if it is there."""
    fs, root = _opened(out)
    path = f"{root}/{name}"
    with suppress(FileNotFoundError):  # another run may remove it too
        fs.rm(path, recursive=True)


def sweep(out: str) -> None:
    """Remove the unfinished files of killed writers; those of running writers stay."""
    if is_local(out):
        atomic.sweep(local_path(out))


def free_bytes(out: str) -> int | None:
    """Free space of the output, bytes; None where it is unknown."""
    if not is_local(out):
        return None
    path = local_path(out)
    while not path.exists():
        path = path.parent
    return shutil.disk_usage(path).free


def check_writable(out: str) -> None:
    """InputError where nothing can be written."""
    try:
        name = f".writable.{atomic.writer()}{PARTIAL}"
        write(out, name, b"")
        remove(out, name)
    except OSError as error:
        raise InputError(f"{out}: cannot be written: {error.strerror or error}") from None
