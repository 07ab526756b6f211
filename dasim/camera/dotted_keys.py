"""A camera with values changed at keys that are joined by dots, such as ``lens.f_number``.

Tested in tests/dasim/camera/test_specification.py, tests/dasim/dataset/test_specification.py and
tests/dasim/dataset/test_draws.py.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from dasim.base.errors import InputError
from dasim.base.suggestions import did_you_mean
from dasim.base.toml import parse
from dasim.camera.specification import Camera, as_camera

Scalar = bool | int | float | str


def with_values(camera: Camera | str | Path, changes: Mapping[str, Scalar]) -> Camera:
    """The camera with other values at some of its keys.

    >>> dasim.with_values("da-mobile", {"lens.f_number": 2.0, "stops.hole.radius_ratio": 0.3})

    Args:
        camera: a Camera, a bundled name or a path
        changes: new values by key: the keys of a camera's file (see the reference of cameras) joined by dots; an entry
            of a list is named by its ``name`` or by its index from 0

    Raises:
        InputError: a key does not exist, or a value is not allowed.
    """
    camera = as_camera(camera)
    if not changes:
        return camera
    data = camera.model_dump(mode="json")
    for key, value in changes.items():
        place, parts = data, key.split(".")
        for depth, part in enumerate(parts):
            entry = _entry(place, part)
            if entry is None:
                names = _names(place)
                raise InputError(
                    f"'{key}' does not exist in camera '{camera.name}'; {'.'.join(parts[:depth]) or 'it'} has "
                    f"{', '.join(names)}{did_you_mean(part, names)}"
                )
            if depth == len(parts) - 1:
                place[entry] = value
            else:
                place = place[entry]
    return parse(Camera, data, ", ".join(f"{key} = {value!r}" for key, value in changes.items()))


def _entry(place: Any, part: str) -> Any:
    """Key or index of an entry of a table or list by its key, index or name; None where there is none."""
    if isinstance(place, dict):
        return part if part in place else None
    if isinstance(place, list):
        if part.isdigit() and int(part) < len(place):
            return int(part)
        matches = [index for index, item in enumerate(place) if isinstance(item, dict) and item.get("name") == part]
        return matches[0] if matches else None
    return None


def _names(place: Any) -> list[str]:
    """Keys of a table, or names (or else indices) of the entries of a list, for a message."""
    if isinstance(place, dict):
        return list(place)
    if isinstance(place, list):
        return [
            str(item.get("name", index)) if isinstance(item, dict) else str(index) for index, item in enumerate(place)
        ]
    return ["no parts"]
