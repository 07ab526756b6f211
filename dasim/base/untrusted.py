"""Safe reading of untrusted files: their type and size are checked before they are read.

A file must be a regular file, because a pipe or a device may never end. Its size, and the number of pixels or values
stated in its header, must be within limits, which a user can raise by environment variables (``LIMITS``).

Tested in tests/dasim/base/test_untrusted.py.
"""

from __future__ import annotations

import io
import json
import logging
import math
import os
import re
import stat
import sys
import tomllib
import warnings
import zipfile
import zlib
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dasim.base.errors import InputError

LIMITS = {"DASIM_MOST_FILE_MB": 2000.0, "DASIM_MOST_MPX": 100.0}  # variable and its value where it is not set
TEXT_BYTES = 64_000_000  # of a text, table or specification
_RADIANCE = re.compile(rb"\n([-+][XY]) (\d+) ([-+][XY]) (\d+)\n")  # size in the header of Radiance's HDR pictures
_PNG = b"\x89PNG\r\n\x1a\n"
_EXR = b"\x76\x2f\x31\x01"
_NUMBERS = "buif"  # kinds of NumPy types: booleans, whole numbers, floating point


def limit(variable: str) -> float:
    """Value of a limit: that of the environment variable, or else the default; InputError where it is no number."""
    text = os.environ.get(variable, "")
    try:
        value = float(text) if text else LIMITS[variable]
    except ValueError:
        value = math.nan
    if not value > 0:
        raise InputError(f"{variable}={text}: is not a number above 0")
    return value


def content(path: Path, where: str, most_bytes: float = math.inf) -> bytes:
    """Content of a regular file of a limited size.

    Raises InputError where the file is missing, cannot be read, is a pipe, device or folder, or is too large.

    Args:
        path: the file.
        where: start of the message, such as ``image 'a.png'``.
        most_bytes: largest size, where it is less than that of all files.
    """
    try:
        with open(os.open(path, os.O_RDONLY | os.O_NONBLOCK), "rb") as file:  # a pipe without a writer does not wait
            about = os.fstat(file.fileno())
            if not stat.S_ISREG(about.st_mode):
                raise InputError(f"{where}: is not a regular file but a folder, pipe or device; give a file")
            most = min(most_bytes, 1e6 * limit("DASIM_MOST_FILE_MB"))
            if about.st_size > most:
                raise InputError(
                    f"{where}: has {about.st_size / 1e6:.4g} MB, at most {most / 1e6:.4g} MB are read"
                    + ("" if most == most_bytes else "; set DASIM_MOST_FILE_MB to read more")
                )
            return file.read(about.st_size)  # no more, if it grows meanwhile
    except IsADirectoryError:
        raise InputError(f"{where}: is a folder; give a file") from None
    except (OSError, ValueError) as error:  # ValueError: InputError, and names with a NUL
        if isinstance(error, InputError):
            raise
        raise InputError(f"{where}: cannot be read ({getattr(error, 'strerror', None) or error})") from None


def check_file(path: Path, where: str) -> None:
    """Raise InputError where a file that a library opens by its name is not a regular one of a limited size."""
    try:
        about = path.stat()
    except (OSError, ValueError) as error:
        raise InputError(f"{where}: cannot be read ({getattr(error, 'strerror', None) or error})") from None
    if not stat.S_ISREG(about.st_mode):
        raise InputError(f"{where}: is not a regular file but a folder, pipe or device; give a file")
    most = 1e6 * limit("DASIM_MOST_FILE_MB")
    if about.st_size > most:
        raise InputError(
            f"{where}: has {about.st_size / 1e6:.4g} MB, at most {most / 1e6:.4g} MB are read; "
            "set DASIM_MOST_FILE_MB to read more"
        )


@contextmanager
def quiet() -> Iterator[None]:
    """Discard what libraries print or log about a damaged file while the block runs: its error says enough."""
    sys.stderr.flush()
    try:
        kept = os.dup(2)
    except OSError:  # there is no standard error
        yield
        return
    log = logging.getLogger("tifffile")
    level, nowhere = log.level, os.open(os.devnull, os.O_WRONLY)
    try:
        os.dup2(nowhere, 2)
        log.setLevel(logging.CRITICAL + 1)
        yield
    finally:
        os.dup2(kept, 2)
        log.setLevel(level)
        os.close(kept)
        os.close(nowhere)


