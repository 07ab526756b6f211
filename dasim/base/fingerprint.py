"""Fingerprint of everything that determines a cached result: code, bundled data, library versions and variant.

The code is found by following imports from the functions that compute the result. A name taken from a package
(``dasim.simulate``) is followed to the module that defines it, so that a result does not depend on the other names
of the package. Modules count as a whole: any change in a file changes the fingerprint.

Tested in tests/recon/calibration/test_cached.py.
"""

from __future__ import annotations

import functools
import hashlib
import inspect
import sys
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass
from functools import cache
from importlib import metadata
from pathlib import Path
from typing import Any

from dasim.base import references
from dasim.base.errors import InputError
from dasim.base.references import Content, Reference

PACKAGES = ("dasim", "recon", "validation")
ROOT = Path(__file__).resolve().parents[2]  # folder of the packages
# Folders of bundled data below the root, of which the first that exists counts: a wheel has the scenes in dasim.
DATA_FOLDERS = {"cameras": ("dasim/cameras",), "data": ("dasim/data",), "scenes": ("dasim/scenes", "scenes")}
RENDERERS = frozenset({"mitsuba", "drjit"})  # libraries whose results depend on the variant
DISTRIBUTIONS = {
    **{"cv2": "opencv-python-headless", "skimage": "scikit-image", "colour": "colour-science"},
    **{"PIL": "pillow", "grpc": "grpcio"},
}
DIGITS = 24
LONGEST_PATH = 1000  # characters; longer text cannot be the name of a file

Source = Callable[..., Any] | str | Path
"""Code to start from: a function, a class, the dotted name of a module, or a Python file outside of the packages."""


@dataclass(frozen=True)
class Dependencies:
    """Files and libraries that a result depends on."""

    files: dict[Path, str]  # path, and a name that does not depend on the place of installation
    libraries: frozenset[str]  # top-level names of imported packages outside of the project and standard library

    @property
    def renders(self) -> bool:
        """Whether the code can render."""
        return bool(self.libraries & RENDERERS)


def fingerprint(
    *sources: Source, variant: str | None = None, values: Iterable[str] = (), excluding: Collection[str] = ()
) -> str:
    """Hash of the content of everything that determines the results of ``sources``.

    Args:
        sources: functions, modules or files that compute the result.
        variant: Mitsuba variant; required where the code can render, ignored otherwise.
        values: parameters of the result as text.
        excluding: names of ``DATA_FOLDERS`` to omit, because ``values`` already contain all data from them that the
            result uses. The values of a PSF bank, for example, contain its camera; other bundled cameras do not matter.
    """
    needs = dependencies(*sources, excluding=excluding)
    text = [_name(source) for source in sources]
    text += sorted(f"{name} {_digest(path)}" for path, name in needs.files.items())
    text += [f"{name} {library_version(name)}" for name in sorted(needs.libraries)]
    if needs.renders:
        if variant is None:
            raise ValueError(f"{', '.join(text[: len(sources)])} can render: the result depends on the variant")
        text.append(variant)
    return text_hash([*text, *values])


def dependencies(*sources: Source, excluding: Collection[str] = ()) -> Dependencies:
    """Files and libraries that the results of ``sources`` depend on; parameters as in :func:`fingerprint`."""
    waiting = [_start(source) for source in sources]
    modules: dict[str, Path] = {}
    libraries: set[str] = set()
    while waiting:
        name, path = waiting.pop()
        if name in modules:
            continue
        modules[name] = path
        for reference in _content(path).references:
            targets, library = _resolve(reference, name, path)
            waiting += targets
            libraries |= library
    files = [*modules.values(), *(data for path in modules.values() for data in _data(path, excluding))]
    return Dependencies({path: _file_name(path) for path in files}, frozenset(libraries))


def text_hash(text: Iterable[str]) -> str:
    """Hash of a sequence of texts, [``DIGITS``] hexadecimal digits; it depends on where each text ends."""
    digest = hashlib.sha256()
    for part in text:
        data = part.encode()
        digest.update(f"{len(data)}:".encode() + data)
    return digest.hexdigest()[:DIGITS]


def named_files(data: Any, folder: Path) -> list[str]:
    """SHA-256 of the files below ``folder`` whose names occur anywhere in plain data, such as a scene's meshes."""
    if isinstance(data, dict):
        return [digest for value in data.values() for digest in named_files(value, folder)]
    if isinstance(data, (list, tuple)):
        return [digest for value in data for digest in named_files(value, folder)]
    if not isinstance(data, str) or not data or len(data) > LONGEST_PATH or "\0" in data:
        return []
    path = folder / data
    return [hashlib.sha256(path.read_bytes()).hexdigest()] if path.is_file() else []


@cache
def library_version(name: str) -> str:
    """Version of the distribution that provides a top-level package; "none" where it is not installed."""
    try:
        return metadata.version(DISTRIBUTIONS.get(name, name))
    except metadata.PackageNotFoundError:
        pass
    providers = _distributions().get(name, [])
    return ", ".join(f"{one} {metadata.version(one)}" for one in sorted(set(providers))) or "none"


@cache
def _distributions() -> Mapping[str, list[str]]:
    return metadata.packages_distributions()


def forget() -> None:
    """Clear the caches, so that the next call rereads all files; a process otherwise reads each file only once."""
    for function in (_content, _digest, _module_below, _exports):
        function.cache_clear()


# --- sources -------------------------------------------------------------------------------------


