"""Files of datasets: names in the working folder, and what dead writers left."""

from __future__ import annotations

import os
import platform
import subprocess
import time

from dasim.base import atomic
from dasim.dataset import storage


def test_half_written_files_of_the_dead_are_swept(tmp_path):
    """Unfinished files of processes that have ended are removed; those of another computer stay until they are a day
    old.
    """
    dead = subprocess.Popen(["true"])
    dead.wait()
    here = platform.node()
    names = {
        f".a.tar.1.{here}.{dead.pid}.partial": False,
        f".b.tar.1.{here}.{os.getpid()}.partial": True,
        ".c.tar.1.elsewhere.1.partial": True,
        ".d.tar.1.elsewhere.1.partial": False,
        "e.tar": True,
    }
    for name in names:
        (tmp_path / name).write_bytes(b"half")
    os.utime(tmp_path / ".d.tar.1.elsewhere.1.partial", (time.time() - 2 * atomic.ABANDONED_S,) * 2)
    storage.sweep(str(tmp_path))
    assert {name: (tmp_path / name).exists() for name in names} == names


def test_relative_folder_follows_the_working_folder(tmp_path, monkeypatch):
    """Expectation: the same name in another working folder is another dataset."""
    for name in ("one", "two"):
        (tmp_path / name / "ds").mkdir(parents=True)
        monkeypatch.chdir(tmp_path / name)
        storage.write("ds", "name.txt", name.encode())
        assert storage.read("ds", "name.txt") == name.encode()
        assert storage.local_path("ds") == tmp_path / name / "ds"
    assert (tmp_path / "one" / "ds" / "name.txt").read_text() == "one"
