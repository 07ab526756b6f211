"""One damaged file read in a process of its own, and what is wrong with how that ended."""

from __future__ import annotations

import contextlib
import faulthandler
import io
import math
import os
import resource
import signal
import sys
import tempfile
import time
import traceback
from pathlib import Path
from typing import NamedTuple

import numpy as np

from dasim.base.errors import InputError, one_line
from tests.fuzz import mutations
from tests.fuzz.subjects import SUBJECTS, Subject

HANG_S = 20.0  # processor time of a case
WAIT_S = 120.0  # that a case may take on a busy computer; one that waits for ever takes no processor time
MEMORY = 4 << 30  # bytes beyond those of the process that starts a case
STATUSES = (0, 1, 2, 130, 143)
TRACEBACK = 99  # exit status of a case that ended in a traceback
LONGEST = 8000  # characters of a message
POLL_S = 0.002


class Failure(NamedTuple):
    """A case that did not end well."""

    number: int
    subject: str
    what: str


def case(folder: Path, seed: int, number: int) -> Failure | None:
    """Run case ``number`` of a seed on the files below ``folder`` (:func:`tests.fuzz.subjects.write`)."""
    random = np.random.default_rng((seed, number))
    subject = SUBJECTS[number % len(SUBJECTS)]
    here = folder / subject.name
    name = subject.files[int(random.integers(len(subject.files)))]
    valid = (here / name).read_bytes()
    (here / name).write_bytes(mutations.damaged(random, name, valid))
    try:
        before = contents(here)
        what = problem(subject, here)
        if what is None and contents(here) != before:
            what = "a file of the input was changed, left or removed"
        return None if what is None else Failure(number, subject.name, what)
    finally:
        (here / name).write_bytes(valid)


def contents(folder: Path) -> dict[str, bytes]:
    """Content of all files below a folder by name."""
    return {str(path): path.read_bytes() for path in sorted(folder.rglob("*")) if path.is_file()}


def problem(subject: Subject, folder: Path) -> str | None:
    """What is wrong with how a subject reads its files in a process of its own; None where all is well."""
    with tempfile.TemporaryFile() as said_by:
        process = os.fork()
        if not process:
            _child(subject, folder, said_by.fileno())
        status = _end(process)
        said_by.seek(0)
        message = said_by.read().decode(errors="replace")
    if status is None or (os.WIFSIGNALED(status) and os.WTERMSIG(status) == signal.SIGXCPU):
        return f"hangs for more than {HANG_S:g} s"
    code = os.waitstatus_to_exitcode(status)
    if code not in STATUSES:
        return f"exit status {code}: {message[-1500:]}"
    if code != 2:
        return None
    said = [line for line in message.splitlines() if line.strip()]
    if len(said) != 1 or len(message) > LONGEST or not said[0].isprintable():
        return f"a message that is not one printable line: {message[:500]!r}"
    if not any(name in said[0] for name in (str(folder), *(Path(file).name for file in subject.files))):
        return f"a message without the file: {said[0][:500]}"
    return None


def _end(process: int) -> int | None:
    """Status of a process when it ends; None where it was killed after ``WAIT_S``."""
    end = time.monotonic() + WAIT_S
    while time.monotonic() < end:
        done, status = os.waitpid(process, os.WNOHANG)
        if done:
            return status
        time.sleep(POLL_S)
    os.kill(process, signal.SIGKILL)
    os.waitpid(process, 0)
    return None


def _child(subject: Subject, folder: Path, report: int) -> None:
    """Read the files of a subject as the command line does, and end this process; ``report`` gets all messages."""
    code = TRACEBACK
    os.dup2(report, 2)  # for libraries of C, too
    sys.stderr = os.fdopen(2, "w", buffering=1, errors="replace", closefd=False)
    faulthandler.disable()  # the status says enough
    try:
        for number, handler in ((signal.SIGINT, signal.SIG_DFL), (signal.SIGTERM, signal.SIG_DFL)):
            signal.signal(number, handler)
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        resource.setrlimit(resource.RLIMIT_CPU, (math.ceil(HANG_S), math.ceil(2 * HANG_S)))  # SIGXCPU, then SIGKILL
        if sys.platform == "linux":
            pages = int(Path("/proc/self/statm").read_text().split()[0])
            resource.setrlimit(resource.RLIMIT_AS, (pages * resource.getpagesize() + MEMORY,) * 2)
        with contextlib.redirect_stdout(io.StringIO()):
            try:
                status = subject.read(folder)
                code = status if isinstance(status, int) else 0
            except InputError as error:
                print(one_line(str(error)), file=sys.stderr)
                code = 2
    except BaseException:
        traceback.print_exc()
    sys.stderr.flush()
    os._exit(code)
