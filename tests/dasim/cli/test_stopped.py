"""A command that is stopped in its last moments says what it has left, and a stopped study leaves no empty folder."""

from __future__ import annotations

import subprocess
import sys

import pytest

from dasim import cli, start
from dasim.base import atomic
from validation.studies.sweep.point import Sweep
from validation.studies.sweep.run import sweep
from validation.studies.sweep.specification import StudySpec

END = """
import atexit, os, signal, sys
from dasim import cli
def late():
    os.kill(os.getpid(), signal.{name})
cli.run = lambda arguments: {status}
atexit.register(late)
sys.argv = ["dasim"]
cli.main()
"""


LOADING = """
import os, signal, sys
import {module} as start
class Loader:
    def find_spec(self, name, path=None, target=None):
        if name == "dasim.cli":
            os.kill(os.getpid(), signal.{name})
sys.meta_path.insert(0, Loader())
sys.argv = ["dasim", "list", "scenes"]
start.main()
"""


@pytest.mark.parametrize(("name", "status"), [("SIGINT", 130), ("SIGTERM", 143)])
def test_signal_while_modules_are_loaded(name, status):
    done = subprocess.run(
        [sys.executable, "-c", LOADING.format(name=name, module=start.__name__)], capture_output=True, text=True
    )
    assert (done.returncode, done.stderr) == (status, "dasim: stopped; no incomplete output is left\n")


@pytest.mark.parametrize("is_written", [True, False])
@pytest.mark.parametrize("form", ["{0}", "--out={0}"])
def test_stopped_after_the_output_was_written(is_written, form, tmp_path, monkeypatch, capsys):
    out = tmp_path / "out"

    def command(arguments, **options):
        with atomic.new_folder(out if is_written else tmp_path / "cache"):
            pass
        raise KeyboardInterrupt

    monkeypatch.setattr(cli, "app", command)
    assert cli.run(["recon", "capture", *(["--out"] if form == "{0}" else []), form.format(out)]) == 130
    said = capsys.readouterr().err
    assert said == (
        f"dasim: stopped; {out} was written before and is complete\n"
        if is_written
        else "dasim: stopped; no partly written file is left; datasets, scores and studies continue with the same "
        "command\n"
    )


@pytest.mark.parametrize(("name", "status"), [("SIGINT", 0), ("SIGTERM", 1)])
def test_signal_while_the_process_ends_changes_nothing(name, status):
    done = subprocess.run(
        [sys.executable, "-c", END.format(name=name, status=status)], capture_output=True, text=True, timeout=300
    )
    assert (done.returncode, done.stderr) == (status, "")


@pytest.mark.parametrize("existed", [True, False])
def test_study_that_is_stopped_before_its_first_point_leaves_no_folder(existed, tmp_path):
    """Expectation: a folder that was there before stays."""
    out = tmp_path / "new" / "study"
    if existed:
        out.mkdir(parents=True)
    spec = StudySpec.model_validate({"name": "small", "parameters": {"light.lux": [100.0]}})

    def stopped(job, queue):
        raise KeyboardInterrupt
        yield

    with pytest.raises(KeyboardInterrupt):
        sweep(Sweep(spec, str(out), {"variant": "any"}), stopped, lambda *counts: None)
    assert list(tmp_path.rglob("*")) == ([tmp_path / "new", out] if existed else [])
