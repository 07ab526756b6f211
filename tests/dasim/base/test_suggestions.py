"""Suggestions for mistyped names."""

from __future__ import annotations

from typing import Annotated, Literal

import pytest
from pydantic import Field, RootModel

from dasim.base.errors import InputError
from dasim.base.suggestions import did_you_mean
from dasim.base.toml import Specification, parse

SCENES = ("adam", "desk", "disks", "fence", "staircase")


@pytest.mark.parametrize(
    ("name", "end"),
    [
        ("dsk", "; did you mean 'desk'?"),
        ("DESK", "; did you mean 'desk'?"),
        ("stairs", "; did you mean 'staircase'?"),
        ("", ""),
        ("qwertz", ""),
        (3, ""),
        (None, ""),
    ],
)
def test_nearest_name(name, end):
    """Expectation: one letter less, another case or an abbreviation is found; nothing is suggested for other text."""
    assert did_you_mean(name, SCENES) == end


def test_several_names_nearest_first():
    assert did_you_mean("disk", SCENES, 2) == "; did you mean 'disks' or 'desk'?"


def test_spelling_of_the_known_name_is_kept():
    assert did_you_mean("d56", ["D65", "D55"], 1) in ("; did you mean 'D65'?", "; did you mean 'D55'?")


class Ring(Specification):
    shape: Literal["ring"]
    inner_mm: float


class Bar(Specification):
    shape: Literal["bar"]
    length_mm: float


class Row(RootModel[dict[str, Ring]]):
    pass


class Drawing(Specification):
    title: str = ""
    side: Literal["left", "right"] = "left"
    parts: tuple[Annotated[Ring | Bar, Field(discriminator="shape")], ...] = ()
    rows: dict[str, Bar] = Field(default_factory=dict)
    sheet: Row | None = None
    grids: tuple[int, ...] = Field(default=(), alias="parameters")


@pytest.mark.parametrize(
    ("data", "message"),
    [
        ({"titel": "x"}, "titel: unknown key; did you mean 'title'?"),
        ({"paramters": [1]}, "paramters: unknown key; did you mean 'parameters'?"),
        ({"colour": 1}, "colour: unknown key"),
        ({"side": "lef"}, "side: must be 'left' or 'right' (is 'lef'); did you mean 'left'?"),
        ({"parts": [{"shape": "rng"}]}, "parts.0: shape 'rng' is unknown; allowed are ring, bar; did you mean 'ring'?"),
        ({"parts": [{"shape": "ring", "inner_mm": 1, "iner": 2}]}, "iner: unknown key; did you mean 'inner_mm'?"),
        ({"parts": [{"shape": "bar", "length_mm": 1, "inner": 2}]}, "parts.0.inner: unknown key"),
        (
            {"rows": {"a": {"shape": "bar", "length_mm": 1, "lenght": 2}}},
            "lenght: unknown key; did you mean 'length_mm'?",
        ),
        ({"sheet": {"a": {"shape": "ring", "inner_mm": 1, "shap": 2}}}, "shap: unknown key; did you mean 'shape'?"),
    ],
)
def test_mistyped_keys_and_words_of_a_file(data, message):
    """Expectation: the nearest key of the same table, of the same kind where there are several; nothing else."""
    with pytest.raises(InputError) as caught:
        parse(Drawing, data, "drawing.toml")
    assert str(caught.value).endswith(message)
