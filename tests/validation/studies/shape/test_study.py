"""The plan and the table of a shape study."""

from __future__ import annotations

import numpy as np
import pytest

from dasim.cli import run
from validation.studies.shape.study import Study


def test_all_mistakes_are_named_in_one_line(tmp_path, capsys) -> None:  # type: ignore[no-untyped-def]
    arguments = "--budget 0 --cells 4 --feature-um 1 --seeds 0 --light nix --near-cm 50 --lux inf"
    assert run(["study", "shape", "--out", str(tmp_path / "out"), *arguments.split()]) == 2
    message = capsys.readouterr().err
    assert message.count("\n") == 1
    for part in ("cells 4", "no light", "seeds 0", "feature 1 um", "near side", "illuminant 'nix'", "lux inf: must be"):
        assert part in message
    assert not (tmp_path / "out").exists()


def test_a_camera_without_infrared_has_nothing_to_shape(tmp_path, capsys) -> None:  # type: ignore[no-untyped-def]
    assert run(["study", "shape", "bayer-mobile", "--out", str(tmp_path / "out")]) == 2
    assert "IR" in capsys.readouterr().err


@pytest.mark.slow
def test_rows_are_relative_to_the_disc_and_sorted_by_the_bound_of_depth(study: Study) -> None:
    disc, others = study.rows[0], study.rows[1:]
    assert (disc.name, disc.depth_ratio, disc.cut_ratio, disc.sharp_ratio) == ("disc 0.46", 1.0, 1.0, 1.0)
    assert [row.depth_dioptre for row in others] == sorted(row.depth_dioptre for row in others)
    for row in others:
        assert row.depth_ratio == pytest.approx(row.depth_dioptre / disc.depth_dioptre)
    assert [design.name for design in study.designs] == [row.name for row in study.rows]


def test_steps_lead_from_the_bounds_to_each_preset(study: Study) -> None:
    steps = study.steps()
    assert [name for name in steps if name.startswith("preset")] == [
        "preset bands",
        "preset paper",
        "preset likelihood",
    ]
    assert next(iter(steps)) == "bound, periodic patch"
    for rows in steps.values():
        assert rows[0][0] == "disc 0.46"
        assert len(rows) == 5  # the disc, three searched masks, and the disc at the rim
    _, error, to_disc, spread = steps["likelihood on rendered boards"][0]
    first, second = np.hypot(0.2, 0.3), np.hypot(0.2, 0.4)  # of two levels, times the square root of 2
    assert (error, to_disc, spread) == pytest.approx(((first + second) / np.sqrt(8), 1.0, 0.0))
