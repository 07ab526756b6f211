"""Meshes and pictures of the user for random scenes: files, folders and patterns, read and measured.

Tested in tests/dasim/random_scenes/test_specification.py.
"""

from __future__ import annotations

import glob
from collections.abc import Iterable
from functools import lru_cache
from pathlib import Path
from typing import NamedTuple

import numpy as np

from dasim.base.errors import InputError
from dasim.materials import photographs
from dasim.scene import mesh_merging, meshes

MESH_SUFFIXES = (".obj", ".ply", ".glb", ".stl", ".off")
PICTURE_SUFFIXES = (".png", ".jpg", ".jpeg")
MOST_FILES = 100_000  # of a list: a pattern such as "/**" is a mistake

File = tuple[str, int, int]  # name relative to the specification's folder, modification time (ns), size (bytes)


class OwnMesh(NamedTuple):
    """A mesh file of the user: its bounding box in its own unit, and whether it has texture coordinates and colours."""

    name: str  # relative to the folder of the specification
    low: tuple[float, float, float]
    high: tuple[float, float, float]
    has_uv: bool
    has_colours: bool


class OwnMeshes(NamedTuple):
    """The user's meshes and how they are used.

    Attributes:
        files: the meshes
        share: probability 0..1 that an object is one of them
        up: axis of the files that points up, "y" or "z"
        near_infrared: rule for meshes with colours of their own, or "drawn" for a random one
    """

    files: tuple[OwnMesh, ...]
    share: float
    up: str
    near_infrared: str


def found(folder: Path, places: Iterable[str], suffixes: tuple[str, ...], key: str) -> tuple[File, ...]:
    """Files with one of ``suffixes`` that the paths and patterns ``places`` match, sorted and without duplicates.

    Each of ``places`` is a file, a folder (all files in it), or a pattern with ``*``, ``?``, ``[...]`` or ``**``,
    relative to ``folder``. ``key`` is the name of the list, for messages. Raises InputError for an entry that does not
    exist or contains no such file.
    """
    names: set[str] = set()
    for place in places:
        path = folder / place
        if path.is_dir():
            here = [str(Path(place) / entry.name) for entry in path.iterdir()]
        elif path.is_file():
            if path.suffix.lower() not in suffixes:
                raise InputError(f"{key} '{path}': is none of {', '.join(suffixes)}")
            here = [place]
        elif glob.has_magic(place):
            here = glob.glob(place, root_dir=folder, recursive=True)
        else:
            raise InputError(f"{key} '{path}': no such file or folder")
        here = [name for name in here if Path(name).suffix.lower() in suffixes and (folder / name).is_file()]
        if not here:
            raise InputError(f"{key} '{path}': holds none of {', '.join(suffixes)}")
        names.update(here)
    if len(names) > MOST_FILES:
        raise InputError(f"{key}: {len(names)} files; at most {MOST_FILES} are allowed")
    stats = {name: (folder / name).stat() for name in sorted(names)}
    return tuple((name, stat.st_mtime_ns, stat.st_size) for name, stat in stats.items())


@lru_cache(maxsize=4)
def measured_meshes(folder: Path, files: tuple[File, ...]) -> tuple[OwnMesh, ...]:
    """Read and measure meshes; InputError lists all that are broken.

    The result is cached until one of the ``files`` changes.
    """
    results, problems = [], []
    for name, _, _ in files:
        try:
            results.append(_measured(folder, name))
        except InputError as error:
            problems.append(str(error))
    if problems:
        raise InputError("; ".join(problems))
    return tuple(results)


def _measured(folder: Path, name: str) -> OwnMesh:
    where = f"mesh {folder / name}"
    parts = meshes.read(folder / name, 1.0, where)
    if mesh_merging.colour_kinds(parts):
        mesh_merging.merge_with_colours(parts, where)  # raises InputError for missing or too many colours
    low = np.min([part.vertices.min(axis=0) for part in parts], axis=0)
    high = np.max([part.vertices.max(axis=0) for part in parts], axis=0)
    if not (high - low).max() > 0:
        raise InputError(f"{where}: all its vertices coincide")
    corners = tuple(tuple(float(value) for value in corner) for corner in (low, high))
    has_uv = all(part.uv is not None for part in parts)
    return OwnMesh(name, corners[0], corners[1], has_uv, bool(mesh_merging.colour_kinds(parts)))  # type: ignore[arg-type]


@lru_cache(maxsize=4)
def check_pictures(folder: Path, files: tuple[File, ...]) -> None:
    """Raise InputError with all pictures that cannot be read; cached as in :func:`measured_meshes`."""
    problems = []
    for name, _, _ in files:
        try:
            photographs.linear_rgb(name, folder)
        except InputError as error:
            problems.append(str(error))
    if problems:
        raise InputError("; ".join(problems))
