"""Interrupted datasets: killed runs and full disks, at any moment, end in the bytes of a run that nothing disturbed."""

from __future__ import annotations

import errno
import os
import shutil
import signal
import subprocess
import sys
import time
from collections import Counter
from pathlib import Path

import pytest

from dasim.base import executors
from dasim.base.errors import InputError
from dasim.dataset import storage, work
from tests.support.datasets import MESH, SQUARE, WALL, finished_sums, log_entries, make_dataset, spec_file

START_S = 300.0  # for the first sample, also where other work slows the machine


def started(spec: Path, out: Path, jobs: str) -> subprocess.Popen:
    """A run of the command in a separate process that has made at least two samples."""
    program = "from dasim.cli import main; main()"
    command = [sys.executable, "-c", program, "dataset", "make", str(spec), "--out", str(out), "--jobs", jobs]
    process = subprocess.Popen(command, stderr=subprocess.PIPE, text=True)
    begin = time.monotonic()
    while len(list(out.glob("parts/*.tar"))) < 2 and process.poll() is None:
        assert time.monotonic() - begin < START_S
        time.sleep(0.005)
    assert process.poll() is None, process.communicate(timeout=START_S)[1]
    return process


def goes_on(spec: Path, out: Path) -> dict[str, str]:
    """Checksums after the run was resumed; nothing is made twice."""
    have = {int(path.stem) for path in out.glob("parts/[0-9]*.tar")}
    lines = len((out / "make.log").read_text().splitlines())
    make_dataset(spec, out)
    assert have and have.isdisjoint(index for index, _ in log_entries(out, lines))
    assert all(done for _, done in log_entries(out)) and max(Counter(log_entries(out)).values()) == 1
    return finished_sums(out)


@pytest.mark.slow
def test_interrupt_ends_the_run_and_it_goes_on(spec, undisturbed, tmp_path):
    out = tmp_path / "ds"
    process = started(spec, out, "1")
    process.send_signal(signal.SIGINT)
    _, message = process.communicate(timeout=START_S)
    assert process.returncode == 128 + signal.SIGINT, message
    assert "stopped" in message.splitlines()[-1] and "Traceback" not in message
    assert not list(out.rglob("*.partial"))
    assert goes_on(spec, out) == undisturbed


@pytest.mark.slow
def test_killed_run_goes_on(spec, undisturbed, tmp_path):
    out = tmp_path / "ds"
    process = started(spec, out, "2")
    process.kill()
    process.communicate(timeout=START_S)
    time.sleep(1.0)  # its workers end with their samples, as nobody asks for more
    assert goes_on(spec, out) == undisturbed


class Killed(BaseException):
    """An exception that no code catches."""


@pytest.fixture
def interrupted(monkeypatch):
    """A function that makes a run end before its n-th change of the files, or with a full disk; None lets it finish."""
    left: list[int | None] = [None]
    error: list[BaseException] = [Killed()]

    def counted(function):
        def change(*arguments):
            if left[0] is not None:
                left[0] -= 1
                if left[0] < 0:
                    raise error[0]
            return function(*arguments)

        return change

    for name in ("write", "remove", "writing"):
        monkeypatch.setattr(storage, name, counted(getattr(storage, name)))

    def arm(changes: int | None, raised: BaseException | None = None) -> None:
        left[0], error[0] = changes, raised or Killed()

    return arm


FULL = OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


@pytest.mark.parametrize("form", ["webdataset", "folders"])
@pytest.mark.parametrize("end", [None, FULL], ids=["killed", "full"])
def test_ends_at_any_change_of_the_files(form, end, tmp_path, interrupted, remembered, renderer):
    """A run that is ended at the n-th write or removal, for every n, and then resumed gives the same bytes; no sample
    is made twice.
    """
    spec = spec_file(tmp_path, samples=3, format=form)
    make_dataset(spec, tmp_path / "reference")
    reference = finished_sums(tmp_path / "reference")
    for changes in range(100):
        out = tmp_path / f"{changes}"
        interrupted(changes, end)
        try:
            make_dataset(spec, out)
            break
        except Killed:
            pass
        except (InputError, OSError) as error:  # the command says either in one line
            assert "No space left" in str(error) and "\n" not in str(error)
        finally:
            interrupted(None)
        have = {int(path.stem) for path in out.glob("parts/[0-9]*.tar")}
        lines = len(log_entries(out)) if (out / "make.log").exists() else 0
        make_dataset(spec, out)
        assert finished_sums(out) == reference, f"stopped before change {changes}"
        assert have.isdisjoint(index for index, _ in log_entries(out, lines))
        assert all(done for _, done in log_entries(out))
    assert changes > 10


def test_retry_ends_at_any_change_of_the_files(tmp_path, interrupted, remembered, renderer):
    """The same for a run that tries a failed sample again after its mesh was repaired."""
    (tmp_path / "mesh.toml").write_text(WALL + MESH)
    spec = spec_file(tmp_path, samples=4, files=["wall.toml", "mesh.toml"], samples_per_shard=3)
    (tmp_path / "thing.obj").write_text(SQUARE)
    make_dataset(spec, tmp_path / "reference")
    reference = finished_sums(tmp_path / "reference")
    (tmp_path / "thing.obj").write_text("no mesh")
    make_dataset(spec, tmp_path / "poisoned", only_mesh_fails)
    (tmp_path / "thing.obj").write_text(SQUARE)
    for changes in range(100):
        out = tmp_path / f"{changes}"
        shutil.copytree(tmp_path / "poisoned", out)
        interrupted(changes)
        try:
            make_dataset(spec, out, retry=True)
            break
        except Killed:
            pass
        finally:
            interrupted(None)
        make_dataset(spec, out, retry=True)
        assert finished_sums(out) == reference, f"stopped before change {changes}"
    assert changes > 10


def only_mesh_fails(job, queue):
    """The samples of the broken mesh, which were rendered before it broke, fail here."""
    while queue:
        index = queue.popleft()
        yield executors.Outcome(index, "broken") if index % 2 else work.work(job, index)


@pytest.mark.slow
def test_file_beyond_the_limit_of_a_process_is_a_full_disk(spec, undisturbed, tmp_path):
    """The operating system cuts writes short (RLIMIT_FSIZE of 40 kB), which counts as a full disk."""
    out = tmp_path / "ds"
    program = (
        "import resource, sys; from tests.support.datasets import make_dataset, inline; from pathlib import Path\n"
        "import dasim.dataset.tar_files as s\n"
        "real = s.pack\n"
        "def pack(members):\n"
        "    resource.setrlimit(resource.RLIMIT_FSIZE, (40_000, resource.RLIM_INFINITY))\n"
        "    return real(members)\n"
        "import dasim.dataset.work as w\n"
        "w.tar_files.pack = pack\n"
        f"make_dataset(Path({str(spec)!r}), Path({str(out)!r}), inline)\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", program],
        cwd=Path(__file__).parents[3],
        env=os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)},
        capture_output=True,
        text=True,
    )
    assert "InputError" in done.stderr.splitlines()[-1] and "File too large" in done.stderr.splitlines()[-1]
    assert not list(out.rglob("*.partial"))
    make_dataset(spec, out)
    assert finished_sums(out) == undisturbed
