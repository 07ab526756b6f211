"""Making datasets: the same bytes after crashes and interrupts, and no sample made twice."""

from __future__ import annotations

import errno
import json
import multiprocessing
import os
import platform
import shutil
import signal
import subprocess
import sys
import threading
import time
from collections import Counter
from pathlib import Path
from types import SimpleNamespace

import pytest

from dasim.base import atomic, executors
from dasim.base.errors import InputError
from dasim.cli import run
from dasim.cli.datasets import processes_of
from dasim.dataset import plan, sample, storage, verify, work
from dasim.dataset.make import TRIES
from dasim.dataset.specification import load_spec
from dasim.render import backend
from tests.support.datasets import (
    MESH,
    SQUARE,
    WALL,
    backwards,
    deadly,
    inline,
    log_entries,
    make_dataset,
    spec_file,
    sums,
)

SAMPLES = 24
START_S = 300.0  # for the first sample, also where other work slows the machine


@pytest.fixture(scope="module")
def spec(renderer, tmp_path_factory) -> Path:
    return spec_file(tmp_path_factory.mktemp("spec"), samples=SAMPLES, samples_per_shard=5)


@pytest.fixture(scope="module")
def reference(spec, tmp_path_factory) -> dict[str, str]:
    """Checksums of a run in this process, one sample after the other."""
    out = tmp_path_factory.mktemp("reference") / "ds"
    make_dataset(spec, out)
    assert list(verify.problems(str(out))) == []
    return sums(out)


@pytest.fixture
def remembered(monkeypatch):
    """Render each sample once and reuse it; other tests show that rendering it again gives the same bytes."""
    memory, render = {}, sample.make

    def remember(spec, index, variant):
        key = (spec.model_dump_json(), index)
        if key not in memory:
            memory[key] = render(spec, index, variant)
        return memory[key]

    monkeypatch.setattr(sample, "make", remember)


def whole(out: Path) -> dict[str, str]:
    """Checksums of a finished dataset, in which everything is as it should be."""
    assert list(verify.problems(str(out))) == []
    left = [path.name for path in out.rglob("*.partial")]
    assert left == [] and not (out / "parts").exists() and not (out / "rows").exists()
    return sums(out)


# --- the same bytes anywhere ---------------------------------------------------------------------


def test_another_order_makes_the_same_bytes(spec, reference, tmp_path):
    make_dataset(spec, tmp_path / "ds", backwards)
    assert whole(tmp_path / "ds") == reference


def test_runs_of_a_part_each_make_the_same_bytes(spec, reference, tmp_path, remembered):
    for part in (2, 3, 1):
        done = make_dataset(spec, tmp_path / "ds", shard=(part, 3))
        assert done.failed == {} and done.done == done.total
        assert (tmp_path / "ds" / plan.SUMS).exists() == (part == 1)
    assert whole(tmp_path / "ds") == reference


def test_runs_side_by_side_make_the_same_bytes(spec, reference, tmp_path, remembered):
    """Several runs begin, write and finish at the same time; the sweep of one leaves the files of the others."""
    make_dataset(spec, tmp_path / "first")  # fills what is remembered
    for attempt in range(4):
        out = tmp_path / f"ds{attempt}"
        errors = []

        def part(number, out=out, errors=errors):
            try:
                make_dataset(spec, out, shard=(number, 5))
            except BaseException as error:
                errors.append(error)

        runs = [threading.Thread(target=part, args=(number,)) for number in range(1, 6)]
        for thread in runs:
            thread.start()
        for thread in runs:
            thread.join()
        assert errors == []
        assert whole(out) == reference


@pytest.mark.slow
def test_workers_that_crash_cost_their_own_sample_alone(spec, reference, tmp_path):
    """Set-up: two processes; the renderer ends its process at the last sample always, and once at the one before."""
    out = tmp_path / "ds"
    done = make_dataset(spec, out, executors.local(2, deadly))
    assert set(done.failed) == {23} and "SIGKILL" in done.failed[23]
    tries = Counter(log_entries(out))
    assert tries.pop((23, False)) == TRIES and tries.pop((22, False)) == 1
    assert tries == {(index, True): 1 for index in range(SAMPLES - 1)}
    assert "SIGABRT" in (out / "make.log").read_text()
    (out / ".once").unlink()
    assert list(verify.problems(str(out))) == []
    again = make_dataset(spec, out)  # it was given up: not tried again unless asked for
    assert again.failed == done.failed and again.done == 0
    repaired = make_dataset(spec, out, retry=True)
    assert repaired.failed == {} and repaired.done == 1
    assert whole(out) == reference


