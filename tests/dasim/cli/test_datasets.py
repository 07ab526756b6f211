"""The commands ``dasim dataset make``, ``verify`` and ``info``, and what they refuse."""

from __future__ import annotations

import json
import os
import re
import shutil
from pathlib import Path

import cv2
import pytest

import dasim
from dasim.base import executors
from dasim.cli import run
from dasim.dataset import plan, storage, verify
from dasim.dataset.specification import load_spec
from tests.support.datasets import WALL, inline, make_dataset, spec_file


@pytest.fixture(scope="module")
def made(renderer, tmp_path_factory) -> Path:
    """A folder with a specification and its dataset ``ds``."""
    folder = tmp_path_factory.mktemp("made")
    make_dataset(spec_file(folder), folder / "ds")
    return folder


@pytest.fixture
def command(monkeypatch, capsys, renderer):
    """Run ``dasim dataset`` in this process; returns exit status, stdout and stderr."""
    monkeypatch.setattr(executors, "local", lambda *_, **options: inline)

    def call(*arguments) -> tuple[int, str, str]:
        status = run(["dataset", *map(str, arguments)])
        printed = capsys.readouterr()
        return status, printed.out, printed.err

    return call


def test_make_verify_info(command, tmp_path):
    spec, out = spec_file(tmp_path), tmp_path / "ds"
    status, output, _ = command("make", spec, "--out", out)
    assert status == 0 and "6 of 6 samples" in output
    assert command("make", spec, "--out", out)[0] == 0
    status, output, _ = command("verify", out)
    assert status == 0 and "no problems" in output
    (out / "README.md").write_text("?")
    status, output, _ = command("verify", out)
    assert status == 1 and "README.md: its checksum differs" in output and "1 problem\n" in output
    status, output, _ = command("info", out, "--plot", tmp_path / "plot.png")
    assert status == 0 and "samples: 6, scenes: 1" in output and "lights: D65 6" in output
    assert cv2.imread(str(tmp_path / "plot.png")).std() > 1
    assert command("info", out, "--plot", tmp_path / "plot.pdf")[0] == 2


def test_finished_dataset_that_lost_a_file_is_not_called_whole(command, tmp_path):
    spec, out = spec_file(tmp_path), tmp_path / "ds"
    command("make", spec, "--out", out)
    lost = next(out.glob("*.tar"))
    lost.unlink()
    status, output, error = command("make", spec, "--out", out)
    assert status == 2 and lost.name in error and "verify" in error and "of 6 samples" not in output


def test_name_with_a_path_stays_below_out(command, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    spec = spec_file(tmp_path)
    spec.write_text(re.sub('name = ".*"', 'name = "../elsewhere"', spec.read_text(), count=1))
    assert command("make", spec)[0] == 0
    assert not (tmp_path / "elsewhere").exists() and len(list((tmp_path / "out").iterdir())) == 1


def test_dry_run_writes_nothing(command, tmp_path):
    spec = spec_file(tmp_path)
    status, output, _ = command("make", spec, "--out", tmp_path / "ds", "--dry-run")
    assert status == 0 and not (tmp_path / "ds").exists()
    assert "train: 6 samples in 3 shards" in output
    assert "exposure.auto_level" in output and "estimate from 3 renders" in output and "MB" in output


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda spec, out: spec.write_text(spec.read_text().replace("spp = 4", "spp = 8")), "spec.spp was 4, now 8"),
        (lambda spec, out: rewrite(out, schema=99), "newer than this dasim knows"),
        (lambda spec, out: rewrite(out, llvm="1.0"), "llvm was"),
        (lambda spec, out: (out / plan.MANIFEST).write_text("{"), "is damaged"),
        (lambda spec, out: (out / plan.MANIFEST).rename(out / "x.json"), "is neither a dataset nor empty"),
        (lambda spec, out: (shutil.rmtree(out), out.write_text("")), "ds"),
    ],
)
def test_folder_of_something_else_is_refused(change, message, command, made, tmp_path):
    out, spec = tmp_path / "ds", tmp_path / "spec.toml"
    shutil.copytree(made, tmp_path, dirs_exist_ok=True)
    change(spec, out)
    before = {path: path.read_bytes() for path in out.rglob("*") if path.is_file()}
    status, _, error = command("make", spec, "--out", out)
    assert status == 2 and message in error and len(error.splitlines()) == 1
    assert {path: path.read_bytes() for path in out.rglob("*") if path.is_file()} == before


