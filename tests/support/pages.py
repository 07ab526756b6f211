"""The pages of the documentation: their blocks of code, and the scripts that make some of them."""

from __future__ import annotations

import importlib.util
import re
from pathlib import Path
from types import ModuleType
from typing import NamedTuple

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"
FENCE = re.compile(r"(?:<!-- (run(?: slow)?) -->\n)?^( *)```(\w*)\n(.*?)^\2```", flags=re.MULTILINE | re.DOTALL)

INCLUDED = re.compile(r'^--8<-- "(.+)"\n', flags=re.MULTILINE)


class Block(NamedTuple):
    """A block of code: its mark (run, run slow or none), its language and its text."""

    mark: str
    language: str
    text: str


def pages() -> list[Path]:
    """README.md and all pages that are kept in the repository."""
    return [ROOT / "README.md", *sorted(DOCS.rglob("*.md"))]


def blocks(page: Path) -> list[Block]:
    """The blocks of a page in order, with the files that they include."""
    text = INCLUDED.sub(lambda m: example(m[1]).read_text(encoding="utf-8"), page.read_text(encoding="utf-8"))
    return [Block(m[1] or "", m[3], re.sub(f"(?m)^{m[2]}", "", m[4])) for m in FENCE.finditer(text)]


def example(name: str) -> Path:
    """A file of the examples that a page includes."""
    return next(path for path in (ROOT / "examples" / name, ROOT / "examples" / "ci" / name) if path.is_file())


def script(name: str) -> ModuleType:
    """A script of docs/_build as a module."""
    spec = importlib.util.spec_from_file_location(f"docs_{name}", DOCS / "_build" / f"{name}.py")
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module
