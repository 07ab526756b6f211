"""The command expose.

Tested in tests/dasim/cli/test_expose.py.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

from dasim.base.errors import InputError
from dasim.cli import options
from dasim.cli.options import AnyOut, Whole, seconds
from dasim.typing import Progress

if TYPE_CHECKING:
    from dasim.camera.noise import Exposure
    from dasim.simulation.exposure import Shot
    from dasim.values import Capture, Truth


def expose(
    capture: Path,
    *,
    out: AnyOut = None,
    time: str | None = None,
    lux: float | None = None,
    scale: float = 1.0,
    gain: float | None = None,
    seed: Whole | None = None,
    frames: Whole = 1,
    noise: str | None = None,
) -> int:
    """Expose a rendered capture again, without rendering: another time, light level, gain or noise.

    Several times or frames make a series: a folder with the captures 000, 001, ... and series.json.

    Args:
        capture: a capture folder with its truth
        out: output capture folder, or folder of a series; out/CAPTURE-exposed by default
        time: exposure time in seconds, such as 0.02 or 1/60, or several for a bracket, such as 1/250,1/60,1/15; auto
            for the automatic one. By default that of the capture; an automatic one is chosen anew
        lux: illuminance of all lights of the scene together, each changed by the same factor
        scale: factor on the illuminance of all lights instead, also those of a Mitsuba scene
        gain: analogue gain; by default that of the capture
        seed: seed of the temporal noise of the first frame; by default that of the capture
        frames: frames of a burst at each time, with independent noise
        noise: your own noise model, package.module:function or file.py:function
    """
    import dasim
    from dasim.base.loading import load_function
    from dasim.files.captures import save_series
    from dasim.files.folders import MOST_IN_SERIES, check_output
    from dasim.simulation.exposure import exposure_of

    exposures = exposures_of(exposure_of(dasim.load_capture(capture)), time, gain)
    count = len(exposures) * frames
    if count > MOST_IN_SERIES:
        raise InputError(f"--time, --frames: {count} captures; at most {MOST_IN_SERIES} are allowed")
    single = count == 1
    out = options.default_out(capture, "-exposed") if out is None else out
    check_output(out, "capture" if single else "series of captures")
    if out.resolve() == capture.resolve():
        raise InputError(f"--out {out}: is the capture itself; name another folder")
    model = None if noise is None else load_function(noise, "noise model")
    shots = dasim.expose_series(capture, exposures, frames=frames, lux=lux, scale=scale, seed=seed, noise=model)
    if single:
        result = next(shots)
        dasim.save_capture(out, result.capture, result.truth)
        options.print_capture(result.capture, out)
        return 0
    with options.progress() as progress:
        save_series(out, _reported(shots, count, out, progress))
    print(f"series: {out} ({count} captures)")
    return 0


def _reported(
    shots: Iterator[Shot], count: int, out: Path, progress: Progress
) -> Iterator[tuple[Capture, Truth | None]]:
    """Capture and truth of each shot of a series; prints a line on each capture, and each note once."""
    notes: set[str] = set()
    for number, shot in enumerate(shots):
        progress("exposing", number / count)
        yield shot.capture, shot.truth
        capture = shot.capture
        print(f"{number:03d}: {capture.exposure_s * 1e3:.3g} ms, gain {capture.gain:g}, seed {capture.seed}")
        for note in capture.provenance["notes"]:
            if note not in notes:
                print(f"note: {number:03d}: {note}")
            notes.add(note)
    progress("exposing", 1.0)


def exposures_of(kept: Exposure, time: str | None, gain: float | None) -> list[Exposure]:
    """The exposures that the options ask for; ``kept`` is that of the capture."""
    from dasim.base.toml import parse
    from dasim.camera.noise import Exposure

    gain = kept.gain if gain is None else gain
    automatic = kept.model_dump() | {"time_s": None, "gain": gain}
    if time is None:
        return [parse(Exposure, automatic | {"time_s": kept.time_s}, "--gain")]
    data = [
        automatic if text == "auto" else {"time_s": seconds("--time", text, "auto"), "gain": gain}
        for text in time.split(",")
    ]
    return [parse(Exposure, one, "--time, --gain") for one in data]