# --- never loses work ----------------------------------------------------------------------------


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
    return whole(out)


@pytest.mark.slow
def test_interrupt_ends_the_run_and_it_goes_on(spec, reference, tmp_path):
    out = tmp_path / "ds"
    process = started(spec, out, "1")
    process.send_signal(signal.SIGINT)
    _, message = process.communicate(timeout=START_S)
    assert process.returncode == 128 + signal.SIGINT, message
    assert "stopped" in message.splitlines()[-1] and "Traceback" not in message
    assert not list(out.rglob("*.partial"))
    assert goes_on(spec, out) == reference


@pytest.mark.slow
def test_killed_run_goes_on(spec, reference, tmp_path):
    out = tmp_path / "ds"
    process = started(spec, out, "2")
    process.kill()
    process.communicate(timeout=START_S)
    time.sleep(1.0)  # its workers end with their samples, as nobody asks for more
    assert goes_on(spec, out) == reference


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
    reference = whole(tmp_path / "reference")
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
        assert whole(out) == reference, f"stopped before change {changes}"
        assert have.isdisjoint(index for index, _ in log_entries(out, lines))
        assert all(done for _, done in log_entries(out))
    assert changes > 10


def test_retry_ends_at_any_change_of_the_files(tmp_path, interrupted, remembered, renderer):
    """The same for a run that tries a failed sample again after its mesh was repaired."""
    (tmp_path / "mesh.toml").write_text(WALL + MESH)
    spec = spec_file(tmp_path, samples=4, files=["wall.toml", "mesh.toml"], samples_per_shard=3)
    (tmp_path / "thing.obj").write_text(SQUARE)
    make_dataset(spec, tmp_path / "reference")
    reference = whole(tmp_path / "reference")
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
        assert whole(out) == reference, f"stopped before change {changes}"
    assert changes > 10


def only_mesh_fails(job, queue):
    """The samples of the broken mesh, which were rendered before it broke, fail here."""
    while queue:
        index = queue.popleft()
        yield executors.Outcome(index, "broken") if index % 2 else work.work(job, index)


def test_poisoned_sample_is_left_out_until_it_is_repaired(tmp_path, monkeypatch, capsys, renderer):
    (tmp_path / "mesh.toml").write_text(WALL + MESH)
    (tmp_path / "thing.obj").write_text("no mesh\n")
    spec = spec_file(tmp_path, samples=4, files=["wall.toml", "mesh.toml"])
    out = tmp_path / "ds"
    monkeypatch.setattr(executors, "local", lambda *_, **options: inline)
    assert run(["dataset", "make", str(spec), "--out", str(out)]) == 1
    message = capsys.readouterr().err
    assert (
        "sample 1 failed" in message
        and "sample 3 failed" in message
        and "thing.obj" in message
        and "--retry" in message
    )
    assert Counter(log_entries(out)) == {(0, True): 1, (2, True): 1, (1, False): 1, (3, False): 1}
    assert "thing.obj" in (out / "README.md").read_text()
    assert run(["dataset", "verify", str(out)]) == 0
    assert run(["dataset", "make", str(spec), "--out", str(out)]) == 1  # nothing to do, and still not whole
    (tmp_path / "thing.obj").write_text(SQUARE)
    assert run(["dataset", "make", str(spec), "--out", str(out), "--retry"]) == 0
    assert Counter(log_entries(out)) == {
        **{(index, True): 1 for index in range(4)},
        **{(1, False): 1, (3, False): 1},
    }
    make_dataset(spec, tmp_path / "straight")
    assert whole(out) == whole(tmp_path / "straight")


def test_full_temporary_folder_is_nobodys_sample(spec, tmp_path, monkeypatch):
    monkeypatch.setattr(sample, "make", lambda *arguments: 1 / 0)
    monkeypatch.setattr(work, "SCRATCH_BYTES", 1e30)
    with pytest.raises(InputError, match=r"temporary folder .* is full; finished samples are stored"):
        make_dataset(spec, tmp_path / "ds")
    assert not list((tmp_path / "ds").rglob("failed/*"))


