"""The table of ``dasim study bound``, on the screen and as files."""

from __future__ import annotations

import csv
import json
from pathlib import Path

import numpy as np
import pytest

from dasim.camera.geometry import blur_px
from dasim.camera.specification import CAMERA_DIR, load_camera, refocused
from dasim.cli import run
from validation.studies import criteria
from validation.studies.bound import Row


def distances(printed: str) -> list[float]:
    return [float(line.split()[0]) for line in printed.splitlines() if " cm " in line]


def test_the_command_prints_the_bound_and_names_all_mistakes(capsys):
    assert run(["study", "bound", "--count", "3"]) == 0
    assert distances(capsys.readouterr().out) == [24.0, 8.28, 5.0]
    assert run(["study", "bound", "--lux", "-1", "--channels", "G", "--near-cm", "60"]) == 2
    message = capsys.readouterr().err
    assert message.count("\n") == 1
    for part in ("--lux", "--channels", "near-cm"):
        assert part in message


def test_the_focus_is_that_of_the_file(tmp_path, capsys):
    """Expectation: a camera file focused at 20 cm is not refocused; its range ends where the blur is 3 px."""
    text = (CAMERA_DIR / "da-mobile.toml").read_text()
    (tmp_path / "near.toml").write_text(text.replace("focus_distance_m = 0.4", "focus_distance_m = 0.2"))
    assert run(["study", "bound", str(tmp_path / "near.toml"), "--count", "2"]) == 0
    printed = capsys.readouterr().out
    assert "focus 0.2 m" in printed
    farthest_cm = distances(printed)[0]
    assert blur_px(refocused(load_camera("da-mobile"), 0.2), farthest_cm / 100) == pytest.approx(
        criteria.NEAREST_BLUR_PX, rel=1e-2
    )


@pytest.mark.parametrize(
    ("arguments", "parts"),
    [
        (("--far-cm", "30"), ("5 to 30 cm", "up to 27.8")),
        (("--near-cm", "20", "--far-cm", "10"), ("20 to 10 cm", "must rise")),
        (("--focus", "0.05"), ("focused at 0.05 m", "--near-cm")),
        (("--near-cm", "0.3"), ("0.3 to 24 cm", "above the focal length, 0.36 cm")),
        (("--json", "/proc/bound.json"), ("--json", "/proc is not a folder that can be written to")),
        (("--json", "no/bound.json"), ("--json no/bound.json", "folder")),
    ],
)
def test_a_range_is_refused_and_not_changed(arguments, parts, tmp_path, monkeypatch, capsys):
    """Rationale: a table for other distances than asked for is taken for the one that was asked for."""
    monkeypatch.chdir(tmp_path)
    assert run(["study", "bound", *arguments]) == 2
    message = capsys.readouterr().err
    for part in parts:
        assert part in message


def test_files_hold_the_printed_table(tmp_path, monkeypatch, capsys):
    """Expectation: the same numbers in both files; dioptres are the error over the distance squared."""
    monkeypatch.chdir(tmp_path)
    assert run(["study", "bound", "--count", "3", "--json", "bound.json", "--csv", "bound.csv"]) == 0
    about = json.loads(Path("bound.json").read_text())
    assert (about["light"], about["lux"], about["channels"]) == ("D65", 5000.0, ["G", "IR"])
    table = list(csv.DictReader(Path("bound.csv").read_text().splitlines()))
    assert [{name: float(value) for name, value in row.items()} for row in table] == about["rows"]
    assert tuple(table[0]) == Row._fields
    shown = distances(capsys.readouterr().out)
    np.testing.assert_allclose([100 * row["depth_m"] for row in about["rows"]], shown, atol=0.005)
    for row in about["rows"]:
        assert row["dioptres"] == pytest.approx(row["depth_sd_m"] / row["depth_m"] ** 2)


def test_limits_of_the_table_and_files_of_other_kinds(tmp_path, capfd):
    """Expectation: one line for sizes that no computer holds, and for a file that is no table: it stays as it is."""
    (tmp_path / "mine.toml").write_text("a = 1")
    wrong = (["--count", "1000000"], "1 to 1000"), (["--csv", str(tmp_path / "mine.toml")], "*.csv")
    for arguments, message in (*wrong, (["--lux", "1e-300"], "1e-06 to 1e+07")):
        assert run(["study", "bound", *arguments]) == 2
        (line,) = capfd.readouterr().err.splitlines()
        assert message in line
    assert (tmp_path / "mine.toml").read_text() == "a = 1"
