"""Making datasets: the same bytes in any order and in parts, and samples that cannot be made."""

from __future__ import annotations

import json
import threading
from collections import Counter

import pytest

from dasim.base import executors
from dasim.base.errors import InputError
from dasim.cli import run
from dasim.dataset import plan, sample, verify, work
from dasim.dataset.make import TRIES
from dasim.dataset.specification import load_spec
from dasim.render import backend
from tests.support.datasets import (
    MESH,
    SAMPLES,
    SQUARE,
    WALL,
    backwards,
    deadly,
    finished_sums,
    inline,
    log_entries,
    make_dataset,
    spec_file,
)


def test_another_order_makes_the_same_bytes(spec, undisturbed, tmp_path):
    make_dataset(spec, tmp_path / "ds", backwards)
    assert finished_sums(tmp_path / "ds") == undisturbed


def test_runs_of_a_part_each_make_the_same_bytes(spec, undisturbed, tmp_path, remembered):
    for part in (2, 3, 1):
        done = make_dataset(spec, tmp_path / "ds", shard=(part, 3))
        assert done.failed == {} and done.done == done.total
        assert (tmp_path / "ds" / plan.SUMS).exists() == (part == 1)
    assert finished_sums(tmp_path / "ds") == undisturbed


def test_runs_side_by_side_make_the_same_bytes(spec, undisturbed, tmp_path, remembered):
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
        assert finished_sums(out) == undisturbed


@pytest.mark.slow
def test_workers_that_crash_cost_their_own_sample_alone(spec, undisturbed, tmp_path):
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
    assert finished_sums(out) == undisturbed


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
    assert run(["dataset", "export", str(out), "--as", "croissant"]) == 0
    assert run(["dataset", "make", str(spec), "--out", str(out), "--retry"]) == 0
    assert not (out / "croissant.json").exists(), "its checksums are those of before"
    assert Counter(log_entries(out)) == {
        **{(index, True): 1 for index in range(4)},
        **{(1, False): 1, (3, False): 1},
    }
    make_dataset(spec, tmp_path / "straight")
    assert finished_sums(out) == finished_sums(tmp_path / "straight")


def test_full_temporary_folder_is_nobodys_sample(spec, tmp_path, monkeypatch):
    monkeypatch.setattr(sample, "make", lambda *arguments: 1 / 0)
    monkeypatch.setattr(work, "SCRATCH_BYTES", 1e30)
    with pytest.raises(InputError, match=r"temporary folder .* is full; finished samples are stored"):
        make_dataset(spec, tmp_path / "ds")
    assert not list((tmp_path / "ds").rglob("failed/*"))


def test_worker_with_other_libraries_makes_nothing(spec, tmp_path, monkeypatch):
    """Pixels would differ, so that the run ends before the first sample is written."""
    monkeypatch.setattr(sample, "provenance", lambda variant: {"variant": variant, "llvm": "0", "cpu": "abacus"})
    with pytest.raises(InputError, match="this worker differs from the dataset in llvm, cpu"):
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