def text(path: Path, where: str) -> str:
    """Text of a UTF-8 file, with or without a byte order mark."""
    try:
        return content(path, where, TEXT_BYTES).decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise InputError(f"{where}: cannot be read, is not UTF-8 text (byte {error.start}); save it as UTF-8") from None


def toml(path: Path, where: str) -> dict[str, Any]:
    """Values of a TOML file."""
    try:
        values = tomllib.loads(text(path, where))
        _check_whole(values)
        return values
    except InputError:
        raise
    except (ValueError, RecursionError) as error:  # also whole numbers of thousands of digits, and deep nesting
        raise InputError(f"{where}: not valid TOML ({_reason(error)})") from None


def json_object(path: Path, where: str) -> dict[str, Any]:
    """Values of a JSON file that holds an object."""
    return json_values(text(path, where), where)


def json_values(written: str | bytes, where: str) -> dict[str, Any]:
    """Values of a JSON text that holds an object."""
    try:
        values = json.loads(written, parse_int=_whole)
    except (ValueError, RecursionError) as error:
        raise InputError(f"{where}: cannot be read, is not valid JSON ({_reason(error)})") from None
    if not isinstance(values, dict):
        raise InputError(f"{where}: holds {type(values).__name__}, not an object of JSON")
    return values


def _whole(digits: str) -> int:
    """An integer; ValueError beyond 128 bits, which no valid value needs."""
    number = int(digits)
    if abs(number) >= 1 << 128:
        raise ValueError("has a whole number of more than 128 bits")
    return number


def _check_whole(values: Any) -> None:
    """Raise ValueError if nested values contain an integer of more than 128 bits."""
    if type(values) is int:  # not a boolean
        _whole(str(values))
    elif isinstance(values, (list, dict)):
        for value in values.values() if isinstance(values, dict) else values:
            _check_whole(value)


def _reason(error: Exception) -> str:
    return "is nested too deeply" if isinstance(error, RecursionError) else str(error)


# --- pictures ------------------------------------------------------------------------------------


def picture(path: Path, where: str, flags: int) -> NDArray[Any]:
    """A decoded picture (PNG, JPEG, TIFF, HDR and others) in OpenCV's order of channels; ``flags`` are OpenCV's.

    Raises InputError where it cannot be read, has more pixels than the limit, or is a truncated or damaged PNG.
    """
    return decoded(content(path, where), where, flags)


def check_picture(path: Path, where: str) -> None:
    """Raise InputError where a picture that a library opens by its name is none, or has more pixels than the limit."""
    data = content(path, where)
    if data.startswith(_EXR):
        check_exr(path, where)
    else:
        check_pixels(_size_px(data, where), where)
        if data.startswith(_PNG):
            check_png(data, where)


def decoded(data: bytes, where: str, flags: int) -> NDArray[Any]:
    """A decoded picture of the content of its file, see :func:`picture`."""
    import cv2

    check_pixels(_size_px(data, where), where)
    if data.startswith(_PNG):
        check_png(data, where)
    try:
        with quiet():
            image = cv2.imdecode(np.frombuffer(data, np.uint8), flags)
    except cv2.error:
        image = None
    if image is None:
        raise InputError(f"{where}: cannot be read as a picture")
    return np.asarray(image)


def check_pixels(size_px: tuple[int, int], where: str) -> None:
    """Raise InputError for a picture of more pixels than the limit; ``size_px`` is [width, height]."""
    width, height = size_px
    most = limit("DASIM_MOST_MPX")
    if width * height > 1e6 * most:
        raise InputError(
            f"{where}: has {width} x {height} pixels, at most {most:g} million are read; "
            "set DASIM_MOST_MPX to read more"
        )


def _size_px(data: bytes, where: str) -> tuple[int, int]:
    """Width and height that the header of a picture states."""
    from PIL import Image

    if data.startswith(b"#?") and (match := _RADIANCE.search(data[:4096])):
        return int(match[4]), int(match[2])
    if data.startswith(_PNG) and len(data) >= 24:
        return int.from_bytes(data[16:20]), int.from_bytes(data[20:24])
    try:
        with quiet(), warnings.catch_warnings(action="ignore"), Image.open(io.BytesIO(data)) as opened:
            return opened.size
    except Image.DecompressionBombError:
        raise InputError(f"{where}: has more pixels than any camera; give a smaller picture") from None
    except Exception:  # the readers of the many formats raise many types
        raise InputError(f"{where}: cannot be read as a picture, or is truncated") from None


