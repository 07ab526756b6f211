"""The command list."""

from __future__ import annotations

import pytest

from dasim.cli import run


@pytest.mark.parametrize(
    ("kind", "name"),
    [
        ("scenes", "desk"),
        ("cameras", "da-mobile"),
        ("materials", "brick"),
        ("illuminants", "D65"),
        ("datasets", "dasim-bench"),
        ("claims", "staircase-camera"),
        ("studies", "hole-size"),
        ("methods", "chakrabarti-zickler"),
        ("presets", "likelihood"),
    ],
)
def test_list_names_what_is_bundled(kind, name, capsys):
    assert run(["list", kind]) == 0
    assert name in capsys.readouterr().out
    assert run(["list", kind, "--verbose"]) == 0


@pytest.mark.parametrize(
    ("arguments", "message_part"),
    [
        (("list", "metods"), ("did you mean 'methods'",)),
        (("list", "fruit"), ("fruit", "scenes", "cameras", "claims", "studies", "methods")),
        (("list",), ("kind",)),
    ],
    ids=lambda value: " ".join(value) if value and isinstance(value[0], str) else None,
)
def test_wrong_arguments_are_refused_in_one_line(refused, arguments, message_part):
    refused(*arguments, message_part=message_part)
