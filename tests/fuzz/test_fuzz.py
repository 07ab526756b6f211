"""The fuzzer: valid files are read, damaged ones end well, and what it looks for is found."""

from __future__ import annotations

import os
import signal
import time
from pathlib import Path

import pytest

from dasim.base.errors import InputError
from tests.fuzz import runner, subjects
from tests.fuzz.subjects import SUBJECTS, Subject

CASES = 40


@pytest.fixture(scope="module")
def files(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("fuzz")
    subjects.write(folder)
    return folder


@pytest.mark.slow
def test_valid_files_are_read(files):
    for subject in SUBJECTS:
        if subject.name != "reconstruction":  # whose EXR file is that of a truth
            status = subject.read(files / subject.name)
            assert not isinstance(status, int) or status == 0, subject.name


@pytest.mark.slow
def test_damaged_files_end_well(files):
    assert [failure for number in range(CASES) if (failure := runner.case(files, 1, number))] == []


def refused(message: str) -> None:
    raise InputError(message)


@pytest.mark.parametrize(
    ("read", "what"),
    [
        (lambda folder: 1 / 0, "ZeroDivisionError"),
        (lambda folder: os.kill(os.getpid(), signal.SIGSEGV), "exit status -11"),
        (lambda folder: time.sleep(9), "hangs"),
        (lambda folder: any(iter(int, 1)), "hangs"),
        (lambda folder: bytearray(6 << 30), "MemoryError"),
        (lambda folder: 7, "exit status 7"),
        (lambda folder: refused("is wrong"), "without the file"),
        (lambda folder: refused("a.toml: is wrong"), None),
        (lambda folder: 0, None),
    ],
)
def test_bad_ends_are_found(read, what, tmp_path, monkeypatch):
    monkeypatch.setattr(runner, "HANG_S", 1.0)
    monkeypatch.setattr(runner, "WAIT_S", 3.0)
    found = runner.problem(Subject("a", ("a.toml",), read), tmp_path)
    assert found is None if what is None else found is not None and what in found


def test_files_left_are_found(tmp_path, monkeypatch):
    (tmp_path / "a").mkdir()
    (tmp_path / "a" / "a.toml").write_text("a = 1\n")
    subject = Subject("a", ("a.toml",), lambda folder: (folder / "left").write_text("x") and None)
    monkeypatch.setattr(runner, "SUBJECTS", (subject,))
    failure = runner.case(tmp_path, 0, 0)
    assert failure is not None and "left" in failure.what
