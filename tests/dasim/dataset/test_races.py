"""Runs, kills and restarts of several processes on one dataset end in the dataset of an undisturbed run."""

from __future__ import annotations

import os
import random
import shutil
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest

from dasim.base.errors import InputError
from dasim.dataset import card, plan, storage, verify
from dasim.dataset.make import make
from dasim.dataset.sample import Job, PackedSample
from dasim.dataset.specification import DatasetSpec, load_spec
from dasim.dataset.work import work
from tests.support.datasets import inline, spec_file, sums

SAMPLES = 6
ENVIRONMENT = {"variant": "none", "libraries": {"dasim": "0"}, "code": "0"}


def stub(spec: DatasetSpec, index: int, variant: str) -> PackedSample:
    """Bytes in place of a rendered sample, after a pause of at most 2 ms."""
    time.sleep(random.random() * 2e-3)
    group = next(group for group in plan.shards(spec) if index in group.indices)
    files = {name: f"{name} of {index}".encode() * 40 for name in ("raw.png", "truth.exr", "meta.json")}
    row = {"index": index, "key": f"{index:09d}", "split": group.split, "scene": f"{index}", "sha256": {}}
    return PackedSample(files, row, 0.0, 0.0)


def table(rows: list[dict]) -> bytes:
    """The shards and samples of an index, in place of its Parquet file."""
    return repr([(row["index"], row["shard"]) for row in rows]).encode()


STUBS = {
    "dasim.dataset.sample.make": stub,
    "dasim.dataset.sample.activate": lambda variant: None,
    "dasim.dataset.sample.provenance": lambda variant: ENVIRONMENT,
    "dasim.dataset.card.table": table,
    "dasim.dataset.card.contact_sheet": lambda rows: b"sheet",
    "dasim.dataset.card.card": lambda *about: "card",
}


@pytest.fixture
def stubbed(monkeypatch):
    for name, value in STUBS.items():
        monkeypatch.setattr(name, value)


def run_of(spec: Path, out: Path, **options) -> object:
    """A run that makes stubs in this process."""
    described = load_spec(spec)
    plan.begin(str(out), plan.description(described, ENVIRONMENT))
    return make(Job(described, str(out), ENVIRONMENT), inline, **options)


def strays(out: Path) -> list[str]:
    """Problems with the list of checksums of a finished dataset."""
    assert (out / plan.SUMS).exists()
    return list(verify._files(str(out)))


def test_second_run_of_the_same_samples_is_refused(tmp_path, stubbed):
    """Set-up: another process holds the claim on the last shard. Expectation: one line that says what to do."""
    spec, out = spec_file(tmp_path, samples=SAMPLES), tmp_path / "ds"
    described = load_spec(spec)
    plan.begin(str(out), plan.description(described, ENVIRONMENT))
    last = len(plan.shards(described)) - 1
    hold = "import fcntl, sys; f = open(sys.argv[1], 'ab'); fcntl.lockf(f, fcntl.LOCK_EX, 1, int(sys.argv[2])); "
    hold += "print(flush=True); sys.stdin.read()"
    command = [sys.executable, "-c", hold, str(out / plan.CLAIMS), str(last)]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as other:
        assert other.stdout is not None
        other.stdout.readline()
        with pytest.raises(InputError, match=r"another run is making the same samples; .* --shard K/N"):
            run_of(spec, out)
        other.communicate()
    run_of(spec, out)
    assert strays(out) == []


def test_part_of_a_killed_run_after_the_end_is_removed(tmp_path, stubbed):
    """Set-up: the worker of a killed run finishes its sample after another run has finished the dataset."""
    spec, out = spec_file(tmp_path, samples=SAMPLES), tmp_path / "ds"
    run_of(spec, out)
    job = Job(load_spec(spec), str(out), ENVIRONMENT)
    assert work(job, 4).error is None
    assert strays(out) == [] and not list(out.glob("parts/*"))