def check_png(data: bytes, where: str) -> None:
    """Raise InputError where a PNG is truncated or damaged: a decoder would fill what is missing with zeros."""
    place, inflate = len(_PNG), zlib.decompressobj()
    kinds: list[bytes] = []
    try:
        while not kinds or kinds[-1] != b"IEND":
            length = int.from_bytes(data[place : place + 4])
            kind, chunk = data[place + 4 : place + 8], data[place + 8 : place + 8 + length]
            if (
                len(kind) != 4
                or len(chunk) != length
                or zlib.crc32(kind + chunk) != int.from_bytes(data[place + 8 + length : place + 12 + length])
            ):
                raise InputError(f"{where}: is a truncated or damaged PNG (checksum at byte {place})")
            while kind == b"IDAT" and chunk:
                inflate.decompress(chunk, 1 << 20)  # in pieces: a bomb needs no memory
                chunk = inflate.unconsumed_tail
            kinds.append(kind)
            place += 12 + length
    except zlib.error as error:
        raise InputError(f"{where}: is a damaged PNG ({error})") from None
    if not inflate.eof:
        raise InputError(f"{where}: is a truncated PNG, its pixels end early")


def check_exr(path: Path, where: str) -> None:
    """Raise InputError where an EXR file is no regular one, cannot be read, or has more pixels than the limit."""
    import OpenEXR

    check_file(path, where)
    try:
        with quiet(), OpenEXR.File(str(path), header_only=True) as file:
            windows = [part.header["dataWindow"] for part in file.parts]
    except Exception as error:  # the library raises many types for damaged files
        raise InputError(f"{where}: cannot be read as EXR, or is truncated ({error})") from None
    for low, high in windows:
        check_pixels((int(high[0]) - int(low[0]) + 1, int(high[1]) - int(low[1]) + 1), where)


# --- arrays --------------------------------------------------------------------------------------


def array(path: Path, where: str) -> NDArray[Any]:
    """Numbers of an NPY file."""
    return _array(content(path, where), where)


def arrays(path: Path, where: str) -> Mapping[str, NDArray[Any]]:
    """Arrays of an NPZ file by name, of numbers or a text; in all no more bytes than the limit of a file."""
    try:
        with zipfile.ZipFile(io.BytesIO(content(path, where))) as archive:
            members = archive.infolist()
            names = [member.filename for member in members]
            if len(set(names)) != len(names):
                raise InputError(f"{where}: has an entry twice")
            total, most = sum(member.file_size for member in members), 1e6 * limit("DASIM_MOST_FILE_MB")
            if total > most:
                raise InputError(
                    f"{where}: unpacks to {total / 1e6:.4g} MB, at most {most / 1e6:.4g} MB are read; "
                    "set DASIM_MOST_FILE_MB to read more"
                )
            return {
                name.removesuffix(".npy"): _array(archive.read(name), f"{where}: {name}", _NUMBERS + "U")
                for name in names
            }
    except InputError:
        raise
    except Exception as error:  # a damaged directory of the archive makes zipfile raise many types
        raise InputError(f"{where}: is damaged, or no NPZ file ({type(error).__name__})") from None


def _array(data: bytes, where: str, kinds: str = _NUMBERS) -> NDArray[Any]:
    """Array of the content of an NPY file, whose header must fit the rest of it."""
    header = io.BytesIO(data)
    try:
        with warnings.catch_warnings(action="ignore"):
            version = np.lib.format.read_magic(header)
            read = {(1, 0): np.lib.format.read_array_header_1_0, (2, 0): np.lib.format.read_array_header_2_0}[version]
            shape, column_major, dtype = read(header)
    except Exception as error:  # the header is an expression of Python, which fails in many ways
        raise InputError(f"{where}: cannot be read as an NPY array ({type(error).__name__})") from None
    if dtype.kind not in kinds:
        raise InputError(f"{where}: holds {dtype}; it must hold integers or floating-point numbers")
    if math.prod(shape) * dtype.itemsize != len(data) - header.tell() or min(shape, default=0) < 0:
        raise InputError(f"{where}: its header promises {shape} of {dtype}, which its content does not fit")
    values = np.frombuffer(data, dtype, offset=header.tell()) if math.prod(shape) else np.empty(0, dtype)
    return values.reshape(shape, order="F" if column_major else "C").copy()
