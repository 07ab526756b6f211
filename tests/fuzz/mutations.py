"""Damage to files: bytes, text, numbers of TOML, JSON, XML, OBJ and CSV, members of archives, and headers of PNG."""

from __future__ import annotations

import io
import re
import struct
import zipfile
import zlib
from collections.abc import Callable

import numpy as np

Random = np.random.Generator

NASTY = (
    *("nan", "inf", "-inf", "-1", "0", "1e308", "-1e308", "1e-308", "1e38", "9" * 400, "9" * 5000, "0x10", "007", ""),
    *("true", "null", '"text"', "[]", "{}", "[[1]]", "[" * 3000, "$name", "1.5", "2147483648", "18446744073709551616"),
)
JUNK = ("\x00", "\x1b[31m", "é", "\u202e", "\ufeff", "\\", '"', "'", "\r", "<", ">", "&", "=", "[", "]", "{", "}", "#")
NUMBER = re.compile(r"-?\d+\.?\d*(?:[eE][-+]?\d+)?")
WORD = re.compile(r"[A-Za-z_][\w-]*")
LARGEST = 4_000_000  # bytes of a damaged file


def bytes_flipped(random: Random, data: bytes) -> bytes:
    """A few bytes changed at random."""
    out = bytearray(data)
    for _ in range(int(random.integers(1, 9))) if out else ():
        out[int(random.integers(len(out)))] = int(random.integers(256))
    return bytes(out)


def cut(random: Random, data: bytes) -> bytes:
    """The beginning of the file, or nothing."""
    return data[: int(random.integers(len(data) + 1))]


def repeated(random: Random, data: bytes) -> bytes:
    """A part of the file twice, or many times."""
    a, b = sorted(int(x) for x in random.integers(len(data) + 1, size=2))
    times = int(random.choice([2, 2, 3, 1000]))
    return (data[:b] + data[a:b] * (times - 1) + data[b:])[:LARGEST]


def removed(random: Random, data: bytes) -> bytes:
    """The file without a part of it."""
    a, b = sorted(int(x) for x in random.integers(len(data) + 1, size=2))
    return data[:a] + data[b:]


def _in_text(change: Callable[[Random, str], str]) -> Callable[[Random, bytes], bytes]:
    def mutation(random: Random, data: bytes) -> bytes:
        return change(random, data.decode("latin-1")).encode("latin-1", "replace")

    mutation.__name__ = change.__name__
    return mutation


def _one_replaced(pattern: re.Pattern[str], random: Random, text: str, by: str) -> str:
    found = list(pattern.finditer(text))
    if not found:
        return text + by
    place = found[int(random.integers(len(found)))]
    return text[: place.start()] + by + text[place.end() :]


def number(random: Random, text: str) -> str:
    """A number replaced by one that nothing has, or by something that is none."""
    return _one_replaced(NUMBER, random, text, str(random.choice(NASTY)))


def word(random: Random, text: str) -> str:
    """A name replaced by another one of the file."""
    words = WORD.findall(text) or ["name"]
    return _one_replaced(WORD, random, text, str(random.choice(words)))


def junk(random: Random, text: str) -> str:
    """A character that does not belong where it is."""
    place = int(random.integers(len(text) + 1))
    return text[:place] + str(random.choice(JUNK)) * int(random.choice([1, 1, 1, 3000])) + text[place:]


def lines(random: Random, text: str) -> str:
    """A line removed, repeated, or moved to another place."""
    rows = text.splitlines(keepends=True) or [""]
    a, b = (int(x) for x in random.integers(len(rows), size=2))
    row = rows.pop(a) if random.random() < 0.7 else rows[a]
    if random.random() < 0.6:
        rows.insert(b, row)
    return "".join(rows)


BYTES = (bytes_flipped, cut, repeated, removed)
TEXT = (*(_in_text(change) for change in (number, number, number, number, word, word, junk, lines)), *BYTES)


def png(random: Random, data: bytes) -> bytes:
    """A field of a PNG's header changed, with the right checksum, or bytes anywhere."""
    if random.random() < 0.5 or len(data) < 33:
        return BYTES[int(random.integers(len(BYTES)))](random, data)
    head = bytearray(data[12:29])
    if random.random() < 0.6:
        head[4:12] = struct.pack(">II", *(int(x) for x in random.choice([0, 1, 8, 4096, 100_000, 2**31 - 1], 2)))
    else:
        head[int(random.integers(12, 17))] = int(random.integers(256))
    return data[:12] + bytes(head) + struct.pack(">I", zlib.crc32(bytes(head))) + data[33:]


def glb(random: Random, data: bytes) -> bytes:
    """The JSON or the numbers of a GLB file damaged, with the right lengths in its header, or bytes anywhere.

    A GLB file has a header of 12 bytes, a chunk of JSON and one of numbers (glTF 2.0 specification, sec. 4.4).
    """
    if random.random() < 0.2 or len(data) < 20:
        return BYTES[int(random.integers(len(BYTES)))](random, data)
    end = 20 + int.from_bytes(data[12:16], "little")
    head, numbers = data[20:end], bytearray(data[end + 8 :])
    if random.random() < 0.7:
        head = TEXT[int(random.integers(len(TEXT)))](random, head)
    else:
        for place in random.integers(max(len(numbers) // 4, 1), size=3):
            value = random.choice([np.nan, np.inf, -1e30, 1e38, 3.4e-39])
            numbers[4 * int(place) : 4 * int(place) + 4] = struct.pack("<f", value)
    chunks = b""
    for kind, chunk in ((b"JSON", head + b" " * (-len(head) % 4)), (b"BIN\0", bytes(numbers))):
        chunks += struct.pack("<I", len(chunk)) + kind + chunk
    return b"glTF" + struct.pack("<II", 2, 12 + len(chunks)) + chunks


def archive(random: Random, data: bytes) -> bytes:
    """A member of a zip file damaged, missing, twice or empty, or bytes of the archive itself."""
    if random.random() < 0.3:
        return BYTES[int(random.integers(len(BYTES)))](random, data)
    with zipfile.ZipFile(io.BytesIO(data)) as old:
        members = [(name, old.read(name)) for name in old.namelist()]
    place = int(random.integers(len(members)))
    name, content = members[place]
    kind = random.random()
    if kind < 0.6:
        members[place] = (name, TEXT[int(random.integers(len(TEXT)))](random, content))
    elif kind < 0.7:
        del members[place]
    elif kind < 0.8:
        members[place] = (name, b"")
    elif kind < 0.9:
        members[place] = (f"../{name}", content)
    else:
        members[place] = (name, members[int(random.integers(len(members)))][1])
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w", zipfile.ZIP_DEFLATED) as new:
        for name, content in members:
            new.writestr(name, content)
    return out.getvalue()


def damaged(random: Random, name: str, data: bytes) -> bytes:
    """The content of a file, damaged once or twice in a way that fits its kind."""
    suffix = name.rpartition(".")[2].lower()
    for _ in range(int(random.choice([1, 1, 2]))):
        if suffix == "png":
            data = png(random, data)
        elif suffix == "glb":
            data = glb(random, data)
        elif suffix == "npz":
            try:
                data = archive(random, data)
            except Exception:  # the first damage was to the archive itself
                data = cut(random, data)
        else:
            among = TEXT if suffix in ("toml", "json", "xml", "obj", "csv", "npy", "ply") else BYTES
            data = among[int(random.integers(len(among)))](random, data)
    return data[:LARGEST]
