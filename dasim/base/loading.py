"""Loading of the user's functions by name: ``package.module:function`` or ``file.py:function``."""

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

from dasim.base.errors import InputError, describe_error
from dasim.base.suggestions import did_you_mean

_FILE_MODULE = "dasim_file_"  # prefix of the module name of a user's file, which prevents clashes with other modules


def load_function(name: str, kind: str) -> Callable[..., Any]:
    """Function of a name; raises InputError if it cannot be imported or is not callable.

    A module is searched among the installed ones and then in the working folder. A file may import modules from its own
    folder, and is executed anew at each call. A function from a file cannot be pickled: pass its name to another
    process and load it there.

    Args:
        name: ``package.module:function`` or ``file.py:function``.
        kind: what the function is for, in messages: ``noise model``, ``method``.
    """
    source, colon, attribute = name.rpartition(":")
    if not colon or not source or not attribute.isidentifier():
        raise InputError(f"{kind} '{name}': must be package.module:function or file.py:function")
    where = f"{kind} '{name}'"
    module = _file_module(Path(source), where) if source.endswith(".py") else _module(source, where)
    function = getattr(module, attribute, None)
    if function is None:
        functions = [key for key, value in vars(module).items() if callable(value) and _is_own(key, value, module)]
        has = f"it defines {', '.join(sorted(functions))}" if functions else "it defines no function"
        raise InputError(f"{where}: {source} has no '{attribute}'; {has}{did_you_mean(attribute, functions)}")
    if not callable(function):
        raise InputError(f"{where}: is not a function but of type {type(function).__name__}")
    return function


def function_name(function: Callable[..., Any]) -> str:
    """Name of a function for provenance and reports: ``module:function`` or ``file.py:function``."""
    module = getattr(function, "__module__", None) or type(function).__module__
    name = getattr(function, "__qualname__", None) or type(function).__qualname__
    if module == "__main__" or module.startswith(_FILE_MODULE):
        module = Path(getattr(sys.modules.get(module), "__file__", None) or module).name
    return f"{module}:{name}"


def locate_error(error: BaseException) -> str:
    """Message of an error in a user's function as one line, with the file and line where it was raised."""
    text = describe_error(error)
    frames = traceback.extract_tb(error.__traceback__)
    if isinstance(error, SyntaxError) or not frames:  # the text of a SyntaxError has its place
        return text
    return f"{text} ({Path(frames[-1].filename).name}, line {frames[-1].lineno})"


def _module(name: str, where: str) -> ModuleType:
    """Import a module by its dotted name; ``where`` begins the message of an InputError."""
    _add_to_path(Path.cwd())
    importlib.invalidate_caches()
    try:
        return importlib.import_module(name)
    except ModuleNotFoundError as error:
        if error.name is not None and (name == error.name or name.startswith(f"{error.name}.")):
            raise InputError(
                f"{where}: there is no module '{error.name}', installed or in {Path.cwd()}; "
                "a file is given with its ending, as file.py:function"
            ) from None
        raise InputError(f"{where}: cannot be imported, {locate_error(error)}") from error
    except (Exception, SystemExit) as error:  # whatever the user's module raises
        raise InputError(f"{where}: cannot be imported, {locate_error(error)}") from error


def _file_module(path: Path, where: str) -> ModuleType:
    """Execute a Python file as a module; ``where`` begins the message of an InputError."""
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
    sys.modules[name] = module  # dataclasses look up their module while it is executed
    try:
        # The loader's bytecode cache would miss the second of two edits within a second: compile without it.
        exec(loader.source_to_code(source, str(path)), vars(module))
    except (Exception, SystemExit) as error:
        del sys.modules[name]
        raise InputError(f"{where}: cannot be imported, {locate_error(error)}") from error
    return module


def _add_to_path(folder: Path) -> None:
    """Append a folder to the import path, after the installed modules."""
    if str(folder) not in sys.path:
        sys.path.append(str(folder))


def _is_own(key: str, value: Any, module: ModuleType) -> bool:
    """Whether a public name is defined in the module itself."""
    return not key.startswith("_") and getattr(value, "__module__", None) == module.__name__
