"""The cache: several processes at once, killed ones among them, and its size."""

from __future__ import annotations

import os
import platform
import random
import signal
import subprocess
import time

import numpy as np
import pytest

from dasim.base import atomic, cache
from dasim.base.errors import InputError
from dasim.camera import geometry
from dasim.camera import specification as cameras
from dasim.files.banks import load_bank, save_bank
from dasim.values import PsfBank
from validation.gates import stored
from validation.gates.claim import Evidence
from validation.studies.shape import cached as shape


def test_what_was_not_used_for_the_longest_time_is_removed_first(tmp_path):
    """Set-up: five entries of 100 bytes, one of them a folder; room for three. The oldest was used again."""
    for age, name in enumerate("abcde"):
        if name == "c":
            (tmp_path / name).mkdir()
            (tmp_path / name / "inner").write_bytes(bytes(100))
        else:
            (tmp_path / name).write_bytes(bytes(100))
        os.utime(tmp_path / name, (age, age))
    cache.used(tmp_path / "a")
    cache.bound(tmp_path, 350)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a", "d", "e"]
    cache.bound(tmp_path, 350)
    cache.used(tmp_path / "none")
    assert len(list(tmp_path.iterdir())) == 3


def test_unfinished_files_of_killed_processes_are_removed(tmp_path):
    process = os.fork()
    if not process:
        with atomic.writing(tmp_path / "entry"):
            os.kill(os.getpid(), signal.SIGKILL)
    os.waitpid(process, 0)
    assert len(list(tmp_path.iterdir())) == 1
    cache.bound(tmp_path)
    assert list(tmp_path.iterdir()) == []


def test_unfinished_folders_are_removed_where_their_writer_has_ended_or_after_a_day(tmp_path):
    dead = subprocess.Popen(["true"])
    dead.wait()
    here = platform.node()
    kept = {f".a.1.{here}.{dead.pid}.partial": False, f".a.1.{here}.{os.getpid()}.partial": True}
    kept |= {".old.1.elsewhere.1.partial": False, ".new.1.elsewhere.1.partial": True}
    for name in kept:
        (tmp_path / name).mkdir()
        (tmp_path / name / "file").touch()
    os.utime(tmp_path / ".old.1.elsewhere.1.partial", (time.time() - 2 * atomic.ABANDONED_S,) * 2)
    cache.bound(tmp_path)
    assert {name: (tmp_path / name).exists() for name in kept} == kept


def test_evidence_and_figures_of_designs_are_bounded(tmp_path, monkeypatch):
    """Set-up: room for 700 bytes of each; a claim's evidence has more than 500, figures of a design more than 400."""
    monkeypatch.setenv("DASIM_CACHE_DIR", str(tmp_path))
    monkeypatch.setattr(cache.bound, "__defaults__", (700,))
    for number in range(4):
        stored.save(f"claim{number}", 0, "key", Evidence(figures=[], pictures=[("a picture", "x" * 500)]), 1.0)
        shape.figures([str(number)], lambda: {"errors": [0.25] * 60})
        for folder in ("claims", "shape-study"):
            (left,) = (tmp_path / folder).iterdir()
            assert left.stat().st_size <= 700
    assert stored.load("claim3", 0, "key") is not None and stored.load("claim2", 0, "key") is None


def bank_of(camera: cameras.Camera) -> PsfBank:
    """A bank of even kernels, 30 kB."""
    blur = geometry.level_blur_px(camera)
    return PsfBank(
        kernel=np.full((1, len(blur), 4, 9, 9), 1 / 81, np.float32),
        lights=("D65",),
        signature=np.ones((1, 4), np.float32),
        depth_m=geometry.depth_of_blur_m(camera, blur).astype(np.float32),
        blur_px=blur.astype(np.float32),
        camera=camera,
        diffraction="off",
    )


@pytest.mark.parametrize("rounds", [3, pytest.param(12, marks=pytest.mark.slow)])
def test_processes_that_fill_and_use_it_at_once(rounds, tmp_path):
    """Set-up: four processes store, read, mark and bound the same two banks, with room for one; some are killed, then
    one more process does it.

    Expectation: whoever was not killed has read whole banks or none, and nothing unfinished is left.
    """
    bank = bank_of(cameras.cropped(cameras.load_camera("da-mobile"), 16, 16))

    def use(count: int) -> None:
        for number in range(count):
            path = tmp_path / f"{number % 2}.npz"
            try:
                cache.used(path)
                np.testing.assert_array_equal(load_bank(path).kernel, bank.kernel)
            except InputError as error:
                assert "cannot be read" in str(error) or "no such file" in str(error), error
            save_bank(path, bank)
            cache.bound(tmp_path, 20_000)

    for number in range(rounds):
        chance = random.Random(number)
        processes = []
        for _ in range(4):
            process = os.fork()
            if not process:
                try:
                    use(6)
                    os._exit(0)
                except BaseException:
                    import traceback

                    traceback.print_exc()
                    os._exit(1)
            processes.append(process)
        time.sleep(chance.random() * 0.05)
        killed = chance.sample(processes, 2)
        for process in killed:
            os.kill(process, signal.SIGKILL)
        ends = {process: os.waitstatus_to_exitcode(os.waitpid(process, 0)[1]) for process in processes}
        assert all(end == 0 or process in killed for process, end in ends.items()), ends
        use(1)
        assert [path.name for path in tmp_path.iterdir() if path.name.startswith(".")] == []
