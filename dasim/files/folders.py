"""Result folders: written whole or not at all, and never over files that dasim did not write."""

from __future__ import annotations

import json
import os
from collections.abc import Iterator
from contextlib import contextmanager
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

from dasim.base import atomic
from dasim.base.errors import InputError


def software_versions() -> dict[str, str]:
    """Versions of the software that determines the pixels of a capture."""
    found = {}
    for name in ("dasim", "mitsuba", "drjit", "numpy", "scipy"):
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            found[name] = "unknown"
    return found


# --- folders -------------------------------------------------------------------------------------

# What each kind of result folder holds; the first is the file that marks it.
RESULT_FILES = {
    "capture": ("meta.json", "raw.png", "truth.exr"),
    "reconstruction": (
        *("meta.json", "recon.exr", "rgb.png", "sharp.png", "ir.png"),
        *("anaglyph.png", "stereo.png", "surface.ply", "surface.glb"),
    ),
    "EMVA 1288 measurement": ("meta.json", "descriptor.txt", "frames"),
    "calibration pictures": ("meta.json", "captures.csv", "pictures"),
    "demo": ("results.json", "report.html", "overview.jpg", "capture", "recon"),
    "validation": ("results.json", "report.html", "junit.xml"),
    "study": ("results.json", "report.html", "table.csv", "masks"),
}


@contextmanager
def new_folder(path: Path, kind: str) -> Iterator[Path]:
    """A temporary folder that becomes ``path`` when the block ends well, and vanishes when it does not.

    An earlier result of the same ``kind`` (of ``RESULT_FILES``) at ``path`` is replaced as a whole; a folder
    that holds anything else is refused with InputError.
    """
    check_output(path, kind)
    with atomic.new_folder(path) as folder:
        yield folder


def check_output(path: Path, kind: str) -> None:
    """InputError for an output folder that holds anything but an earlier result of this kind; called before work."""
    shown, path = path, Path(path).resolve()
    if path == Path.cwd() or path in Path.cwd().parents:
        raise InputError(f"output '{shown}': is the working folder or above it; name a new folder")
    if path.exists() and not path.is_dir():
        raise InputError(f"output {shown}: is a file, a folder is needed")
    if path.is_dir():
        entries = {entry.name for entry in path.iterdir()}
        files = RESULT_FILES[kind]
        if entries and not (entries <= set(files) and _marked(path / files[0])):
            strange = ", ".join(sorted(entries - set(files))[:3]) or files[0]
            raise InputError(
                f"output {shown}: exists and holds what dasim did not write for a {kind} ({strange}); "
                "choose another folder"
            )
    parent = path if path.is_dir() else path.parent
    while not parent.exists():
        parent = parent.parent
    if not parent.is_dir() or not os.access(parent, os.W_OK):
        raise InputError(f"output {shown}: {parent} is not a folder that can be written to")


def _marked(file: Path) -> bool:
    """Whether a result's JSON file is dasim's own: it names the version that wrote it."""
    try:
        return "dasim" in json.loads(file.read_text(encoding="utf-8"))["software"]
    except (OSError, ValueError, KeyError, TypeError):
        return False
