"""Cached figures of rendered designs."""

from __future__ import annotations

import pytest

from validation.studies.shape import cached


def test_figures_are_computed_once_per_key(tmp_path, monkeypatch: pytest.MonkeyPatch) -> None:  # type: ignore[no-untyped-def]
    monkeypatch.setenv("DASIM_CACHE_DIR", str(tmp_path))
    calls = []

    def compute() -> dict[str, object]:
        calls.append(1)
        return {"errors": [[1.0, 2.0], [3.0, float("nan")]], "sharp_db": 30.5}

    first = cached.figures(["camera", "bands"], compute)
    again = cached.figures(["camera", "bands"], compute)
    assert len(calls) == 1
    assert repr(first) == repr(again) == repr({"errors": ((1.0, 2.0), (3.0, float("nan"))), "sharp_db": 30.5})
    cached.figures(["camera", "paper"], compute)
    assert len(calls) == 2


def test_cache_that_cannot_be_written_is_no_error(tmp_path, monkeypatch, capsys):
    (tmp_path / "file").touch()
    monkeypatch.setenv("DASIM_CACHE_DIR", str(tmp_path / "file"))
    assert cached.figures(["camera"], lambda: {"sharp_db": 30.5}) == {"sharp_db": 30.5}
    assert "cannot be kept" in capsys.readouterr().err
