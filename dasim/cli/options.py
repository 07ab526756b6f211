"""Options, progress bar, checks of output files and lines on captures that the commands share.

Tested in tests/dasim/cli/test_options.py and tests/dasim/cli/test_render.py.
"""

from __future__ import annotations

import re
import sys
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from math import isfinite
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import Parameter

from dasim.base.durations import left_s, words
from dasim.base.errors import InputError, shortened
from dasim.typing import Progress

if TYPE_CHECKING:
    from dasim.values import Capture


@contextmanager
def progress() -> Iterator[Progress]:
    """A progress bar with the time left on a terminal; elsewhere one line per stage."""
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TaskID, TextColumn, TimeRemainingColumn

    console = Console(stderr=True)
    columns = (TextColumn("{task.description:<36}"), BarColumn(), TextColumn("{task.percentage:3.0f} %"))
    tasks: dict[str, TaskID] = {}
    with Progress(*columns, TimeRemainingColumn(), console=console, disable=not console.is_terminal) as bar:

        def update(stage: str, share: float) -> None:
            if stage not in tasks:
                tasks[stage] = bar.add_task(stage, total=1.0)
                if not console.is_terminal:
                    print(stage, file=sys.stderr, flush=True)
            bar.update(tasks[stage], completed=share)

        yield update


@contextmanager
def stages(name: str, expected_s: Mapping[str, float | None]) -> Iterator[Progress]:
    """One progress bar over stages that took ``expected_s`` before, with the time left where all of that is known.

    Elsewhere than on a terminal, one line per stage. A stage that ends before it began was taken from an earlier run.
    """
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn

    console = Console(stderr=True)
    columns = (TextColumn(name), BarColumn(), MofNCompleteColumn(), TextColumn("{task.description}"))
    start, share, remaining = time.monotonic(), dict[str, float](), dict(expected_s)
    with Progress(*columns, console=console, disable=not console.is_terminal) as bar:
        task = bar.add_task("", total=len(expected_s))

        def update(stage: str, part: float) -> None:
            begins = stage not in share
            if begins and part >= 1:
                remaining.pop(stage, None)
            share[stage] = part
            elapsed = time.monotonic() - start
            done = sum(part >= 1 for part in share.values())
            left = left_s(remaining, share, elapsed) if done < len(expected_s) else None
            times = f"{words(elapsed)} so far" + ("" if left is None else f", about {words(left)} left")
            running = ", ".join(stage for stage, part in share.items() if part < 1)
            bar.update(task, completed=done, description=f"{times}; {running}")
            if begins and not console.is_terminal:
                print(f"{stage} ({done} of {len(expected_s)} {name} done, {times})", file=sys.stderr, flush=True)

        yield update


@contextmanager
def counted(name: str) -> Iterator[Callable[[int, int, int], None]]:
    """A progress bar over equal pieces of work, done, all and failed, with the time left at the pace of this run.

    Elsewhere than on a terminal, one line per piece. What is done at the first call was done before.
    """
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn

    console = Console(stderr=True)
    columns = (TextColumn(name), BarColumn(), MofNCompleteColumn(), TextColumn("{task.description}"))
    start, before = time.monotonic(), list[int]()
    with Progress(*columns, console=console, disable=not console.is_terminal) as bar:
        task = bar.add_task("", total=None)

        def show(done: int, total: int, failed: int) -> None:
            ended, elapsed = done + failed, time.monotonic() - start
            before[:] = before or [ended]
            new = ended - before[0]
            times = f", about {words(elapsed / new * (total - ended))} left" if new and ended < total else ""
            status = (f"{words(elapsed)} so far" if new else "") + times + (f", {failed} failed" if failed else "")
            bar.update(task, completed=ended, total=total, description=status)
            if not console.is_terminal:
                print(f"{name}: {done} of {total}" + (f", {status}" if status else ""), file=sys.stderr, flush=True)

        yield show


def whole(kind: Any, tokens: Any) -> int:
    """An option's integer; raises InputError for anything else, such as 1.5."""
    try:
        return int(tokens[0].value)
    except ValueError:
        raise InputError(f"--{tokens[0].keyword.lstrip('-')} '{tokens[0].value}' is not a whole number") from None


def samples(kind: Any, tokens: Any) -> int | str:
    """Number of samples, or auto."""
    if tokens[0].value == "auto":
        return "auto"
    try:
        return whole(kind, tokens)
    except InputError as error:
        raise InputError(f"{error} or auto") from None


Seconds = Annotated[str, Parameter(allow_leading_hyphen=True)]  # see :func:`seconds`
Size = Annotated[str, Parameter(allow_leading_hyphen=True)]  # so that -8x8 is understood, and refused
Whole = Annotated[int, Parameter(converter=whole)]
Out = Annotated[Path, Parameter(name="--out")]
AnyOut = Annotated[Path | None, Parameter(name="--out")]  # whose default depends on what is given


