"""Examples on disk: one file each, made by any number of processes.

Tested in tests/validation/training/test_level_examples.py.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dasim.base import atomic
from dasim.typing import Progress
from validation.training.captures import Setup, setups

PARTS = 2  # of the examples of a family

Example = Callable[[str, int, list[Setup], Path], dict[str, NDArray[Any]]]


def make(
    folder: Path,
    example: Example,
    examples: Mapping[str, int],
    part: int,
    count: int | None = None,
    progress: Progress = lambda stage, share: None,
) -> None:
    """Write one part of the examples of each family, to ``FAMILY-NUMBER.npz``; those that exist are left as they are.

    An example depends on family and number alone, so that several processes may share the work. ``examples`` are those
    of each family per part, which ``count`` limits. Arrays of floats are written in half precision.
    """
    folder.mkdir(parents=True, exist_ok=True)
    cameras = setups()
    numbers = [
        (family, part + PARTS * index)
        for family, of_family in examples.items()
        for index in range(of_family if count is None else count)
    ]
    for done, (family, number) in enumerate(numbers):
        file = folder / f"{family}-{number}.npz"
        if not file.exists():
            made: dict[str, Any] = {
                name: _halved(part) for name, part in example(family, number, cameras, folder).items()
            }
            with atomic.writing(file) as stream:
                np.savez(stream, **made)
        progress("examples", (done + 1) / len(numbers))


def families(folder: Path, names: Iterable[str]) -> list[list[Path]]:
    """The examples of each family in a folder, in order of their numbers."""
    return [sorted(folder.glob(f"{name}-*[0-9].npz"), key=lambda file: int(file.stem.split("-")[1])) for name in names]


def _halved(array: NDArray[Any]) -> NDArray[Any]:
    return array.astype(np.float16) if array.ndim > 1 and array.dtype.kind == "f" else array
