"""Functions of the user's own, by name: ``package.module:function`` or ``file.py:function``."""

from __future__ import annotations

import importlib.machinery
import importlib.util
import sys
import traceback
import zlib
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any

from dasim.base.errors import InputError

_FILE_MODULE = "dasim_file_"  # begins the module name of a user's file, so that it shadows no installed module


def load_function(name: str, kind: str) -> Callable[..., Any]:
    """The function of a name; InputError in one line where it cannot be imported or is not callable.

    Modules are looked for among the installed ones and then in the current folder; a file may import modules that
    lie beside it. A file is executed anew at each call. A function from a file cannot be pickled by reference: pass
    its name to another process and load it there.

    Args:
        name: ``package.module:function`` or ``file.py:function``.
        kind: what the function is, for messages: ``noise model``, ``method``.
    """
    source, colon, attribute = name.rpartition(":")
    if not colon or not source or not attribute.isidentifier():
        raise InputError(f"{kind} '{name}': package.module:function or file.py:function is needed")
    where = f"{kind} '{name}'"
    module = _file_module(Path(source), where) if source.endswith(".py") else _module(source, where)
    function = getattr(module, attribute, None)
    if function is None:
        own = [key for key, value in vars(module).items() if callable(value) and _is_own(key, value, module)]
        has = f"it defines {', '.join(sorted(own))}" if own else "it defines no function"
        raise InputError(f"{where}: {source} has no '{attribute}'; {has}")
    if not callable(function):
        raise InputError(f"{where}: is not a function but of type {type(function).__name__}")
    return function


def function_name(function: Callable[..., Any]) -> str:
    """``module:function`` or ``file.py:function`` of a function, as provenance and reports write it."""
    module = getattr(function, "__module__", None) or type(function).__module__
    name = getattr(function, "__qualname__", None) or type(function).__qualname__
    if module == "__main__" or module.startswith(_FILE_MODULE):
        module = Path(getattr(sys.modules.get(module), "__file__", None) or module).name
    return f"{module}:{name}"


def describe_error(error: BaseException) -> str:
    """What a user's function raised, in one line: its kind, text, and the file and line where it was raised."""
    text = " ".join(f"{type(error).__name__}: {error}".split())
    frames = traceback.extract_tb(error.__traceback__)
    if isinstance(error, SyntaxError) or not frames:  # a SyntaxError's text has its place
        return text
    return f"{text} ({Path(frames[-1].filename).name}, line {frames[-1].lineno})"


def _module(name: str, where: str) -> ModuleType:
    _add_to_path(Path.cwd())
    importlib.invalidate_caches()
    try:
        return importlib.import_module(name)
    except ModuleNotFoundError as error:
        if error.name is not None and (name == error.name or name.startswith(f"{error.name}.")):
            raise InputError(
                f"{where}: there is no module '{error.name}' among the installed ones or in {Path.cwd()}; "
                "a file is named with its ending: file.py:function"
            ) from None
        raise InputError(f"{where}: cannot be imported, {describe_error(error)}") from error
    except (Exception, SystemExit) as error:  # whatever the user's module raises
        raise InputError(f"{where}: cannot be imported, {describe_error(error)}") from error


def _file_module(path: Path, where: str) -> ModuleType:
    path = path.resolve()
    try:
        source = path.read_bytes()
    except OSError as error:
        raise InputError(f"{where}: {path} cannot be read ({error.strerror})") from None
    name = f"{_FILE_MODULE}{path.stem}_{zlib.crc32(str(path).encode()):08x}"
    loader = importlib.machinery.SourceFileLoader(name, str(path))
    spec = importlib.util.spec_from_loader(name, loader)
    assert spec is not None
    module = importlib.util.module_from_spec(spec)
    _add_to_path(path.parent)
    sys.modules[name] = module  # dataclasses look their module up while it is executed
    try:
        # Compiled here rather than by the loader, whose bytecode cache takes a file edited twice in a second for old.
        exec(loader.source_to_code(source, str(path)), vars(module))
    except (Exception, SystemExit) as error:
        del sys.modules[name]
        raise InputError(f"{where}: cannot be imported, {describe_error(error)}") from error
    return module


def _add_to_path(folder: Path) -> None:
    """Let modules of the folder be imported, after the installed ones."""
    if str(folder) not in sys.path:
        sys.path.append(str(folder))


def _is_own(key: str, value: Any, module: ModuleType) -> bool:
    return not key.startswith("_") and getattr(value, "__module__", None) == module.__name__
