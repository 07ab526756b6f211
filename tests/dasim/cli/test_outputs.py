"""What the commands do where an output exists already, and when they are interrupted."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest

from dasim.cli import run
from recon.files.reconstruction import load_reconstruction
from tests.support.commands import RENDER

WRITERS = [RENDER[:-1], ("recon", "shot", "--bank", "bank.npz", "--out"), ("demo", "--out")]
each_writer = pytest.mark.parametrize("command", WRITERS, ids=lambda command: command[0])
SIGINT_DEADLINE_S = 180.0  # for start, import and stop together, on a busy computer
INTERRUPTED = 130  # 128 + SIGINT, as shells say it


@each_writer
def test_output_that_is_a_file_is_refused(refused, command):
    refused(*command, "mine.toml", message_part=("mine.toml", "is a file"))
    refused(*command, "mine.toml/new", message_part=("mine.toml/new", "folder"))


@pytest.mark.parametrize(
    "command",
    [
        ("score", "result", "shot", "--json", "/proc/score.json"),
        ("score", "result", "shot", "--junit", "/proc/score.xml"),
        ("calibrate", "--out", "/proc/bank.npz"),
        ("calibrate", "--out", "mine.toml/bank.npz"),
        ("validate", "--quick", "--seeds", "2", "--propose-gates", "/proc/gates.toml"),
    ],
    ids=lambda command: f"{command[0]} {command[-2]}",
)
def test_a_file_that_cannot_be_written_is_refused_before_the_work(refused, command):
    """Rationale: folders that permissions allow can be read-only all the same, such as /proc to root."""
    refused(*command, message_part=(command[-1], "is not a folder that can be written to"))


@each_writer
@pytest.mark.parametrize("extra", [None, "meta.json", "results.json"])
def test_folder_with_foreign_files_is_never_touched(refused, here, command, extra):
    """Rationale: results.json and meta.json are common names; a folder that has one is not therefore ours to delete."""
    (here / "thesis").mkdir()
    (here / "thesis" / "thesis.txt").write_text("ten years of work")
    if extra:
        (here / "thesis" / extra).write_text('{"accuracy": 0.9}')
    refused(*command, "thesis", message_part=("thesis", "dasim did not write"))


def test_notes_beside_a_capture_are_not_deleted(refused, here):
    (here / "shot" / "notes.txt").write_text("seen at noon")
    refused(*RENDER[:-1], "shot", message_part=("shot", "dasim did not write"))


def test_a_command_does_not_replace_its_own_input(refused):
    refused("recon", "shot", "--bank", "bank.npz", "--out", "shot", message_part=("shot",))


def test_a_result_of_another_kind_is_not_replaced(refused):
    """Rationale: a photograph that took hours must not vanish under a reconstruction's name."""
    refused(*RENDER[:-1], "result", message_part=("result",))


@each_writer
def test_working_folder_itself_is_written_or_refused_before_work(refused, here, command, monkeypatch):
    """Expectation: what cannot be replaced is refused at once, not after the work."""
    arguments = [str(here / part) if part in ("shot", "bank.npz") else part for part in command]
    (here / "empty").mkdir()
    monkeypatch.chdir(here / "empty")
    refused(*arguments, ".", message_part=("output",))


def test_outputs_by_default(here, capsys):
    """Expectation: in the folder out, by the names of what is given; view finds a reconstruction's capture there."""
    shutil.copytree("shot", "out/shot")
    assert run(["recon", "out/shot", "--bank", "bank.npz"]) == 0
    assert run(["refocus", "out/shot-recon", "--depth", "0.2", "--bank", "bank.npz"]) == 0
    assert run(["export", "shot"]) == 0
    assert run(["expose", "shot", "--scale", "0.5"]) == 0
    names = {path.name for path in (here / "out").iterdir()}
    assert names == {"shot", "shot-recon", "shot-recon-0.2m.png", "shot.dng", "shot-linear.dng", "shot-exposed"}
    capsys.readouterr()
    assert run(["view", "out/shot-recon", "--bank", "bank.npz", "--slices", "2"]) == 0
    assert "no capture found" not in capsys.readouterr().out and (here / "out" / "shot-recon-view.html").is_file()


@pytest.mark.parametrize("target", ["target", "nowhere"])
def test_link_as_output_leaves_no_litter(here, target):
    """Expectation: the command works or is refused; either way nothing hidden stays beside the output."""
    (here / "target").mkdir()
    (here / "link").symlink_to(target)
    status = run(["recon", "shot", "--bank", "bank.npz", "--out", "link"])
    if status == 0:
        assert load_reconstruction(here / "link").light == "D55"
    else:
        assert status == 2 and (here / "link").is_symlink()
    assert not [p.name for p in here.iterdir() if p.name.startswith(".")]


def interrupted(arguments: list[str], folder: Path, environment: dict[str, str], after: str) -> tuple[int, str]:
    """Start a command, send SIGINT once ``after`` stands on stderr, and return exit status and stderr."""
    command = [sys.executable, "-m", "dasim.cli", *arguments]
    started = subprocess.Popen(command, cwd=folder, env=environment, stderr=subprocess.PIPE, stdout=subprocess.DEVNULL)
    watchdog = threading.Timer(SIGINT_DEADLINE_S, started.kill)
    watchdog.start()
    lines: list[str] = []
    with started as process:
        try:
            assert process.stderr is not None
            for line in process.stderr:
                lines.append(line.decode())
                if after in lines[-1]:
                    time.sleep(0.5)  # into the work of this stage
                    process.send_signal(signal.SIGINT)
        finally:
            watchdog.cancel()
            if process.poll() is None and not lines:
                process.kill()
    return process.returncode, "".join(lines)


@pytest.fixture
def environment(renderer):
    """Of a process of its own, with the user's cache for the choice of renderer."""
    return os.environ | {"DASIM_VARIANT": renderer, "PYTHONUNBUFFERED": "1"}


@pytest.mark.slow
def test_interrupt_leaves_no_partial_capture(tmp_path, environment):
    arguments = ["render", "desk", "--size", "512x384", "--spp", "128", "--out", "photos/one"]
    status, printed = interrupted(arguments, tmp_path, environment, "rendering through stop")
    assert status == INTERRUPTED, printed
    assert "Traceback" not in printed
    assert not list(tmp_path.rglob("*one*")), "a partial folder stays"


@pytest.mark.slow
def test_interrupt_leaves_no_partial_demo(tmp_path, environment):
    """Rationale: the demo's folder is filled from the first stage on, under a temporary name."""
    arguments = ["demo", "--spp", "64", "--out", "demo"]
    status, printed = interrupted(arguments, tmp_path, environment, "rendering through stop")
    assert status == INTERRUPTED, printed
    assert "Traceback" not in printed
    assert not list(tmp_path.iterdir()), "a partial folder stays"
