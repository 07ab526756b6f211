"""The pages' Python runs, their TOML is accepted, their links and pictures exist."""

from __future__ import annotations

import ast
import re
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

from dasim.dataset.specification import DatasetSpec
from dasim.scene.specification import Scene
from tests.support.pages import DOCS, ROOT, blocks, pages, script
from validation.studies.sweep.specification import StudySpec

DEADLINE_S = 600.0
README_LINES = 150
PICTURE_BYTES, ALL_PICTURES_BYTES = 300_000, 3_000_000
PICTURES = (".jpg", ".png", ".svg")
NAMES = [str(page.relative_to(ROOT)) for page in pages()]


def marks(page: Path) -> set[str]:
    return {block.mark for block in blocks(page) if block.language == "python"}


def run_marked(page: Path, folder: Path) -> None:
    """Run the marked blocks of a page in order, in one process and a folder of their own; no warning is allowed."""
    program = "\n".join(block.text for block in blocks(page) if block.language == "python" and block.mark)
    command = [sys.executable, "-c", program]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, timeout=DEADLINE_S, check=False)
    assert done.returncode == 0, f"{program}\n{done.stderr}"
    assert "Warning" not in done.stderr, done.stderr


@pytest.mark.parametrize("name", [name for name in NAMES if marks(ROOT / name) - {""} == {"run"}])
def test_python_of_the_pages_runs(name, tmp_path):
    run_marked(ROOT / name, tmp_path)


@pytest.mark.slow
@pytest.mark.parametrize("name", [name for name in NAMES if "run slow" in marks(ROOT / name)])
def test_python_that_renders_runs(name, tmp_path):
    run_marked(ROOT / name, tmp_path)


@pytest.mark.parametrize("name", NAMES)
def test_code_of_the_pages_can_be_read(name):
    """Expectation: every block of Python parses, every block of TOML too, and no mark stands above anything else."""
    for block in blocks(ROOT / name):
        if block.language == "python":
            ast.parse(block.text)
        elif block.language == "toml":
            tomllib.loads(block.text)
        assert block.language == "python" or not block.mark, block.text


@pytest.mark.parametrize(
    ("name", "model"), [("datasets", DatasetSpec), ("studies", StudySpec), ("scenes", Scene)], ids=lambda x: str(x)
)
def test_toml_of_the_guides_is_accepted(name, model):
    """Expectation: the first TOML file that a guide shows has no unknown key and no wrong value."""
    text = next(block.text for block in blocks(DOCS / "guides" / f"{name}.md") if block.language == "toml")
    model.model_validate(tomllib.loads(text))


@pytest.mark.parametrize("name", NAMES)
def test_links_lead_to_pages_that_exist_or_are_made(name):
    """Expectation: a link is a web address, a file, a page of the reference, which is made, or a figure that is."""
    page = ROOT / name
    text = re.sub(r"```.*?```", "", page.read_text(encoding="utf-8"), flags=re.DOTALL)
    for address in re.findall(r"\]\(([^)#]+)[^)]*\)", text):
        if re.match(r"[a-z]+:", address):
            continue
        target = (page.parent / address).resolve()
        figure = target.parent == DOCS / "how" and target.stem in script("figures").FIGURES
        made = target.is_relative_to(DOCS / "reference") or figure
        assert target.exists() or made, f"{name}: {address}"


def test_readme_is_short():
    assert len((ROOT / "README.md").read_text(encoding="utf-8").splitlines()) <= README_LINES


def test_pictures_are_small():
    """Expectation: a clone is not burdened by pictures."""
    sizes = {path: path.stat().st_size for path in DOCS.rglob("*") if path.suffix in PICTURES}
    assert max(sizes.values()) < PICTURE_BYTES and sum(sizes.values()) < ALL_PICTURES_BYTES, sizes
