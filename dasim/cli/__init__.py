"""The command ``dasim``: parses arguments, calls the library and prints."""

from __future__ import annotations

import os
import signal
import sys
from contextlib import suppress
from pathlib import Path
from typing import Any

import cyclopts

from dasim.base import atomic
from dasim.base.errors import InputError, one_line
from dasim.cli import (
    calibrate,
    check,
    datasets,
    export,
    expose,
    learn,
    listing,
    photograph,
    reconstruct,
    score,
    study,
    view,
)

app = cyclopts.App(
    name="dasim",
    help="Simulate dual-aperture photography, reconstruct depth and an all-in-focus picture, and score both.",
    version_flags=["--version"],
    suppress_keyboard_interrupt=False,  # run() reports it, and main() knows the signal
)

for command in (
    check.demo,
    photograph.render,
    expose.expose,
    export.export,
    calibrate.calibrate,
    reconstruct.recon,
    reconstruct.refocus,
    view.view,
    score.score,
    datasets.app,
    study.app,
    learn.app,
    check.validate,
    listing.camera,
    photograph.lens,
    photograph.emva,
):
    app.command(command)
app.command(listing.list_, name="list")

_STOPPED = 130


def main() -> None:
    """Entry point; exit status 0: done, 1: a gate failed, 2: wrong input, 128 + signal: stopped."""
    stopped: list[int] = []

    def stop(number: int, frame: Any) -> None:
        stopped.append(number)
        raise KeyboardInterrupt

    for name in (signal.SIGINT, signal.SIGTERM):
        signal.signal(name, stop)
    try:
        try:
            status = run(sys.argv[1:])
        finally:  # what comes now is the end of the process
            for name in (signal.SIGINT, signal.SIGTERM):
                signal.signal(name, signal.SIG_IGN)
    except KeyboardInterrupt:  # between the end of the command and the line above
        status = _STOPPED
    except Exception:
        # A library interrupted while loading may raise any exception.
        if not stopped:
            raise
        status = _STOPPED
    sys.exit(128 + stopped[0] if stopped else status)


def run(arguments: list[str]) -> int:
    """Run one command and return its exit status."""
    try:
        status = app(arguments, exit_on_error=False, print_error=False, result_action="return_value") or 0
        sys.stdout.flush()  # here, where a full disk can be reported
        return status
    except InputError as error:
        return _refuse(str(error))
    except cyclopts.CycloptsError as error:
        command = " ".join(("dasim", *(error.command_chain or ())))
        return _refuse(f"{' '.join(str(error).split())} (see '{command} --help')")
    except BrokenPipeError:  # the reader of the output has closed it
        _discard_output()
        return 128 + signal.SIGPIPE
    except OSError as error:
        if error.filename is None:
            _discard_output()  # that could not be written
        return _refuse(f"{error.filename or 'output'}: {error.strerror or error}")
    except KeyboardInterrupt:
        print(f"dasim: stopped; {_left(arguments)}", file=sys.stderr)
        return _STOPPED


def _left(arguments: list[str]) -> str:
    """What a stopped command has left: the output that its arguments name where it is complete, or nothing."""
    last = atomic.last_written()
    for argument in arguments:
        name = argument.rpartition("=")[2] if argument.startswith("--") else argument
        if last is not None and name and Path(name).resolve() == last.resolve():
            return f"{name} was written before and is complete"
    return "no partly written file is left; datasets, scores and studies continue with the same command"


def _discard_output() -> None:
    """Let what is still to be printed go nowhere, so that the interpreter ends without a message of its own."""
    with suppress(OSError, ValueError):  # a captured output has no number
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def _refuse(message: str) -> int:
    print(f"dasim: {one_line(message)}", file=sys.stderr)
    return 2
