"""What a Python file refers to, from its syntax tree: nothing is imported.

Tested in tests/recon/calibration/test_cached.py.
"""

from __future__ import annotations

import ast
from dataclasses import dataclass
from functools import cache
from pathlib import Path


@dataclass(frozen=True)
class Reference:
    """A dotted name that a file refers to.

    ``level`` is the number of leading dots of a relative import. ``whole`` marks a name that is used as a value, so
    that any part of it may be used.
    """

    dotted: str
    level: int = 0
    whole: bool = False

    def absolute(self, module: str, *, package: bool) -> str:
        """The dotted name in a ``module``, which is a ``package`` where its file is ``__init__.py``."""
        if not self.level:
            return self.dotted
        parts = module.split(".")
        return ".".join([*parts[: len(parts) - self.level + package], self.dotted])


Names = dict[str, set[Reference]]


@dataclass(frozen=True)
class Content:
    """What a file refers to."""

    references: frozenset[Reference]
    path_parts: frozenset[str]  # names that are joined to paths: folder / "data"
    passed_on: Names | None  # names that a package takes from its modules; None where the file has code of its own


@cache
def content(source: bytes) -> Content:
    """What a file of this source code refers to.

    Imports inside functions count as well. Imports under ``if TYPE_CHECKING`` do not, because they are never executed.
    """
    tree = ast.parse(source)
    imports = _Imports()
    imports.visit(tree)
    uses = _Uses(imports.names)
    uses.visit(tree)
    passed_on = imports.names if all(map(_passes_on, tree.body)) else None
    return Content(frozenset(imports.references | uses.references), frozenset(uses.path_parts), passed_on)


def passed_on(init: Path, own: Content) -> Names | None:
    """Names that a package takes from its modules, also by the stub that ``lazy_loader`` reads."""
    stub = init.with_suffix(".pyi")
    if own.passed_on is None or not stub.is_file():
        return own.passed_on
    return own.passed_on | (content(stub.read_bytes()).passed_on or {})


def _passes_on(node: ast.stmt) -> bool:
    """Whether a statement is a docstring, an import, or lists the names of a package."""
    if isinstance(node, ast.Assign):
        names = {part.id for target in node.targets for part in ast.walk(target) if isinstance(part, ast.Name)}
        return bool(names & {"__all__", "__getattr__"})
    docstring = isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant)
    return docstring or isinstance(node, (ast.Import, ast.ImportFrom))


class _Imports(ast.NodeVisitor):
    """What a file imports, and the names that it gives to the imports."""

    def __init__(self) -> None:
        self.references: set[Reference] = set()
        self.names: Names = {}

    def visit_Import(self, node: ast.Import) -> None:
        for alias in node.names:
            self.references.add(Reference(alias.name))
            bound = alias.name if alias.asname else alias.name.partition(".")[0]
            self.names.setdefault(alias.asname or bound, set()).add(Reference(bound))

    def visit_ImportFrom(self, node: ast.ImportFrom) -> None:
        for alias in node.names:
            if alias.name == "*":
                self.references.add(Reference(node.module or "", node.level, whole=True))
                continue
            found = Reference(f"{node.module}.{alias.name}" if node.module else alias.name, node.level)
            self.references.add(found)
            self.names.setdefault(alias.asname or alias.name, set()).add(found)

    def visit_If(self, node: ast.If) -> None:
        skipped = _is_type_checking(node.test)
        for statement in node.orelse if skipped else (node.test, *node.body, *node.orelse):
            self.visit(statement)


class _Uses(ast.NodeVisitor):
    """How a file uses the names of its imports, and which names it joins to paths."""

    def __init__(self, names: Names) -> None:
        self.names = names
        self.references: set[Reference] = set()
        self.path_parts: set[str] = set()

    def visit_Attribute(self, node: ast.Attribute) -> None:
        chain: list[str] = []
        inner: ast.expr = node
        while isinstance(inner, ast.Attribute):
            chain.insert(0, inner.attr)
            inner = inner.value
        if not isinstance(inner, ast.Name):
            self.visit(inner)
            return
        for found in self.names.get(inner.id, ()):
            self.references.add(Reference(".".join([found.dotted, *chain]), found.level))

    def visit_Name(self, node: ast.Name) -> None:
        for found in self.names.get(node.id, ()):
            self.references.add(Reference(found.dotted, found.level, whole=True))

    def visit_BinOp(self, node: ast.BinOp) -> None:
        if isinstance(node.op, ast.Div):
            self._join(node.right)
        self.generic_visit(node)

    def visit_Call(self, node: ast.Call) -> None:
        called = node.func.attr if isinstance(node.func, ast.Attribute) else getattr(node.func, "id", None)
        if called in ("Path", "joinpath", "join", "with_name"):
            for argument in node.args:
                self._join(argument)
        if called in ("import_module", "__import__") and node.args and isinstance(node.args[0], ast.Constant):
            self.references.add(Reference(str(node.args[0].value), whole=True))
        self.generic_visit(node)

    def _join(self, part: ast.expr) -> None:
        if isinstance(part, ast.Constant) and isinstance(part.value, str):
            self.path_parts.update(part.value.split("/"))


def _is_type_checking(test: ast.expr) -> bool:
    return (test.attr if isinstance(test, ast.Attribute) else getattr(test, "id", None)) == "TYPE_CHECKING"
