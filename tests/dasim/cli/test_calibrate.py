"""The command calibrate: one line for wrong input; the banks that it makes are those of the other commands' tests."""

from __future__ import annotations

import pytest


@pytest.mark.parametrize(
    ("arguments", "message_part"),
    [
        (("calibrate", "--illuminant", "F99", "--out", "new"), ("illuminant 'F99'", "did you mean 'F9'")),
        (
            ("calibrate", "--illuminant", "D55", "--illuminant", "F99", "--out", "new"),
            ("illuminant 'F99'", "did you mean 'F9'"),
        ),
        (("calibrate", "--illuminant", "D55", "--diffraction", "x", "--out", "new"), ("diffraction 'x'", "wave")),
        (("calibrate", "--focus", "nan", "--out", "new"), ("focus", "nan")),
        (("calibrate", "--field", "900", "--out", "new"), ("--field '900'", "X,Y")),
        (("calibrate", "--field", "nan,1", "--out", "new"), ("--field 'nan,1'", "X,Y")),
        (("calibrate", "--field", "-90000,0", "--out", "new"), ("degrees from the axis", "60 degrees")),
        (("calibrate", "--camera", "leica", "--out", "new"), ("camera 'leica'", "da-mobile")),
        (("calibrate", "--out", "shot"), ("shot", "folder")),
        (("calibrate", "--out", "mine.toml/bank.npz"), ("mine.toml",)),
        (("calibrate", "--out", "camera.toml"), ("camera.toml",)),
    ],
    ids=lambda value: " ".join(value) if value and isinstance(value[0], str) else None,
)
def test_wrong_arguments_are_refused_in_one_line(refused, arguments, message_part):
    refused(*arguments, message_part=message_part)
