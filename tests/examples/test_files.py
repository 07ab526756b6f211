"""The TOML and YAML files of the examples are accepted by what reads them."""

from __future__ import annotations

import tomllib
from pathlib import Path

import pytest

from dasim.dataset.specification import load_spec
from validation.studies.sweep.loading import load_study

EXAMPLES = Path(__file__).parents[2] / "examples"


def test_dataset_is_accepted():
    assert load_spec(EXAMPLES / "table-tops.toml").samples == 200


def test_study_is_accepted():
    assert load_study(str(EXAMPLES / "hole-in-the-office.toml")).name == "hole-in-the-office"


@pytest.mark.parametrize("name", ["github", "gitlab"])
def test_workflows_score_and_write_verdicts(name):
    """Expectation: valid YAML, and the options of the command that it runs."""
    yaml = pytest.importorskip("yaml")
    text = (EXAMPLES / "ci" / f"{name}.yml").read_text(encoding="utf-8")
    assert yaml.safe_load(text)
    assert all(option in text for option in ("dasim score", "--method", "--gates", "--junit"))


def test_every_toml_file_of_the_examples_is_known():
    """Expectation: no example is left without a test above."""
    names = {path.name for path in EXAMPLES.rglob("*.toml")}
    assert names == {"table-tops.toml", "hole-in-the-office.toml"}
    assert all(tomllib.loads((EXAMPLES / name).read_text(encoding="utf-8")) for name in names)
