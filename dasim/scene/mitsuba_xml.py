"""Checks of a Mitsuba XML file before Mitsuba's own parser sees it, which ends the process on some malformed files.

Tested in tests/dasim/base/test_untrusted.py.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from pathlib import Path
from xml.parsers import expat

from dasim.base import untrusted
from dasim.base.errors import InputError

DEEPEST = 64  # levels of elements; scenes have less than ten
MOST_FILES = 1000  # that include each other
_SHARES = {"alpha", "alpha_u", "alpha_v", "roughness"}  # numbers from 0 to 1
_LENGTHS = {"radius"}  # above 0


def check(file: Path, where: str, define: Mapping[str, str]) -> None:
    """Raise InputError where an XML file, or one that it includes, is malformed for Mitsuba.

    It must be UTF-8, without entities of its own and at most ``DEEPEST`` elements deep; radii must be above 0, and
    roughnesses from 0 to 1. ``define`` has the values of its ``$parameters``. What else is wrong, such as a
    transformation that is not finite, is found when the scene is loaded.
    """
    waiting, seen, values, folders = [(file, where)], set(), dict(define), [file.parent, Path(".")]
    while waiting:
        path, name = waiting.pop()
        if path.resolve() in seen:
            continue
        seen.add(path.resolve())
        if len(seen) > MOST_FILES:
            raise InputError(f"{where}: includes more than {MOST_FILES} files")
        for part in _check_one(path, name, values, folders):
            waiting += [(found, f"{name}, <include> {part}") for found in _candidates(part, [path.parent, *folders])]


def _candidates(name: str, folders: list[Path]) -> list[Path]:
    """Files that a name may refer to; Mitsuba uses the first one, and itself rejects folders and missing files."""
    found = [folder / name for folder in folders]
    return [path for path in found if path.exists() and not path.is_dir()]


def _check_one(path: Path, where: str, values: dict[str, str], folders: list[Path]) -> list[str]:
    """Check a single file; returns the names of the files that it includes.

    Parameters and search folders that the file declares are added to ``values`` and ``folders``.
    """
    parser, depth, included = expat.ParserCreate("UTF-8"), 0, []

    def filled(text: str) -> str:
        return re.sub(r"\$(\w+)", lambda found: str(values.get(found[1], found[0])), text)

    def start(tag: str, attributes: dict[str, str]) -> None:
        nonlocal depth
        depth += 1
        line = f"{where}, line {parser.CurrentLineNumber}"
        if depth > DEEPEST:
            raise InputError(f"{line}: elements are more than {DEEPEST} levels deep; that is not a scene")
        if tag == "default":
            values.setdefault(attributes.get("name", ""), filled(attributes.get("value", "")))
        if tag == "path":
            added = [folder / filled(attributes.get("value", "")) for folder in (path.parent, *folders)]
            folders.extend([folder for folder in dict.fromkeys(added) if folder.is_dir() and folder not in folders])
            if len(folders) > MOST_FILES:
                raise InputError(f"{line}: has more <path> elements than any scene")
        if tag == "include":
            included.append(filled(attributes.get("filename", "")))
        if tag == "spectrum" and "filename" in attributes:
            for table in _candidates(filled(attributes["filename"]), [path.parent, *folders]):
                untrusted.check_file(table, f"{line}: spectrum {attributes['filename']}")
        if tag == "float":
            _check_number(attributes.get("name", ""), filled(attributes.get("value", "")), line)

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
        raise InputError(f"{where}: does not load, because it is not well-formed XML ({error})") from None
    return included


def _check_number(name: str, text: str, where: str) -> None:
    """Raise InputError for a radius or roughness out of range; Mitsuba itself rejects text that is not a number."""
    try:
        value = float(text)
    except ValueError:
        return
    if name in _SHARES and not 0 <= value <= 1:
        raise InputError(f"{where}: {name} is {text[:30]}; it must be a roughness from 0 to 1")
    if name in _LENGTHS and not 0 < value < math.inf:
        raise InputError(f"{where}: {name} is {text[:30]}; it must be a finite length above 0")
