"""Depth methods by name, bundled or a user's, which claims, studies and scores run side by side."""

from __future__ import annotations

import functools
import re
import traceback
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import recon
from dasim.base.errors import InputError
from dasim.base.fingerprint import fingerprint
from dasim.base.loading import load_function
from dasim.base.suggestions import did_you_mean
from dasim.values import Capture, DepthEstimate, PsfBank, Reconstruction
from recon.depth import learned
from recon.depth.method import run_method

NAME = re.compile(r"[A-Za-z][A-Za-z0-9_-]*")  # that a user may give a method of their own

OPTIONAL = {"learned": "recon.depth.learned:estimate"}  # methods of extras; they run where they are asked for by name


@dataclass(frozen=True)
class NamedMethod:
    """A depth method and the name that its figures carry; only the name is sent to other processes.

    ``source`` is ``package.module:function`` or ``file.py:function`` for a user's method, and empty for a bundled one.
    """

    name: str
    source: str = ""

    def __str__(self) -> str:
        """The name."""
        return self.name


def bundled(*names: str) -> tuple[NamedMethod, ...]:
    """Bundled methods of the given names; without names, all of them."""
    return tuple(NamedMethod(name) for name in names or recon.METHODS)


def named(names: Sequence[str]) -> tuple[NamedMethod, ...]:
    """Methods from a user's list: a bundled name, ``package.module:function``, ``file.py:function``, or NAME=FUNCTION.

    Every function is loaded at once, so that a wrong one is refused before the work begins. Raises InputError for a
    name that is unknown or occurs twice.
    """
    methods: list[NamedMethod] = []
    for text in names:
        method = parsed(text)
        if method.name in (other.name for other in methods):
            raise InputError(f"method '{text}': two methods have the name '{method.name}'; give one as NAME={text}")
        if method.source:
            function(method)
        methods.append(method)
    return tuple(methods)


def parsed(text: str) -> NamedMethod:
    """The method of one name, without loading its function; raises InputError if the text is not a method."""
    if text in recon.METHODS:
        return NamedMethod(text)
    if text in OPTIONAL:
        learned.check_installed()
        return NamedMethod(text, OPTIONAL[text])
    name, equals, source = text.partition("=")
    if equals and ":" not in name and "/" not in name:
        if not NAME.fullmatch(name):
            raise InputError(
                f"method '{text}': '{name}' is not a valid name; allowed are letters, digits, - and _, a letter first"
            )
        if name in (*recon.METHODS, *OPTIONAL):
            raise InputError(f"method '{text}': '{name}' is the name of a bundled method; choose another name")
    else:
        name = source = text
    if ":" not in source:
        raise InputError(
            f"method '{text}' is unknown; allowed are {', '.join([*recon.METHODS, *OPTIONAL])}, or your own as "
            f"package.module:function or file.py:function{did_you_mean(text, [*recon.METHODS, *OPTIONAL])}"
        )
    return NamedMethod(name, source)


@functools.cache
def function(method: NamedMethod) -> Callable[[Capture, PsfBank], DepthEstimate]:
    """The function of a method, loaded once per process."""
    return load_function(method.source, "method") if method.source else recon.METHODS[method.name]


def prefix(method: NamedMethod, unnamed: Sequence[NamedMethod]) -> str:
    """Beginning of the ids of a method's figures; empty for the methods ``unnamed``, whose figures carry no method
    name.
    """
    return "" if method in unnamed else f"{method}."


def identity(method: NamedMethod, variant: str) -> list[str]:
    """What a result depends on with this method: its name, and for a user's function the code with all of its imports.

    ``variant`` is the renderer's.
    """
    return [method.name, *([fingerprint(function(method), variant=variant)] if method.source else [])]


def reconstructed(
    capture: Capture, bank: PsfBank, method: NamedMethod, settings: recon.Settings | None = None
) -> Reconstruction:
    """Reconstruct a capture with the depth of a method; a bundled method uses its own preset.

    ``settings`` replace the preset of a bundled method, or the default preset, which the other stages use with a user's
    method. Raises InputError if a user's method raises an exception or returns something other than an estimate of this
    capture.
    """
    if not method.source:
        return recon.reconstruct(capture, bank, settings or recon.PRESETS[method.name])
    return recon.reconstruct(capture, bank, settings or recon.DEFAULT, method=_guarded(function(method)))


def estimated(capture: Capture, bank: PsfBank, method: NamedMethod) -> DepthEstimate:
    """Depth estimate of a method alone, with the checks of :func:`reconstructed`."""
    run = function(method)
    return run_method(_guarded(run) if method.source else run, capture, bank)


def _guarded(method: recon.Method) -> recon.Method:
    """The method with its exceptions converted to an InputError of one line that states where in the user's code they
    arise.
    """

    @functools.wraps(method)
    def guarded(capture: Capture, bank: PsfBank) -> DepthEstimate:
        try:
            return method(capture, bank)
        except InputError:
            raise
        except (Exception, SystemExit) as error:  # a user's sys.exit(0) must not end the command as if it were done
            frames = traceback.extract_tb(error.__traceback__)
            frame = next((f for f in reversed(frames) if "site-packages" not in f.filename), frames[-1])
            place = f"{Path(frame.filename).name}, line {frame.lineno}"
            text = " ".join(str(error).split())
            raise InputError(f"stopped by {type(error).__name__}: {text} ({place})") from error

    return guarded