def rewrite(out: Path, **changes) -> None:
    manifest = json.loads((out / plan.MANIFEST).read_text())
    (out / plan.MANIFEST).write_text(json.dumps(manifest | changes))


@pytest.mark.parametrize("task", ["verify", "info"])
def test_no_dataset_is_refused(task, command, tmp_path):
    for out in (tmp_path, tmp_path / "nowhere", __file__):
        status, _, error = command(task, out)
        assert status == 2 and "is not a dataset" in error and len(error.splitlines()) == 1
    status, _, error = command(task, "nothing://bucket/ds")
    assert status == 2 and "cannot be opened" in error and len(error.splitlines()) == 1


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (("--shard", "3/2"), "--shard '3/2'"),
        (("--shard", "0/2"), "--shard"),
        (("--shard", "1/2", "--retry"), "--retry"),
        (("--jobs", "0"), "--jobs 0"),
        (("--executor", "slurm"), "slurm"),
        (("--variant", "scalar_rgb"), "scalar_rgb"),
    ],
)
def test_impossible_options_are_refused(options, message, command, tmp_path):
    status, _, error = command("make", spec_file(tmp_path), "--out", tmp_path / "ds", *options)
    assert status != 0 and message in error and not (tmp_path / "ds").exists()


def test_folder_without_permission_is_refused(command, tmp_path):
    """Set-up: a folder without write permission, or a system folder if the user is root."""
    closed = tmp_path / "closed"
    closed.mkdir(mode=0o500)
    out = Path("/proc/dasim") if os.access(closed, os.W_OK) else closed / "ds"
    status, _, error = command("make", spec_file(tmp_path), "--out", out)
    assert status == 2 and "cannot be written" in error and len(error.splitlines()) == 1


def test_a_disk_that_is_too_small_is_reported_before_the_start(command, tmp_path, monkeypatch):
    """The estimate of the size is above the actual size, but not many times."""
    spec = spec_file(tmp_path)
    described = load_spec(spec)
    monkeypatch.setattr(storage, "free_bytes", lambda out: 1000)
    status, _, error = command("make", spec, "--out", tmp_path / "ds")
    assert status == 2 and "6 samples need about" in error and "truth.half" in error
    assert not storage.names(str(tmp_path / "ds")), "another specification may follow in the same folder"
    monkeypatch.undo()
    make_dataset(spec, tmp_path / "ds")
    size = sum(row["bytes"] for row in dasim.open_dataset(tmp_path / "ds").rows) / 6
    assert size < plan.sample_bytes(described) < 4 * size


def test_the_first_samples_are_those_of_the_whole_dataset(tmp_path, renderer):
    """Expectation: the same bytes in the same splits, and a dataset that says so and is complete."""
    spec = spec_file(tmp_path, format="folders", more="[splits]\ntrain = 0.5\ntest = 0.5\n", files=["a.toml", "b.toml"])
    for name in ("a.toml", "b.toml"):
        (tmp_path / name).write_text(WALL)
    make_dataset(spec, tmp_path / "whole")
    spec.write_text("first = 3\n" + spec.read_text())
    make_dataset(spec, tmp_path / "part")
    whole, part = dasim.open_dataset(tmp_path / "whole"), dasim.open_dataset(tmp_path / "part")
    assert len(whole) == 6 and [row["index"] for row in part.rows] == [0, 1, 2]
    for mine, theirs in zip(part.rows, whole.rows, strict=False):
        assert (mine["sha256"], mine["split"], mine["scene"]) == (theirs["sha256"], theirs["split"], theirs["scene"])
    assert not list(verify.problems(str(tmp_path / "part")))
    assert run(["dataset", "make", str(spec), "--out", str(tmp_path / "new"), "--first", "7"]) == 2
