"""Result folders, which are written atomically and never replace files that dasim did not write."""

from __future__ import annotations

import json
import re
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

from dasim.base import atomic
from dasim.base.errors import InputError


def software_versions() -> dict[str, str]:
    """Versions of the software that determines the pixels of a capture."""
    versions = {}
    for name in ("dasim", "mitsuba", "drjit", "numpy", "scipy"):
        try:
            versions[name] = version(name)
        except PackageNotFoundError:
            versions[name] = "unknown"
    return versions


# --- folders -------------------------------------------------------------------------------------

MOST_IN_SERIES = 1000  # captures

# Content of each kind of result folder; the first entry is the file that identifies it.
RESULT_FILES = {
    "capture": ("meta.json", "raw.png", "truth.exr"),
    "series of captures": ("series.json", *(f"{number:03d}" for number in range(MOST_IN_SERIES))),
    "reconstruction": (
        *("meta.json", "recon.exr", "rgb.png", "sharp.png", "ir.png", "depth.png", "confidence.png", "mosaic.png"),
        *("anaglyph.png", "stereo.png", "surface.ply", "surface.glb"),
    ),
    "EMVA 1288 measurement": ("meta.json", "descriptor.txt", "frames"),
    "calibration pictures": ("meta.json", "captures.csv", "pictures"),
    "demo": ("results.json", "report.html", "view.html", "overview.jpg", "capture", "recon"),
    "validation": ("results.json", "report.html", "junit.xml"),
    "study": ("results.json", "report.html", "table.csv", "masks"),
    "camera page": (
        *("results.json", "report.html", "levels.csv", "apertures.svg", "psf.svg", "psf.png", "mtf.svg"),
        *("responses.svg", "field.svg"),
    ),
}
# Folders inside of them: a kind of result folder, or a pattern of the names of the files.
INSIDE: dict[str, dict[str, str | re.Pattern[str]]] = {
    "series of captures": dict.fromkeys(RESULT_FILES["series of captures"][1:], "capture"),
    "demo": {"capture": "capture", "recon": "reconstruction"},
    "EMVA 1288 measurement": {"frames": re.compile(r"[bd]\d+\.png")},
    "calibration pictures": {"pictures": re.compile(r".+-\d+-\d+\.png")},
    "study": {"masks": re.compile(r"[\w.+-]+\.(png|svg|toml)")},
}


@contextmanager
def new_folder(path: Path, kind: str) -> Iterator[Path]:
    """Create a temporary folder that becomes ``path`` when the block ends, and is removed when the block raises.

    An earlier result of the same ``kind`` (a key of ``RESULT_FILES``) at ``path`` is replaced as a whole. Raises
    InputError if ``path`` holds anything else.
    """
    check_output(path, kind)
    with atomic.new_folder(path) as folder:
        yield folder


def check_output(path: Path, kind: str) -> None:
    """Raise InputError if an output folder holds anything but an earlier result of this kind, or cannot be written.

    It is called before the work starts, so that no result is lost.
    """
    name, path = path, Path(path).resolve()
    if path == Path.cwd() or path in Path.cwd().parents:
        raise InputError(f"output '{name}': is the working folder or above it; name a new folder")
    if path.exists() and not path.is_dir():
        raise InputError(f"output {name}: is a file; it must be a folder")
    if path.is_dir():
        foreign, first = _foreign(path, kind), RESULT_FILES[kind][0]
        if foreign or (any(path.iterdir()) and not _is_own(path / first)):
            others = ", ".join(foreign[:3]) or first
            raise InputError(
                f"output {name}: exists and holds files that dasim did not write for a {kind} ({others}); "
                "choose another folder"
            )
    _check_writable(path if path.is_dir() else path.parent, name)


def _foreign(folder: Path, kind: str) -> list[str]:
    """Names of what dasim did not write in a result folder and the folders inside of it, in order."""
    foreign = []
    for entry in sorted(folder.iterdir()):
        inside = INSIDE.get(kind, {}).get(entry.name)
        if entry.name not in RESULT_FILES[kind] or entry.is_dir() != (inside is not None):
            foreign.append(entry.name)
        elif isinstance(inside, str):
            foreign += [f"{entry.name}/{name}" for name in _foreign(entry, inside)]
        elif inside is not None:
            foreign += [
                f"{entry.name}/{each.name}" for each in sorted(entry.iterdir()) if not inside.fullmatch(each.name)
            ]
    return foreign


def check_output_file(path: Path) -> None:
    """Raise InputError if an output file is a folder, or cannot be written; called before the work starts."""
    if path.is_dir():
        raise InputError(f"output {path}: is a folder; name a file")
    _check_writable(path.resolve().parent, path)


def _check_writable(folder: Path, name: Path) -> None:
    """Raise InputError if the output ``name`` cannot be created in a folder, which may have to be made."""
    while not folder.exists():
        folder = folder.parent
    try:
        tempfile.TemporaryDirectory(dir=folder).cleanup()
    except OSError as error:  # permissions alone do not decide: read-only and virtual file systems
        raise InputError(f"output {name}: {folder} is not a folder that can be written to") from error


def _is_own(file: Path) -> bool:
    """Whether dasim wrote a JSON file, which then states the version of dasim."""
    try:
        return "dasim" in json.loads(file.read_text(encoding="utf-8"))["software"]
    except (OSError, ValueError, KeyError, TypeError):
        return False
