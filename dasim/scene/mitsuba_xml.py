"""Checks of a Mitsuba XML file before Mitsuba's own parser sees it, which ends the process on some malformed files.

Tested in tests/dasim/base/test_untrusted.py.
"""

from __future__ import annotations

import math
import re
from pathlib import Path
from xml.parsers import expat

from dasim.base import untrusted
from dasim.base.errors import InputError

DEEPEST = 64  # levels of elements; scenes have less than ten
MOST_FILES = 1000  # that include each other
LARGEST = 1e12  # of numbers, in any unit
_NUMERIC = {
    *("float", "integer", "point", "vector", "rgb", "spectrum", "translate", "rotate", "scale", "lookat", "matrix")
}
_VALUES = ("value", "x", "y", "z", "angle", "origin", "target", "up")
_SHARES = {"alpha", "alpha_u", "alpha_v", "roughness"}  # numbers from 0 to 1
_LENGTHS = {"radius"}  # above 0
_SEPARATOR = re.compile(r"[\s,]+")


def check(file: Path, where: str) -> None:
    """Raise InputError where an XML file, or one that it includes, is malformed for Mitsuba.

    It must be UTF-8, without entities of its own, at most ``DEEPEST`` elements deep, and have finite numbers within
    ``LARGEST``. Parameters (``$name``) are checked where their values are given, by :func:`check_number`.
    """
    waiting, seen = [(file, where)], set()
    while waiting:
        path, name = waiting.pop()
        if path.resolve() in seen:
            continue
        seen.add(path.resolve())
        if len(seen) > MOST_FILES:
            raise InputError(f"{where}: includes more than {MOST_FILES} files")
        waiting += [(path.parent / part, f"{name}, <include> {part}") for part in _check_one(path, name)]


def _check_one(path: Path, where: str) -> list[str]:
    """Check a single file; returns the names of the files that it includes, which lie beside it."""
    parser, depth, included = expat.ParserCreate("UTF-8"), 0, []

    def start(tag: str, attributes: dict[str, str]) -> None:
        nonlocal depth
        depth += 1
        line = f"{where}, line {parser.CurrentLineNumber}"
        if depth > DEEPEST:
            raise InputError(f"{line}: elements are more than {DEEPEST} levels deep; that is no scene")
        if tag == "include" and "$" not in attributes.get("filename", "$"):
            if (path.parent / attributes["filename"]).is_file():  # what is elsewhere is found by Mitsuba alone
                included.append(attributes["filename"])
        if tag in _NUMERIC:
            for key in _VALUES:
                for item in _SEPARATOR.split(attributes.get(key, "")):
                    check_number(attributes.get("name", tag), item.rpartition(":")[2], line)

    def end(tag: str) -> None:
        nonlocal depth
        depth -= 1

    def refuse(*about: object) -> None:
        raise InputError(f"{where}: declares entities of its own, which scenes do not need; write out their text")

    parser.StartElementHandler, parser.EndElementHandler, parser.EntityDeclHandler = start, end, refuse
    written = untrusted.text(path, where)
    if match := re.match(r"\s*<\?xml[^>]*encoding=[\"']([^\"']+)", written):
        if match[1].lower() not in ("utf-8", "utf8", "us-ascii", "ascii"):
            raise InputError(f"{where}: is declared to be {match[1]}; save it as UTF-8, and declare that")
    try:
        parser.Parse(written.encode(), True)
    except expat.ExpatError as error:
        raise InputError(f"{where}: is no well-formed XML ({error})") from None
    return included


def check_number(name: str, text: str, where: str) -> None:
    """Raise InputError where a text is a number that no scene can have; other texts are left to Mitsuba."""
    try:
        value = float(text)
    except ValueError:
        return
    if not math.isfinite(value) or abs(value) > LARGEST:
        raise InputError(f"{where}: {name} is {text[:30]}; a finite number up to {LARGEST:g} is needed")
    if name in _SHARES and not 0 <= value <= 1:
        raise InputError(f"{where}: {name} is {text[:30]}; a roughness from 0 to 1 is needed")
    if name in _LENGTHS and value <= 0:
        raise InputError(f"{where}: {name} is {text[:30]}; a length above 0 is needed")
