"""The command ``dasim``: parses arguments, calls the library and prints.

Tested in tests/dasim/cli/test_commands.py.
"""

from __future__ import annotations

import os
import signal
import sys
from typing import Any

import cyclopts

from dasim.base.errors import InputError
from dasim.cli import check, datasets, expose, photograph, reconstruct, study

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
    photograph.calibrate,
    reconstruct.recon,
    reconstruct.refocus,
    reconstruct.view,
    reconstruct.score,
    datasets.app,
    study.app,
    check.validate,
    photograph.lens,
    photograph.emva,
):
    app.command(command)
app.command(check.list_, name="list")

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
        status = run(sys.argv[1:])
    except Exception:
        # A library interrupted while loading may raise any exception.
        if not stopped:
            raise
        status = _STOPPED
    sys.exit(128 + stopped[0] if stopped else status)


def run(arguments: list[str]) -> int:
    """Run one command and return its exit status."""
    try:
        return app(arguments, exit_on_error=False, print_error=False, result_action="return_value") or 0
    except InputError as error:
        return _refuse(str(error))
    except cyclopts.CycloptsError as error:
        return _refuse(" ".join(str(error).split()) + " (see 'dasim --help')")
    except BrokenPipeError:  # the reader of the output has closed it
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 128 + signal.SIGPIPE
    except OSError as error:
        return _refuse(f"{error.filename or 'file'}: {error.strerror or error}")
    except KeyboardInterrupt:
        print("dasim: stopped; no incomplete output is left", file=sys.stderr)
        return _STOPPED


def _refuse(message: str) -> int:
    print(f"dasim: {message}", file=sys.stderr)
    return 2
