import pickle
import sys

import pytest

from dasim.base.errors import InputError
from dasim.base.loading import function_name, load_function


@pytest.fixture
def path_kept(monkeypatch, tmp_path):
    """Imports of a test stay within it: sys.path and sys.modules as before, the current folder empty."""
    monkeypatch.setattr(sys, "path", list(sys.path))
    modules = set(sys.modules)
    monkeypatch.chdir(tmp_path)
    yield tmp_path
    for name in set(sys.modules) - modules:
        del sys.modules[name]


def message(name: str) -> str:
    with pytest.raises(InputError) as caught:
        load_function(name, "noise model")
    text = str(caught.value)
    assert "\n" not in text and text.startswith(f"noise model '{name}'")
    return text


def test_function_of_an_installed_module_is_that_function():
    assert load_function("pickle:dumps", "method") is pickle.dumps


def test_module_of_the_current_folder_is_found_and_its_name_is_given_back(path_kept):
    (path_kept / "lab").mkdir()
    (path_kept / "lab" / "depth.py").write_text("def zero(x):\n    return 0 * x\n")
    function = load_function("lab.depth:zero", "method")
    assert function(3) == 0
    assert function_name(function) == "lab.depth:zero"


def test_file_imports_what_lies_beside_it_and_its_classes_work(path_kept):
    folder = path_kept / "elsewhere"
    folder.mkdir()
    (folder / "beside.py").write_text("FACTOR = 7\n")
    (folder / "own.py").write_text(
        "from __future__ import annotations\nfrom dataclasses import dataclass\nfrom beside import FACTOR\n"
        "@dataclass(frozen=True)\nclass Part:\n    value: int\n"
        "def scaled(x):\n    return Part(FACTOR * x).value\n"
    )
    function = load_function("elsewhere/own.py:scaled", "method")
    assert function(3) == 21
    assert function_name(function) == "own.py:scaled"


def test_file_named_as_an_installed_module_shadows_nothing(path_kept):
    (path_kept / "pickle.py").write_text("def dumps(x):\n    return 'own'\n")
    assert load_function("pickle.py:dumps", "method")(1) == "own"
    assert load_function("pickle:dumps", "method") is pickle.dumps


def test_file_is_read_anew_even_within_the_resolution_of_its_date(path_kept):
    path = path_kept / "own.py"
    for value in range(3):  # same size, same second
        path.write_text(f"def value():\n    return {value}\n")
        assert load_function("own.py:value", "method")() == value


@pytest.mark.parametrize("name", ["own", "own:", ":f", "own.py", "own:a b", "own:f()", ""])
def test_what_is_no_name_of_a_function_is_refused(name, path_kept):
    assert "must be package.module:function or file.py:function" in message(name)


def test_missing_module_file_and_function_are_told_apart(path_kept):
    (path_kept / "own.py").write_text("from math import sqrt\nWIDTH = 3\ndef column(x): ...\ndef _inner(x): ...\n")
    assert "no module 'no_such_package'" in message("no_such_package.noise:f")
    assert "no module 'json.noise'" in message("json.noise:f")
    assert "none.py cannot be read" in message("none.py:f")
    assert message("own.py:colum").endswith("own.py has no 'colum'; it defines column; did you mean 'column'?")
    assert "is not a function but of type int" in message("own.py:WIDTH")


@pytest.mark.parametrize(
    ("source", "expected"),
    [
        ("import no_such_thing\n", "ModuleNotFoundError: No module named 'no_such_thing' (own.py, line 1)"),
        ("\n1 / 0\n", "ZeroDivisionError: division by zero (own.py, line 2)"),
        ("def f(:\n", "SyntaxError: "),
        ("import sys\nsys.exit(3)\n", "SystemExit: 3 (own.py, line 2)"),
        ("raise ValueError('two\\nlines')\n", "ValueError: two lines"),
    ],
)
def test_an_import_that_raises_is_one_line_with_its_place(source, expected, path_kept):
    (path_kept / "own.py").write_text(source)
    assert f"cannot be imported, {expected}" in message("own.py:f")
    assert f"cannot be imported, {expected}" in message("own:f")


def test_name_of_an_object_that_is_called():
    class Model:
        def __call__(self):
            return 0

    assert function_name(Model()).endswith(":" + Model.__qualname__)
