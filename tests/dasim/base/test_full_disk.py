"""Every writer on a full disk: the path and the reason in one error, nothing half-written, the earlier result kept."""

from __future__ import annotations

import errno
import os
import resource
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import OpenEXR
import pytest

from dasim.base import atomic
from dasim.files.exr import write_exr
from dasim.files.png import write_png16
from recon.files.reconstruction import write_picture
from validation.gates.junit import write_junit
from validation.gates.outcome import Outcome

NOISE = np.random.default_rng(0).random((40, 50)).astype(np.float32)  # does not compress
FULL = {errno.EFBIG, errno.ENOSPC, errno.EIO}


def _exr(path: Path) -> None:
    header = {"name": "a", "type": OpenEXR.scanlineimage, "compression": OpenEXR.ZIP_COMPRESSION}
    write_exr(path, [OpenEXR.Part(header, {"Z": NOISE})])


def _folder(path: Path) -> None:
    with atomic.new_folder(path) as folder:
        _exr(folder / "truth.exr")
        (folder / "meta.json").write_text("text" * 2000)


WRITERS: dict[str, Callable[[Path], None]] = {
    "text": lambda path: atomic.write(path, "text" * 2000),
    "png16": lambda path: write_png16(path, (NOISE * 65535).astype(np.uint16)),
    "picture": lambda path: write_picture(path, NOISE),
    "junit": lambda path: write_junit(path, [Outcome(f"claim{number}", "", [], 0.0) for number in range(200)], "all"),
    "folder": _folder,
}


@contextmanager
def limited(most_bytes: int) -> Iterator[None]:
    """Files of at most so many bytes, as if the disk were full beyond."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (most_bytes, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


@pytest.mark.parametrize("name", WRITERS)
def test_full_disk_at_any_byte(name, tmp_path):
    out = tmp_path / "out"
    WRITERS[name](out)
    files = {file: file.read_bytes() for file in [out, *out.rglob("*")] if file.is_file()}
    largest = max(map(len, files.values()))
    for most in (0, 1, largest // 2, largest - 1):
        with limited(most), pytest.raises(OSError) as caught:
            WRITERS[name](out)
        assert caught.value.errno in FULL and caught.value.filename == str(out) and caught.value.strerror
        assert list(tmp_path.iterdir()) == [out]
        assert {file: file.read_bytes() for file in files} == files


def test_exr_names_its_file_and_the_reason(tmp_path):
    with limited(100), pytest.raises(OSError, match="File too large") as caught:
        _exr(tmp_path / "a.exr")
    assert caught.value.filename == str(tmp_path / "a.exr") and "\n" not in str(caught.value)


def test_error_of_another_file_keeps_its_name(tmp_path):
    with pytest.raises(FileNotFoundError) as caught, atomic.new_folder(tmp_path / "out"):
        (tmp_path / "none").read_bytes()
    assert caught.value.filename == str(tmp_path / "none")


@pytest.fixture
def tmpfs(tmp_path):
    """A file system of 16 kB; skips where this user cannot mount one."""
    folder = tmp_path / "small"
    folder.mkdir()
    mount = ["mount", "-t", "tmpfs", "-o", "size=16k", "tmpfs", str(folder)]
    if os.geteuid() != 0 or subprocess.run(mount, capture_output=True).returncode != 0:
        pytest.skip("no tmpfs can be mounted")
    yield folder
    subprocess.run(["umount", str(folder)], check=True)


@pytest.mark.parametrize("name", WRITERS)
def test_full_file_system(name, tmpfs):
    """Set-up: all but four kilobytes are taken. Expectation: the error, and nothing left."""
    (tmpfs / "taken").write_bytes(b"1" * 12_000)
    if name in ("junit", "picture"):
        pytest.skip("fits")
    with pytest.raises(OSError) as caught:
        WRITERS[name](tmpfs / "out")
    assert caught.value.filename == str(tmpfs / "out") and caught.value.errno in FULL
    assert [file.name for file in tmpfs.iterdir()] == ["taken"]


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="the system has no /dev/full")
def test_output_that_cannot_be_printed_ends_in_one_line():
    with open("/dev/full", "w") as full:
        command = [sys.executable, "-m", "dasim.cli", "list", "cameras"]
        done = subprocess.run(command, stdout=full, stderr=subprocess.PIPE, text=True)
    assert done.returncode == 2 and done.stderr == "dasim: output: No space left on device\n"
