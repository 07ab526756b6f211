"""The lock files have the versions of constraints.txt, hashes for all, and everything that pyproject.toml asks for."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PINNED = re.compile(r"^([\w.-]+)==([^\s;]+)[^\n]*\\\n((?: +--hash=sha256:[0-9a-f]{64}(?: \\)?\n)+)", re.MULTILINE)
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
EXTRAS = {"dasim": (), "test": ("test",), "docs": ("docs",), "lens": ("lens",)}


def plain(name: str) -> str:
    """A package's name as PEP 503 has it."""
    return re.sub(r"[-_.]+", "-", name).lower()


def locked(name: str) -> dict[str, str]:
    """Versions of the packages of a lock file; each has hashes."""
    text = (ROOT / ".ci" / "locks" / f"{name}.txt").read_text(encoding="utf-8")
    pinned = {plain(found[1]): found[2] for found in PINNED.finditer(text)}
    assert len(pinned) == len(re.findall(r"^\S+==", text, re.MULTILINE)) > 5, "an entry without hashes"
    return pinned


def wanted(extras: tuple[str, ...]) -> set[str]:
    """Packages that pyproject.toml asks for, through extras that name extras, too."""
    names = set()
    lines = [*PROJECT["dependencies"], *(line for extra in extras for line in PROJECT["optional-dependencies"][extra])]
    for line in lines:
        name = plain(re.match(r"[\w.-]+", line)[0])
        inner = re.match(r"dasim\[([\w,]+)\]", line)
        names |= wanted(tuple(inner[1].split(","))) if inner else {name}
    return names


@pytest.mark.parametrize("name", EXTRAS)
def test_lock_files_are_those_of_the_dependencies(name):
    pinned = locked(name)
    assert wanted(EXTRAS[name]) <= set(pinned)
    lines = (ROOT / "constraints.txt").read_text(encoding="utf-8").splitlines()
    known = {plain(name): version for name, _, version in (line.partition("==") for line in lines) if version}
    # what other systems need besides is not in the list of versions, which was made on Linux
    assert {name: version for name, version in pinned.items() if known.get(name, version) != version} == {}
    assert len(set(pinned) - set(known)) <= 2


@pytest.mark.parametrize("name", ["build", "audit"])
def test_lock_files_of_tools_have_hashes(name):
    assert locked(name)