def test_removal_of_a_folder_that_fills_meanwhile(tmp_path):
    """Set-up: a thread writes into a folder while it is removed. Expectation: no error."""
    end = time.monotonic() + 0.3
    errors: list[BaseException] = []

    def fill() -> None:
        number = 0
        while time.monotonic() < end:
            number += 1
            try:
                storage.write(str(tmp_path), f"parts/{number}.tar", b"part")
            except (FileNotFoundError, FileExistsError):  # its folder was removed between two calls
                time.sleep(0)
            except BaseException as error:
                errors.append(error)

    thread = threading.Thread(target=fill)
    thread.start()
    while time.monotonic() < end:
        card.tidy(str(tmp_path))
        time.sleep(0.005)
    thread.join()
    assert errors == []


def test_sweep_of_folders_that_vanish(tmp_path):
    """Set-up: a thread makes and removes folders while unfinished files are swept. Expectation: no error."""
    end = time.monotonic() + 0.3

    def change() -> None:
        while time.monotonic() < end:
            for number in range(20):
                (tmp_path / f"{number}" / "inner").mkdir(parents=True, exist_ok=True)
            for number in range(20):
                shutil.rmtree(tmp_path / f"{number}", ignore_errors=True)

    thread = threading.Thread(target=change)
    thread.start()
    while time.monotonic() < end:
        storage.sweep(str(tmp_path))
    thread.join()


PROGRAM = """
import os, random, signal, sys, time
from pathlib import Path
from dasim.base.errors import InputError
from tests.dasim.dataset import test_races as t
import importlib
for name, value in t.STUBS.items():
    module, _, attribute = name.rpartition(".")
    setattr(importlib.import_module(module), attribute, value)
spec, folder, rounds, seed = Path(sys.argv[1]), Path(sys.argv[2]), int(sys.argv[3]), int(sys.argv[4])
def child(out, part, seed):
    process = os.fork()
    if process:
        return process
    random.seed(seed)
    try:
        t.run_of(spec, out, shard=part)
        os._exit(0)
    except InputError as error:
        print(error, file=sys.stderr, flush=True)
        os._exit(2 if "another run" in str(error) else 3)
    except BaseException:
        import traceback
        traceback.print_exc()
        os._exit(4)
for number in range(rounds):
    random.seed(seed + number)
    out = folder / str(number)
    parts = random.choice([[(1, 1)] * 3, [(1, 2), (2, 2), (1, 1)], [(1, 3), (2, 3), (3, 3), (2, 2)]])
    runs = [child(out, part, random.random()) for part in parts]
    time.sleep(random.random() * 0.05)
    for run in random.sample(runs, random.randint(0, len(runs))):
        os.kill(run, signal.SIGKILL)
    ends = [os.waitstatus_to_exitcode(os.waitpid(run, 0)[1]) for run in runs]
    assert set(ends) <= {0, 2, -signal.SIGKILL}, (number, parts, ends)
    if (out / "SHA256SUMS").exists():
        assert t.strays(out) == [], (number, parts, ends, t.strays(out))
    t.run_of(spec, out)
    assert t.strays(out) == [], (number, parts, ends, t.strays(out))
    if number == 0:
        first = t.sums(out)
    assert t.sums(out) == first, (number, parts, ends)
"""


@pytest.mark.parametrize("rounds", [4, pytest.param(400, marks=pytest.mark.slow)])
def test_interleaved_runs_and_kills(rounds, tmp_path):
    """Set-up: three or four processes at once on one folder, with the same or overlapping parts, of which some are
    killed at random; then one more run.

    Expectation: every run ends well or is refused; a finished dataset has no stray files at any time; the checksums
    are always the same.
    """
    spec = spec_file(tmp_path, samples=SAMPLES, top="seed = 1")
    command = [sys.executable, "-c", PROGRAM, str(spec), str(tmp_path), str(rounds), "0"]
    path = os.pathsep.join([str(Path(__file__).parents[3]), *filter(None, sys.path)])
    done = subprocess.run(command, env=os.environ | {"PYTHONPATH": path}, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr[-3000:]
    assert sums(tmp_path / "0")
