"""Files and folders that appear whole or not at all; the sweep after dead writers is in dataset/test_make."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from dasim.base import atomic


def test_file_is_replaced_when_the_block_ends_and_not_before(tmp_path):
    path = tmp_path / "new" / "result.txt"
    atomic.write(path, "earlier µm\n")
    assert path.read_bytes() == "earlier µm\n".encode()
    with atomic.writing(path) as file:
        file.write(b"later")
        file.flush()
        assert path.read_text() == "earlier µm\n"
        (partial,) = (entry for entry in path.parent.iterdir() if entry != path)
        assert partial.name.endswith(atomic.PARTIAL)
    assert path.read_bytes() == b"later" and list(path.parent.iterdir()) == [path]


@pytest.mark.parametrize("error", [ZeroDivisionError, KeyboardInterrupt])
def test_interrupted_file_leaves_the_earlier_one(tmp_path, error):
    path = tmp_path / "result.txt"
    atomic.write(path, b"earlier")
    with pytest.raises(error), atomic.writing(path) as file:
        file.write(b"half")
        raise error
    assert path.read_bytes() == b"earlier" and list(tmp_path.iterdir()) == [path]


def test_file_has_the_permissions_of_any_new_file(tmp_path):
    """Rationale: temporary files are often private, and a bank or index is for all who may read the folder."""
    (tmp_path / "plain").write_bytes(b"")
    atomic.write(tmp_path / "atomic", b"")
    assert (tmp_path / "atomic").stat().st_mode == (tmp_path / "plain").stat().st_mode


def test_folder_is_replaced_as_a_whole(tmp_path):
    path = tmp_path / "out"
    with atomic.new_folder(path) as folder:
        (folder / "first").touch()
        assert not path.exists()
    with atomic.new_folder(path) as folder:
        (folder / "second").touch()
    assert [entry.name for entry in path.iterdir()] == ["second"] and list(tmp_path.iterdir()) == [path]


def test_interrupted_folder_leaves_the_earlier_one(tmp_path, monkeypatch):
    """Also where the interrupt comes between the two renames."""
    path = tmp_path / "out"
    path.mkdir()
    (path / "first").touch()
    with pytest.raises(KeyboardInterrupt), atomic.new_folder(path) as folder:
        (folder / "second").touch()
        raise KeyboardInterrupt
    rename = os.rename

    def interrupted(old, new):
        if new == path and ".partial-" in str(old):
            raise KeyboardInterrupt
        rename(old, new)

    monkeypatch.setattr(atomic.os, "rename", interrupted)
    with pytest.raises(KeyboardInterrupt), atomic.new_folder(path) as folder:
        (folder / "second").touch()
    assert [entry.name for entry in path.iterdir()] == ["first"] and list(tmp_path.iterdir()) == [path]


def test_output_that_was_renamed_before_a_signal_counts_as_written(tmp_path, monkeypatch):
    """Set-up: a signal that comes right after the file or folder has its name, or right before."""
    rename, replace = os.rename, Path.replace

    def stopped(function, before: bool):
        def call(*names):
            if before:
                raise KeyboardInterrupt
            function(*names)
            raise KeyboardInterrupt

        return call

    for before in (True, False):
        with monkeypatch.context() as patch:
            patch.setattr(os, "rename", stopped(rename, before))
            patch.setattr(Path, "replace", stopped(replace, before))
            with pytest.raises(KeyboardInterrupt), atomic.new_folder(tmp_path / f"folder{before}"):
                pass
            assert (atomic.last_written() == tmp_path / f"folder{before}") is not before
            with pytest.raises(KeyboardInterrupt):
                atomic.write(tmp_path / f"file{before}", b"x")
            assert (atomic.last_written() == tmp_path / f"file{before}") is not before
    assert sorted(path.name for path in tmp_path.iterdir()) == ["fileFalse", "folderFalse"]
