"""Files and folders that appear whole or not at all; the sweep after dead writers is in dataset/test_storage."""

from __future__ import annotations

import os
import platform
import signal
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
        if new == path and str(old).endswith(atomic.PARTIAL):
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


def dead_after(work) -> int:
    """Number of a process that has done something and then been killed."""
    process = os.fork()
    if not process:
        try:
            work()
        finally:
            os.kill(os.getpid(), signal.SIGKILL)
    os.waitpid(process, 0)
    return process


def test_leftovers_of_killed_runs_go_with_the_next_run_of_the_same_output(tmp_path):
    """Set-up: writers of a file and of a folder that were killed within, and the same of processes that run, of another
    computer, and of outputs with other names.
    """

    def half_file():
        with atomic.writing(tmp_path / "a.json") as file:
            file.write(b"half")
            os.kill(os.getpid(), signal.SIGKILL)

    def half_folder():
        with atomic.new_folder(tmp_path / "out") as folder:
            (folder / "inner").mkdir()
            (folder / "inner" / "file").write_bytes(b"half")
            os.kill(os.getpid(), signal.SIGKILL)

    dead = dead_after(half_file)
    dead_after(half_folder)
    assert len(list(tmp_path.iterdir())) == 2
    here, me = platform.node(), os.getpid()
    kept = [f".out.1.{here}.{me}.partial", ".out.1.elsewhere.1.partial", f".out.more.1.{here}.{dead}.partial"]
    kept += [f".a.json.1.{here}.{me}.partial", ".a.json.old", f".b.json.1.{here}.{dead}.partial"]
    for name in kept:
        (tmp_path / name).mkdir()
    atomic.write(tmp_path / "a.json", b"whole")
    with atomic.new_folder(tmp_path / "out"):
        pass
    assert sorted(path.name for path in tmp_path.iterdir()) == sorted([*kept, "a.json", "out"])


def test_folder_of_a_run_killed_between_the_two_renames_gets_its_name_back(tmp_path):
    """Set-up: a run is killed when it has renamed the earlier folder; the next one fails, and must leave that one."""
    path = tmp_path / "out"
    path.mkdir()
    (path / "first").touch()
    rename = os.rename

    def killed(old, new):
        rename(old, new)
        os.kill(os.getpid(), signal.SIGKILL)

    def replaced():
        atomic.os.rename = killed
        with atomic.new_folder(path):
            pass

    dead_after(replaced)
    assert not path.exists() and len(list(tmp_path.iterdir())) == 2
    with pytest.raises(ZeroDivisionError), atomic.new_folder(path):
        raise ZeroDivisionError
    assert [entry.name for entry in path.iterdir()] == ["first"] and list(tmp_path.iterdir()) == [path]