@pytest.mark.slow
def test_file_beyond_the_limit_of_a_process_is_a_full_disk(spec, reference, tmp_path):
    """The operating system cuts writes short (RLIMIT_FSIZE of 40 kB), which counts as a full disk."""
    out = tmp_path / "ds"
    program = (
        "import resource, sys; from tests.support.datasets import make_dataset, inline; from pathlib import Path\n"
        "import dasim.dataset.sample as s\n"
        "real = s.pack\n"
        "def pack(members):\n"
        "    resource.setrlimit(resource.RLIMIT_FSIZE, (40_000, resource.RLIM_INFINITY))\n"
        "    return real(members)\n"
        "import dasim.dataset.work as w\n"
        "w.sample.pack = pack\n"
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
    assert whole(out) == reference


def test_worker_with_other_libraries_makes_nothing(spec, tmp_path, monkeypatch):
    """Pixels would differ, so that the run ends before the first sample is written."""
    monkeypatch.setattr(sample, "provenance", lambda variant: {"variant": variant, "llvm": "0", "cpu": "abacus"})
    with pytest.raises(InputError, match="this worker has another llvm, cpu than the dataset"):
        make_dataset(spec, tmp_path / "ds")
    assert not (tmp_path / "ds" / "parts").exists()


def test_dataset_is_not_continued_by_other_code(spec, tmp_path, monkeypatch, capsys):
    """Set-up: a dataset that was begun, whose manifest has the fingerprint of other code, or of a version without one.

    Expectation: the command that continues it makes nothing, and says why in one line; with the same code it goes on.
    """
    out = tmp_path / "ds"
    out.mkdir()
    plan.begin(str(out), plan.description(load_spec(spec), sample.provenance(backend.choose().variant)))
    manifest = json.loads((out / plan.MANIFEST).read_text())
    for other in ({"code": "0" * 24}, {}):
        changed = {key: value for key, value in manifest.items() if key != "code"} | other
        (out / plan.MANIFEST).write_text(json.dumps(changed))
        assert run(["dataset", "make", str(spec), "--out", str(out)]) == 2
        assert "was begun by other code than this dasim's" in capsys.readouterr().err.splitlines()[-1]
        assert [path.name for path in out.iterdir()] == [plan.MANIFEST]
    (out / plan.MANIFEST).write_text(json.dumps(manifest))
    plan.begin(str(out), manifest)


def test_relative_folder_follows_the_working_folder(tmp_path, monkeypatch):
    """Expectation: the same name in another working folder is another dataset."""
    for name in ("one", "two"):
        (tmp_path / name / "ds").mkdir(parents=True)
        monkeypatch.chdir(tmp_path / name)
        storage.write("ds", "name.txt", name.encode())
        assert storage.read("ds", "name.txt") == name.encode()
        assert storage.local_path("ds") == tmp_path / name / "ds"
    assert (tmp_path / "one" / "ds" / "name.txt").read_text() == "one"


def test_one_process_per_graphics_card(monkeypatch):
    """Set-up: three processes, of which only the variables are made, where two cards may be used.

    Expectation: each has one card, in turn; the commands start as many processes as there are cards.
    """
    seen: list[str] = []

    class Process:
        def __init__(self, **described):
            pass

        def start(self):
            seen.append(os.environ["CUDA_VISIBLE_DEVICES"])

    context = SimpleNamespace(Pipe=multiprocessing.Pipe, Process=Process)
    monkeypatch.setattr(executors.multiprocessing, "get_context", lambda kind: context)
    monkeypatch.setenv("CUDA_VISIBLE_DEVICES", "2,5")
    for place in range(3):
        executors._start(None, place, inline, gpu=True)
    assert seen == ["2", "5", "2"]
    assert os.environ["CUDA_VISIBLE_DEVICES"] == "2,5"
    assert processes_of(None, len(executors.gpus())) == 2
    assert processes_of(3, len(executors.gpus())) == 3


def test_graphics_cards_and_driver_are_part_of_the_environment(tmp_path, monkeypatch):
    """Expectation: their models and driver with CUDA, where the driver tells; nothing with LLVM."""
    monkeypatch.setattr(backend, "choose", lambda variant: backend.Choice(variant, "a test"))
    monkeypatch.setattr(sample, "NVIDIA", tmp_path)
    of = sample.environment.__wrapped__
    assert of("cuda_ad_spectral")["gpu"] == []
    (tmp_path / "version").write_text("NVRM version: NVIDIA Kernel Module  1.2\nGCC version: 3\n")
    for number in range(2):
        folder = tmp_path / "gpus" / str(number)
        folder.mkdir(parents=True)
        (folder / "information").write_text("Model: \t\t NVIDIA Abacus\nIRQ:   \t\t 7\n")
    assert of("cuda_ad_spectral")["gpu"] == ["NVIDIA Abacus", "NVRM version: NVIDIA Kernel Module  1.2"]
    assert "gpu" not in of("llvm_ad_spectral")
