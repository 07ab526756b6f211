"""Every module with code has tests of its name, or names in its docstring the tests that exercise it.

Exempt are modules without a function, ``__main__``, and the claims that ``dasim validate`` measures: their limits are
their tests, and tests/validation/claims/ shows of the decisive ones that they fail where the physics is wrong.
"""

from __future__ import annotations

import ast
import re
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
ROOMS = ("dasim", "recon", "validation")
STATEMENT = re.compile(r"Tested in ((?:tests/[\w/]+\.py(?:,? and |, )?)+)")


def name_of(path: Path) -> str:
    """Dotted name of a module's file."""
    parts = path.relative_to(ROOT).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


SUPPORT = sorted((ROOT / "tests" / "support").glob("*.py"))
SOURCES = {name_of(path): path for room in ROOMS for path in sorted((ROOT / room).rglob("*.py"))}
LAZY = {name for name, path in SOURCES.items() if path.with_suffix(".pyi").is_file()}


@cache
def parsed(path: Path) -> ast.Module:
    return ast.parse(path.read_text(encoding="utf-8"))


def has_code(path: Path) -> bool:
    """Whether a module has a function with a body beyond its docstring; ``__main__`` only calls one."""
    functions = (node for node in ast.walk(parsed(path)) if isinstance(node, ast.FunctionDef))
    return path.stem != "__main__" and any(len(node.body) > (ast.get_docstring(node) is not None) for node in functions)


def own_tests(path: Path) -> Path:
    """Where the tests of a module lie by its name; those of a package's own code in its folder."""
    folder = ROOT / "tests" / path.relative_to(ROOT).parent
    return folder / f"test_{path.parent.name if path.stem == '__init__' else path.stem}.py"


@cache
def imports(path: Path) -> frozenset[str]:
    """Modules of the project that a file imports, anywhere in its code; of a lazy package those of its stub."""
    modules: set[str] = set()
    stub = path.with_suffix(".pyi")
    for node in (*ast.walk(parsed(path)), *(ast.walk(parsed(stub)) if stub.is_file() else ())):
        if isinstance(node, ast.Import):
            modules.update(alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            package = name_of(path).split(".") if path.stem == "__init__" else name_of(path).split(".")[:-1]
            above = package[: len(package) - node.level + 1] if node.level else []
            module = ".".join([*above, *([node.module] if node.module else [])])
            modules.add(module)
            modules.update(f"{module}.{alias.name}" for alias in node.names)
    return frozenset(modules & SOURCES.keys())


def exercises(test: Path, module: str) -> bool:
    """Whether a test imports a module, or one that imports it, or one of those that import that.

    What the fixtures of ``conftest.py`` (in the test's folder and above) and the helpers in tests/support import counts
    as the test's own imports.
    """
    fixtures = [folder / "conftest.py" for folder in test.parents if (folder / "conftest.py").is_file()]
    helpers = [*fixtures, *SUPPORT]
    text = test.read_text(encoding="utf-8")
    reached = set(imports(test)).union(*(imports(path) for path in helpers if path.stem in ("conftest", *words(text))))
    reached |= {name for at in reached & LAZY for name in imports(SOURCES[at])}
    for _ in range(2):
        reached |= {name for at in reached for name in imports(SOURCES[at])}
    return module in reached


def words(text: str) -> set[str]:
    return set(re.findall(r"\w+", text))


CLAIMS = imports(SOURCES["validation.claims.table"])


@pytest.mark.parametrize("module", [name for name, path in SOURCES.items() if has_code(path) and name not in CLAIMS])
def test_every_module_has_its_tests(module):
    """Expectation: tests/<path>/test_<name>.py, or a line "Tested in tests/..." in the docstring with files that exist
    and reach the module by imports.
    """
    path = SOURCES[module]
    if own_tests(path).is_file():
        assert exercises(own_tests(path), module), f"{own_tests(path)} does not import {module}"
        return
    statement = STATEMENT.search(re.sub(r"\s+", " ", ast.get_docstring(parsed(path)) or ""))
    test_file = own_tests(path).relative_to(ROOT)
    assert statement, f"{module} has no tests: write {test_file}, or name them in its docstring (Tested in tests/...)"
    for named in re.findall(r"tests/[\w/]+\.py", statement[1]):
        assert (ROOT / named).is_file(), f"{module} names {named}, which does not exist"
        assert exercises(ROOT / named, module), f"{module} names {named}, which does not import it"