def default_out(source: str | Path, ending: str = "") -> Path:
    """Output of a command without --out: ``out/NAME``, the name of a bundled thing, file or folder, and an ending.

    Examples are ``out/desk``, ``out/staircase-14``, ``out/mine`` for ``scenes/mine.toml``, ``out/desk-recon``.
    """
    path = Path(source)
    name = path.name if path.name not in ("", "..") else path.resolve().name
    stem = name if path.is_dir() else re.sub(r"\.[A-Za-z]\w*$", "", name)
    return Path("out") / (re.sub(r"[^\w.-]+", "-", stem) + ending)


def out_of(name: str, ending: str = "") -> str:
    """Output of a specification's ``name`` without --out: below ``out``, whatever the name is."""
    clean = re.sub(r"[^\w. -]+", "-", name).lstrip(".")
    return f"out/{clean or 'unnamed'}{ending}"


def check_file(option: str, file: Path | None, *endings: str) -> list[str]:
    """What is wrong with a file that shall be written, replacing an earlier one: nothing, or one text."""
    from dasim.files.folders import check_output_file

    if file is None:
        return []
    folder = file.resolve().parent
    if file.suffix.lower() not in endings or file.is_dir() or not folder.is_dir():
        return [f"{option} {file}: is not a file named *{' or *'.join(endings)} in a folder that exists"]
    try:
        check_output_file(file)
    except InputError as error:
        return [f"{option}: {error}"]
    return []


def names(texts: list[str] | None) -> list[str]:
    """Names from texts that may hold several, separated by commas."""
    return [name.strip() for text in texts or () for name in text.split(",") if name.strip()]


def check_new_file(path: Path, option: str) -> None:
    """Raise InputError if a file exists already or cannot be written, before the work begins."""
    from dasim.files.folders import check_output_file

    if path.exists():
        raise InputError(f"{option} {path}: exists; choose another name")
    if not path.resolve().parent.is_dir():
        raise InputError(f"{option} {path}: the folder {path.resolve().parent} does not exist")
    check_output_file(path)


def size(text: str) -> tuple[int, int]:
    """Width and height in px from WxH."""
    width, _, height = text.partition("x")
    if not all(number.isascii() and number.isdecimal() and len(number) < 10 for number in (width, height)):
        raise InputError(f"--size {shortened(text)} is not of the form WxH with whole numbers above 0, such as 768x576")
    return int(width), int(height)


def seconds(option: str, text: str, *others: str) -> float:
    """A time in seconds from text such as 0.02 or 1/60; ``others`` are what the option allows besides."""
    above, slash, below = text.partition("/")
    try:
        return float(above) / (float(below) if slash else 1.0)
    except (ValueError, ZeroDivisionError):
        allowed = ", or ".join(("seconds, such as 0.02 or 1/60", *others))
        raise InputError(f"{option} {shortened(text)}: must be {allowed}") from None


def place(option: str, text: str) -> tuple[float, float]:
    """A place of the field in px from X,Y."""
    try:
        x, y = (float(number) for number in text.split(","))
        if not (isfinite(x) and isfinite(y)):
            raise ValueError
    except ValueError:
        raise InputError(
            f"{option} {shortened(text)} is not of the form X,Y with numbers of pixels, such as 900,-600"
        ) from None
    return x, y


def definitions(texts: list[str]) -> dict[str, str]:
    """Values by name from texts of the form name=value."""
    values: dict[str, str] = {}
    for text in texts:
        name, equals, value = text.partition("=")
        if not name or not equals:
            raise InputError(f"--define '{text}' is not of the form name=value, such as spp=64")
        if name in values:
            raise InputError(f"--define {name}: has two values, '{values[name]}' and '{value}'; give one")
        values[name] = value
    return values


def say_variant(variant: str | None) -> None:
    """Print which variant of the renderer is used, and why."""
    from dasim.render import backend

    print(f"renderer: {backend.choose(variant).reason}", file=sys.stderr, flush=True)


def print_capture(capture: Capture, out: Path) -> None:
    """Print the notes on a simulated capture, its rendering noise, and where it was written."""
    for note in capture.provenance["notes"]:
        print(f"note: {note}")
    for at, by_channel in capture.provenance.get("rendering_noise_share", {}).items():
        listed = ", ".join(f"{name} {share:.2f}" for name, share in by_channel.items())
        print(f"rendering noise over sensor noise, percentile {at:>4} of the pixels: {listed}")
    print(f"capture: {out} ({capture.exposure_s * 1e3:.3g} ms)")