def _unwrap(source: Source) -> Source:
    """The function inside of decorators and ``functools.partial``; other sources as they are."""
    while isinstance(source, functools.partial):
        source = source.func
    return inspect.unwrap(source) if callable(source) else source


def _name(source: Source) -> str:
    """Name of a source that does not depend on the place of installation."""
    source = _unwrap(source)
    if isinstance(source, Path):
        return source.name
    if isinstance(source, str):
        return source
    module = source.__module__ if _is_own(source.__module__) else Path(inspect.getfile(source)).name
    return f"{module}:{source.__qualname__}"


def _start(source: Source) -> tuple[str, Path]:
    """Name and file of a source's module; the name is the path where the file lies outside of the packages."""
    source = _unwrap(source)
    if callable(source):
        if _is_own(source.__module__):
            source = source.__module__
        else:
            try:
                source = Path(inspect.getfile(source)).resolve(strict=True)
            except (TypeError, OSError):
                raise InputError(f"{source}: has no source file, so that its results cannot be cached") from None
    if isinstance(source, Path):
        return str(source.resolve()), source.resolve()
    path = _module(source)
    if path is None:
        raise ValueError(f"module {source} is not in {ROOT}")
    return source, path


def _is_own(module: str) -> bool:
    return module.partition(".")[0] in PACKAGES


# --- from references to files --------------------------------------------------------------------


def _resolve(reference: Reference, name: str, path: Path) -> tuple[list[tuple[str, Path]], set[str]]:
    """Modules (name, file) and libraries that a reference in the module ``name`` with the file ``path`` leads to."""
    foreign = name == str(path)
    dotted = reference.dotted if foreign else reference.absolute(name, package=path.name == "__init__.py")
    top = dotted.partition(".")[0]
    if _is_own(dotted) and not (foreign and reference.level):
        return list(_project(dotted, whole=reference.whole)), set()
    local = _beside(path, dotted, reference.level) if foreign else []
    library = not local and not reference.level and top not in sys.stdlib_module_names
    return [(str(file), file) for file in local], {top} if library else set()


def _project(dotted: str, *, whole: bool) -> Iterator[tuple[str, Path]]:
    """Modules (name, file) that ``package.module.name`` leads to; with ``whole``, all that a package re-exports."""
    parts = dotted.split(".")
    for end in range(1, len(parts) + 1):
        name, rest = ".".join(parts[:end]), parts[end:]
        path = _module(name)
        if path is None:
            return
        if path.name != "__init__.py":
            yield name, path
            return
        exports = _exports(path)
        if exports is None:  # a package with code of its own
            yield name, path
            exports = {}
        if rest and (rest[0] not in exports or _module(f"{name}.{rest[0]}") is not None):
            continue
        groups = [exports[rest[0]]] if rest else list(exports.values()) if whole else []
        for reference in (one for group in groups for one in group):
            yield from _project(".".join([reference.absolute(name, package=True), *rest[1:]]), whole=False)
        return


def _module(name: str) -> Path | None:
    """File of a module or package of the project by its dotted name; None where there is none."""
    return _module_below(ROOT, name) if _is_own(name) else None


@cache
def _module_below(folder: Path, name: str) -> Path | None:
    base = folder.joinpath(*name.split("."))
    for path in (base.with_name(f"{base.name}.py"), base / "__init__.py"):
        if path.is_file():
            return path
    return None


def _beside(path: Path, dotted: str, level: int) -> list[Path]:
    """Files that a file outside the project's packages imports from its own folder or its own package.

    Installed packages share one folder (``site-packages``), but all except the file's own package count as libraries.
    """
    top = path.parent
    while (top / "__init__.py").is_file():
        top = top.parent
    folders = [path.parents[level - 1]] if level else list(dict.fromkeys((path.parent, top)))
    parts = dotted.split(".")
    if {"site-packages", "dist-packages"} & set(top.parts) and not level:
        folders = [top] if path.relative_to(top).parts[0] == parts[0] else []
    for folder in folders:
        files = [_module_below(folder, ".".join(parts[:end])) for end in range(1, len(parts) + 1)]
        present = [file.resolve() for file in files if file is not None]
        if present:
            return present
    return []


def _data(path: Path, excluding: Collection[str]) -> Iterator[Path]:
    """Data of a module: files beside it that it names, such as weights of networks; and bundled data that it joins to
    paths, the files that it names or all files of a folder that it names.
    """
    parts = _content(path).path_parts
    beside = (path.with_name(name) for name in sorted(_content(path).file_names))
    yield from (file for file in beside if file.suffix != ".py" and file.is_file())
    for name, places in DATA_FOLDERS.items():
        folder = next((ROOT / place for place in places if (ROOT / place).is_dir()), None)
        if name in excluding or name not in parts or folder is None:
            continue
        files = sorted(file for file in folder.rglob("*") if file.is_file())
        yield from [file for file in files if file.name in parts] or files


def _file_name(path: Path) -> str:
    """Name of a file that is the same wherever the packages are installed."""
    if not path.is_relative_to(ROOT):
        return f"beside/{path.name}"
    name = path.relative_to(ROOT).as_posix()
    return name.removeprefix("dasim/") if name.startswith("dasim/scenes/") else name


@cache
def _content(path: Path) -> Content:
    return references.content(path.read_bytes())


@cache
def _exports(path: Path) -> references.Names | None:
    return references.exports(path, _content(path))


@cache
def _digest(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()
