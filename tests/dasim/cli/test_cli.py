"""The command line as a whole: help, and names of commands that do not exist."""

from __future__ import annotations

import pytest

from dasim.cli import run


@pytest.mark.parametrize(
    ("command", "options"),
    [
        ("demo", ["--out", "folder"]),
        ("render", ["--size", "central crop", "--spp", "samples", "--focus", "metres", "--seed"]),
        ("expose", ["--time", "1/60", "--lux", "--scale", "--seed", "--frames", "burst"]),
        ("calibrate", ["--illuminant", "--focus", "metres"]),
        ("recon", ["--bank", "cache", "--settings", "preset"]),
        ("score", ["--json", "figures"]),
        ("emva", ["--camera", "--channel", "R, G, B or IR", "--gain", "--size", "WxH", "--seed"]),
        ("list", ["cameras", "illuminants"]),
    ],
)
def test_help_explains_every_option(command, options, capsys):
    """Expectation: what the docstring says of an option stands in --help, with its unit."""
    assert run([command, "--help"]) == 0
    output = " ".join(capsys.readouterr().out.replace("│", " ").split())
    for part in options:
        assert part in output, f"'{part}' is not in\n{output}"


@pytest.mark.parametrize(
    ("arguments", "message_part"),
    [
        (("nonsense",), ("nonsense", "render", "recon")),
    ],
    ids=lambda value: " ".join(value) if value and isinstance(value[0], str) else None,
)
def test_wrong_arguments_are_refused_in_one_line(refused, arguments, message_part):
    refused(*arguments, message_part=message_part)
