"""What is scored on a dataset: depth methods, folders of depth maps, and the best constant map.

Tested in tests/validation/test_dataset_scores.py.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

from dasim.base.errors import InputError
from validation.methods import NAME, NamedMethod, identity, named
from validation.scores.depth_files import SUFFIXES, read_depth

CONSTANT = "constant"


@dataclass(frozen=True)
class MapFolder:
    """A folder of depth maps that another program wrote: one file per sample, KEY.npy, KEY.exr or KEY.png."""

    name: str
    folder: Path
    metres_per_unit: float | None = None

    def file(self, key: str) -> Path | None:
        """The map of a sample; None where there is none. Raises InputError for two maps of one sample."""
        files = [path for suffix in SUFFIXES if (path := self.folder / f"{key}{suffix}").is_file()]
        if len(files) > 1:
            raise InputError(
                f"{self.folder}: has {' and '.join(file.name for file in files)}; leave one map per sample"
            )
        return files[0] if files else None


@dataclass(frozen=True)
class Constant:
    """The constant map with the least RMSE in dioptres on each sample, which takes one number of its truth."""

    name: str = CONSTANT


Entrant = NamedMethod | MapFolder | Constant


def entrants(texts: Sequence[str], metres_per_unit: float | None = None) -> tuple[Entrant, ...]:
    """The constant map, and the entrants of a user's list: methods, folders of depth maps, or NAME=FOLDER.

    ``metres_per_unit`` is for the folders, and required for PNG files. Raises InputError for a name that is unknown or
    occurs twice.
    """
    folders = {text: folder for text in texts if (folder := _folder(text, metres_per_unit)) is not None}
    if metres_per_unit is not None and not folders:
        raise InputError("--scale: applies to folders of depth maps; --method names none")
    try:
        methods = iter(named([text for text in texts if text not in folders]))
    except InputError as error:
        if "is unknown" not in str(error):
            raise
        raise InputError(f"{error}, or a folder of depth maps KEY.npy, KEY.exr or KEY.png") from None
    found: list[Entrant] = [Constant()]
    for text in texts:
        one = folders[text] if text in folders else next(methods)
        if one.name in (other.name for other in found):
            why = "the best constant map has it" if one.name == CONSTANT else "two methods have it"
            raise InputError(f"method '{text}': the name '{one.name}' is taken, {why}; give another as NAME={text}")
        found.append(one)
    return tuple(found)


def _folder(text: str, metres_per_unit: float | None) -> MapFolder | None:
    """The folder of depth maps that a text names; None where it is no folder."""
    if Path(text).is_dir():
        return MapFolder(Path(text).resolve().name, Path(text), metres_per_unit)
    name, equals, path = text.partition("=")
    if not equals or not Path(path).is_dir():
        return None
    if not NAME.fullmatch(name):
        raise InputError(
            f"method '{text}': '{name}' is not a valid name; allowed are letters, digits, - and _, a letter first"
        )
    return MapFolder(name, Path(path), metres_per_unit)


def check_maps(everyone: Iterable[Entrant], keys: Sequence[str]) -> None:
    """Raise InputError unless each folder has a map of every sample and, with PNG files, a scale."""
    for one in everyone:
        if not isinstance(one, MapFolder):
            continue
        files = {key: one.file(key) for key in keys}
        missing = [key for key, file in files.items() if file is None]
        if missing:
            raise InputError(
                f"{one.folder}: lacks the depth maps of {len(missing)} of {len(keys)} samples, such as "
                f"{missing[0]}.npy; allowed are {', '.join(SUFFIXES)}"
            )
        if one.metres_per_unit is None and any(file is not None and file.suffix == ".png" for file in files.values()):
            read_depth(next(file for file in files.values() if file is not None and file.suffix == ".png"))


def result_identity(one: Entrant, key: str) -> list[str]:
    """What the result of an entrant on a sample depends on, besides the sample and the code of the project."""
    if isinstance(one, MapFolder):
        file = one.file(key)
        digest = "none" if file is None else hashlib.sha256(file.read_bytes()).hexdigest()
        return [one.name, digest, str(one.metres_per_unit)]
    return identity(one, "none") if isinstance(one, NamedMethod) else [one.name]
