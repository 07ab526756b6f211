"""Names that a Python file refers to, from its syntax tree, without importing it.

Tested in tests/recon/calibration/test_cached.py.
"""

from __future__ import annotations

import ast
import re
from dataclasses import dataclass
from functools import cache
from pathlib import Path

FILE_NAME = re.compile(r"[\w-]{1,100}(\.[\w-]{1,20}){1,3}")


@dataclass(frozen=True)
class Reference:
    """A dotted name that a file refers to.

    ``level`` is the number of leading dots of a relative import. ``whole`` marks a name that is used as a value, so
    that all of its attributes may be used.
    """

    dotted: str
    level: int = 0
    whole: bool = False

    def absolute(self, module: str, *, package: bool) -> str:
        """Absolute dotted name of a reference in ``module``; ``package`` where its file is ``__init__.py``."""
        if not self.level:
            return self.dotted
        parts = module.split(".")
        return ".".join([*parts[: len(parts) - self.level + package], self.dotted])


Names = dict[str, set[Reference]]


@dataclass(frozen=True)
class Content:
    """Names that a file refers to."""

    references: frozenset[Reference]
    path_parts: frozenset[str]  # text that is joined to paths, as in folder / "data"
    file_names: frozenset[str]  # text that may be the name of a file
    exports: Names | None  # names that a package re-exports from its modules; None where the file has its own code


@cache
def content(source: bytes) -> Content:
    """Names that a file of this source code refers to.

    Imports inside functions are included. Imports under ``if TYPE_CHECKING`` are not, because they are never executed.
    """
    tree = ast.parse(source)
    imports = _Imports()
    imports.visit(tree)
    uses = _Uses(imports.names)
    uses.visit(tree)
    exports = imports.names if all(map(_is_export, tree.body)) else None
    referred = frozenset(imports.references | uses.references)
    return Content(referred, frozenset(uses.path_parts), frozenset(uses.file_names), exports)


def exports(init: Path, module: Content) -> Names | None:
    """Names that a package re-exports from its modules, including those of the stub that ``lazy_loader`` reads.

    ``init`` is the package's ``__init__.py`` and ``module`` its content. None where the package has its own code.
    """
    stub = init.with_suffix(".pyi")
    if module.exports is None or not stub.is_file():
        return module.exports
    return module.exports | (content(stub.read_bytes()).exports or {})


def _is_export(node: ast.stmt) -> bool:
    """Whether a statement is a docstring, an import, or the list of a package's names."""
    if isinstance(node, ast.Assign):
        names = {part.id for target in node.targets for part in ast.walk(target) if isinstance(part, ast.Name)}
        return bool(names & {"__all__", "__getattr__"})
    docstring = isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant)
    return docstring or isinstance(node, (ast.Import, ast.ImportFrom))


class _Imports(ast.NodeVisitor):
    """Imports of a file, and the names that it binds to them."""

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
            reference = Reference(f"{node.module}.{alias.name}" if node.module else alias.name, node.level)
            self.references.add(reference)
            self.names.setdefault(alias.asname or alias.name, set()).add(reference)

    def visit_If(self, node: ast.If) -> None:
        for statement in node.orelse if _is_type_checking(node.test) else (node.test, *node.body, *node.orelse):
            self.visit(statement)


class _Uses(ast.NodeVisitor):
    """Uses of a file's imports, and the text that it joins to paths."""

    def __init__(self, names: Names) -> None:
        self.names = names
        self.references: set[Reference] = set()
        self.path_parts: set[str] = set()
        self.file_names: set[str] = set()

    def visit_Constant(self, node: ast.Constant) -> None:
        if isinstance(node.value, str) and FILE_NAME.fullmatch(node.value):
            self.file_names.add(node.value)

    def visit_Attribute(self, node: ast.Attribute) -> None:
        chain: list[str] = []
        inner: ast.expr = node
        while isinstance(inner, ast.Attribute):
            chain.insert(0, inner.attr)
            inner = inner.value
        if not isinstance(inner, ast.Name):
            self.visit(inner)
            return
        for reference in self.names.get(inner.id, ()):
            self.references.add(Reference(".".join([reference.dotted, *chain]), reference.level))

    def visit_Name(self, node: ast.Name) -> None:
        for reference in self.names.get(node.id, ()):
            self.references.add(Reference(reference.dotted, reference.level, whole=True))

    def visit_BinOp(self, node: ast.BinOp) -> None:
        if isinstance(node.op, ast.Div):
            self._join(node.right)
        self.generic_visit(node)

    def visit_Call(self, node: ast.Call) -> None:
        name = node.func.attr if isinstance(node.func, ast.Attribute) else getattr(node.func, "id", None)
        if name in ("Path", "joinpath", "join", "with_name"):
            for argument in node.args:
                self._join(argument)
        if name in ("import_module", "__import__") and node.args and isinstance(node.args[0], ast.Constant):
            self.references.add(Reference(str(node.args[0].value), whole=True))
        self.generic_visit(node)

    def _join(self, part: ast.expr) -> None:
        if isinstance(part, ast.Constant) and isinstance(part.value, str):
            self.path_parts.update(part.value.split("/"))


def _is_type_checking(test: ast.expr) -> bool:
    return (test.attr if isinstance(test, ast.Attribute) else getattr(test, "id", None)) == "TYPE_CHECKING"
