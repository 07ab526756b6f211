"""Results of claims, kept between runs by the content of everything that decides them.

Tested in tests/validation/gates/test_run.py.
"""

from __future__ import annotations

import ast
import hashlib
import inspect
import json
import os
import sys
from collections.abc import Callable, Iterable, Iterator
from dataclasses import asdict
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import dasim
import recon
from dasim.base.cache import cache_dir
from dasim.scene.specification import SCENE_DIR
from validation.gates.claim import Evidence, plain_value
from validation.scores.figures import Figure

SCHEMA = 3
LIBRARIES = ("mitsuba", "drjit", "numpy", "scipy", "numba", "opencv-python-headless", "colour-science", "scikit-image")
HERE = Path(__file__).parents[1]


def key(run: Callable[..., Any], variant: str, seed: int = 0) -> str:
    """What a claim's result depends on, as a hash: its code, what that calls, data, libraries, variant, seed.

    Limits are not part of it: results are judged anew. Of ``validation`` counts what the claim's module imports, of
    ``dasim`` and ``recon`` everything.
    """
    own = inspect.getsourcefile(run)
    assert own is not None
    files = sorted(_imported(Path(own)))
    text = [run.__qualname__, str(seed), *(_digest(file) for file in files)]
    if any("recon" in _imports(file) for file in files):
        text.append(_folder_digest(Path(str(recon.__file__)).parent))
    return hashed([*text, *simulator(variant)])


def simulator(variant: str) -> list[str]:
    """What a rendering depends on beside its own parameters: the simulator's files, the scenes, libraries, variant."""
    folders = Path(str(dasim.__file__)).parent, SCENE_DIR
    libraries = (f"{name} {_version(name)}" for name in LIBRARIES)
    return [str(SCHEMA), variant, *libraries, *map(_folder_digest, folders)]


def hashed(text: Iterable[str]) -> str:
    """A name for content."""
    return hashlib.sha256("\n".join(text).encode()).hexdigest()[:24]


def load(name: str, seed: int, key: str) -> tuple[Evidence, float] | None:
    """A claim's evidence and the seconds that it took, or None where there is none for this key."""
    try:
        content = json.loads(_path(name, seed, key).read_text(encoding="utf-8"))
        figures = [Figure(**figure | {"value": _number(figure["value"])}) for figure in content["figures"]]
        pictures = [(caption, data) for caption, data in content["pictures"]]
        tables = [(caption, head, rows) for caption, head, rows in content["tables"]]
        pairs = [(caption, tuple(left), tuple(right)) for caption, left, right in content["pairs"]]
        return Evidence(figures, pictures, tables, pairs), float(content["seconds"])
    except (OSError, ValueError, KeyError, TypeError):
        return None  # none, or damaged: measure again


def save(name: str, seed: int, key: str, evidence: Evidence, seconds: float) -> None:
    """Keep a claim's evidence in place of what was kept under other keys. A cache that cannot be written is none."""
    content = asdict(evidence) | {"seconds": seconds}
    for figure in content["figures"]:
        figure["value"] = plain_value(figure["value"])
    path = _path(name, seed, key)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        partial = path.with_name(f".{path.name}.{os.getpid()}.partial")
        partial.write_text(json.dumps(content), encoding="utf-8")
        for old in path.parent.glob(f"{name}.{seed}.*.json"):
            old.unlink(missing_ok=True)
        partial.replace(path)
    except OSError as error:
        print(f"note: the result of {name} is not kept: {error}", file=sys.stderr)


def _path(name: str, seed: int, key: str) -> Path:
    return cache_dir() / "claims" / f"{name}.{seed}.{key}.json"


def _number(value: float | None) -> float:
    return float("nan") if value is None else float(value)


def _version(name: str) -> str:
    try:
        return version(name)
    except PackageNotFoundError:
        return "none"


def _imported(file: Path) -> set[Path]:
    """A module's file and those of the validation that it imports, directly or not."""
    found: set[Path] = set()
    waiting = [file]
    while waiting:
        here = waiting.pop()
        found.add(here)
        names = (name.split(".") for name in _imports(here))
        near = {
            HERE.joinpath(*parts[1:]).with_suffix(".py") for parts in names if parts[0] == "validation" and parts[1:]
        }
        waiting += [path for path in near - found if path.is_file()]
    return found


@cache
def _imports(file: Path) -> frozenset[str]:
    """Modules that a file imports anywhere, as packages and with what is taken from them."""
    found = set()
    for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module:
            found |= {node.module} | {f"{node.module}.{alias.name}" for alias in node.names}
    return frozenset(found | {name.split(".")[0] for name in found})


@cache
def _digest(file: Path) -> str:
    return f"{file.name} {hashlib.sha256(file.read_bytes()).hexdigest()}"


@cache
def _folder_digest(folder: Path) -> str:
    return "\n".join(f"{path.relative_to(folder)} {_digest(path)}" for path in sorted(_content(folder)))


def _content(folder: Path) -> Iterator[Path]:
    """Files below a folder that decide results: no caches, and not the command line."""
    for path in folder.rglob("*"):
        if path.is_file() and "__pycache__" not in path.parts and "cli" not in path.parts:
            yield path
