"""Options that the commands share: where results go by default, and lists of names."""

from __future__ import annotations

from pathlib import Path

import pytest

from dasim.cli import options


@pytest.mark.parametrize(
    ("source", "ending", "expected"),
    [
        ("desk", "", "out/desk"),
        ("staircase:14", "", "out/staircase-14"),
        ("random:0:7", "", "out/random-0-7"),
        ("random:mine.toml:0:7", "", "out/random-mine.toml-0-7"),
        ("scenes/mine.toml", "", "out/mine"),
        ("photo.raw", "-recon", "out/photo-recon"),
        ("away/shot.2", "-recon", "out/shot.2-recon"),
        ("da-mobile", ".npz", "out/da-mobile.npz"),
    ],
)
def test_output_has_the_name_of_what_is_given(source, ending, expected):
    assert options.default_out(source, ending) == Path(expected)


def test_folders_keep_their_whole_name(tmp_path, monkeypatch):
    (tmp_path / "shot.v2").mkdir()
    monkeypatch.chdir(tmp_path / "shot.v2")
    assert options.default_out(tmp_path / "shot.v2") == options.default_out(".") == Path("out/shot.v2")


def test_names_by_spaces_and_commas():
    assert options.names(["a,b", " c , ,d"]) == ["a", "b", "c", "d"]
    assert options.names(None) == []
