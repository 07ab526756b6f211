"""The reference has every key of every model that reads TOML, every command and every public name."""

from __future__ import annotations

import inspect
import re

import pytest

import dasim
import recon
import validation
from dasim.base.toml import Specification
from dasim.camera.lens import Lens
from dasim.cli import app
from dasim.files import captures
from dasim.scene.lights import Ground
from dasim.scene.mitsuba_scene import MitsubaScene
from recon.files import dng_reading
from tests.support.pages import script
from validation.subjects import held_out

reference = script("reference")
# Models that no user's TOML file holds: metadata of captures, and what the project itself reads.
NO_FILE = {
    captures._CaptureMeta,
    dng_reading._Private,
    held_out._Entry,
    held_out._Sets,
    Ground,
    MitsubaScene,
    dasim.Exposure,
}


@pytest.fixture(scope="module")
def pages():
    return reference.pages()


def models(kind: type = Specification) -> set[type]:
    """All models of the project that can be instantiated, by their subclasses."""
    found = set()
    for model in kind.__subclasses__():
        found |= {model, *models(model)}
    return {model for model in found if model.__module__.split(".")[0] in ("dasim", "recon", "validation")}


def test_every_model_has_its_table():
    """Expectation: all models are on a page, but for bases (their keys are those of what derives from them)."""
    shown = {name for page in reference.PAGES for root in page.models for name in reference.schemas(root)}
    bases = {model for model in models() if model.__name__.startswith("_") and model.__subclasses__()}
    missing = {model.__name__ for model in models() - NO_FILE - bases} - shown
    assert not missing


@pytest.mark.parametrize("page", reference.PAGES, ids=lambda page: page.name)
def test_every_key_has_unit_range_default_and_meaning(page, pages):
    """Expectation: one row a key, and no cell of it is empty."""
    text = pages[f"reference/keys/{page.name}.md"]
    for root in page.models:
        for name, schema in reference.schemas(root).items():
            if page.name == "dataset" and name == "RandomScenes":
                continue
            section = text.split(f"\n## {name.lstrip('_')}\n")[1].split("\n## ")[0]
            for key in (key for key in schema["properties"] if key not in reference.NOT_IN_FILES):
                row = re.search(rf"^\| `{key}` \| (.+) \|$", section, flags=re.MULTILINE)
                assert row, f"{name}.{key} has no row"
                cells = re.split(r"(?<!\\)\|", row[1])
                assert len(cells) == 4 and all(cell.strip() for cell in cells), f"{name}.{key}: {row[1]}"


def test_ranges_are_those_of_the_model():
    """Expectation: the row of a key repeats what the model enforces."""
    rows = {key.name: key for key in reference.keys("Lens", reference.schemas(Lens)["Lens"])}
    assert rows["focal_length_mm"][1:4] == ("mm", "number ≥ 0.1, ≤ 1,000", "required")
    assert rows["transmittance"].default == "`1.0`" and rows["transmittance"].unit == "1"


def test_meanings_describe_only_what_the_model_does_not():
    """Expectation: a key that its model describes, or that does not exist, has no second description."""
    schemas = {n: s for page in reference.PAGES for root in page.models for n, s in reference.schemas(root).items()}
    for owner, meanings in reference.MEANINGS.items():
        for key in meanings if owner != "any" else ():
            assert key in schemas[owner]["properties"], f"{owner}.{key}"
            assert "description" not in schemas[owner]["properties"][key], f"{owner}.{key}"


def test_every_command_and_option_is_there(pages):
    text = pages["reference/commands.md"]
    for name in (name for name in app if not name.startswith("-")):
        assert f"## dasim {name}\n" in text
    for option in ("--noise-share", "--print-settings", "--propose-gates", "--shard"):
        assert option in text


@pytest.mark.parametrize("package", [dasim, recon, validation], ids=lambda package: package.__name__)
def test_every_public_name_is_there(package, pages):
    """Expectation: a section a name, with its signature where it is a function."""
    text = pages["reference/python.md"]
    for name in package.__all__:
        assert f"\n### {package.__name__}.{name}\n" in text
        if inspect.isfunction(getattr(package, name)):
            assert f"\n{name}(" in text


@pytest.mark.parametrize(
    "planted",
    [
        '<script src="https://unpkg.com/x.js"></script>',
        '<link rel="stylesheet" href="//fonts.example/x.css">',
        "<img alt=x src=http://example.org/x.png>",
        "<style>@import 'https://example.org/x.css';</style>",
    ],
)
def test_requests_to_other_hosts_are_found(planted, tmp_path):
    (tmp_path / "index.html").write_text('<a href="https://example.org">link</a><img src="images/x.png">')
    outside = script("outside")
    assert outside.requests(tmp_path) == []
    (tmp_path / "bad.html").write_text(planted)
    assert len(outside.requests(tmp_path)) == 1
