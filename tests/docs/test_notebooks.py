"""The notebooks are kept without output, and run as the pages show them."""

from __future__ import annotations

import json

import pytest

from tests.support.pages import DOCS, script

notebooks = script("notebooks")
NOTEBOOKS = sorted((DOCS / "notebooks").glob("*.ipynb"))


def test_a_cell_shows_what_it_prints_and_its_last_value():
    values = {}
    assert notebooks.output("x = 2\nprint('two')\nx + 1", values, "cell") == "two\n3"
    assert notebooks.output("x + 1;", values, "cell") == "" and values["x"] == 2


def test_an_error_ends_the_run():
    with pytest.raises(ZeroDivisionError):
        notebooks.output("1 / 0", {}, "cell")


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_notebooks_are_kept_without_output(path):
    notebook = json.loads(path.read_text(encoding="utf-8"))
    assert notebook["nbformat"] == 4 and notebook["cells"][0]["source"][0].startswith("# ")
    assert all(not cell["outputs"] for cell in notebook["cells"] if cell["cell_type"] == "code")


@pytest.mark.slow
@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_notebooks_run(path):
    """Expectation: two figures each, and what is printed stands on the page."""
    page = notebooks.run(path)
    assert len(page.figures) == 2 and "```text" in page.text
