"""The command ``dasim``: parses and prints; the work is done elsewhere."""

from __future__ import annotations

import inspect
import json
import os
import signal
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import cyclopts
from cyclopts import Parameter

from dasim.cli_dataset import app as dataset_app
from dasim.errors import InputError

if TYPE_CHECKING:
    from dasim.camera import Camera
    from dasim.values import Capture, PsfBank
    from recon.settings import Settings

app = cyclopts.App(
    name="dasim",
    help="Simulate dual-aperture photography, reconstruct depth and an all-in-focus picture, and score both.",
    version_flags=["--version"],
    suppress_keyboard_interrupt=False,  # run() says it, and main() knows which signal it was
)

app.command(dataset_app)

Progress = Callable[[str, float], None]
_STOPPED = 130


def main() -> None:
    """Entry point: exit status 0 done, 1 a gate failed, 2 the user's input is wrong, 128 + signal when stopped."""
    stopped: list[int] = []

    def stop(number: int, frame: Any) -> None:
        stopped.append(number)
        raise KeyboardInterrupt

    for name in (signal.SIGINT, signal.SIGTERM):
        signal.signal(name, stop)
    try:
        status = run(sys.argv[1:])
    except Exception:
        # A library that was stopped while it was loading may raise anything.
        if not stopped:
            raise
        status = _STOPPED
    sys.exit(128 + stopped[0] if stopped else status)


def run(arguments: list[str]) -> int:
    """Run one command; the exit status."""
    try:
        return app(arguments, exit_on_error=False, print_error=False, result_action="return_value") or 0
    except InputError as error:
        return _refuse(str(error))
    except cyclopts.CycloptsError as error:
        return _refuse(" ".join(str(error).split()) + " (see 'dasim --help')")
    except BrokenPipeError:  # who reads the output has read enough
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 128 + signal.SIGPIPE
    except OSError as error:
        return _refuse(f"{error.filename or 'file'}: {error.strerror or error}")
    except KeyboardInterrupt:
        print("dasim: stopped; nothing half-written is left behind", file=sys.stderr)
        return _STOPPED


def _refuse(message: str) -> int:
    print(f"dasim: {message}", file=sys.stderr)
    return 2


@contextmanager
def _progress() -> Iterator[Progress]:
    """A progress bar with the time left on a terminal; elsewhere one line a stage."""
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


def _whole(kind: Any, tokens: Any) -> int:
    """A whole number, as written: 1.5 is none."""
    try:
        return int(tokens[0].value)
    except ValueError:
        raise InputError(f"--{tokens[0].keyword.lstrip('-')} '{tokens[0].value}' is not a whole number") from None


def _samples(kind: Any, tokens: Any) -> int | str:
    """A whole number of samples, or auto."""
    return "auto" if tokens[0].value == "auto" else _whole(kind, tokens)


Whole = Annotated[int, Parameter(converter=_whole)]
Out = Annotated[Path, Parameter(name="--out")]


@app.command
def demo(*, out: Out = Path("out/demo"), variant: str | None = None, spp: Whole | None = None) -> int:
    """Run the whole chain on a bundled scene; writes report.html and results.json.

    Args:
        out: folder to write; an earlier result there is replaced as a whole
        variant: Mitsuba variant, auto by default
        spp: samples a pixel and stop
    """
    from dasim.files import check_output
    from dasim.simulation import check_options
    from validation.demo import run_demo

    check_output(out, "demo")
    check_options(spp, 0, None)
    _say_variant(variant)
    with _progress() as progress:
        entries = run_demo(out, variant=variant, spp=spp, progress=progress)
    for entry in entries:
        mark = {None: "", True: "passed", False: "FAILED"}[entry.passed]
        print(f"{entry.id:<46}{entry.value:>9.3f} {entry.unit:<6}{entry.limit or '':<8}{mark}")
    print(f"report: {out / 'report.html'}")
    return 1 if any(entry.passed is False for entry in entries) else 0


@app.command
def render(
    scene: str,
    *,
    out: Out,
    camera: str = "da-mobile",
    focus: float | None = None,
    seed: Whole = 0,
    size: str | None = None,
    spp: Annotated[int | str | None, Parameter(converter=_samples)] = None,
    noise_share: float = 0.2,
    exposure: float | None = None,
    diffraction: str | None = None,
    variant: str | None = None,
    unit_cm: float | None = None,
    near_infrared: str | None = None,
    illuminant: str | None = None,
) -> int:
    """Photograph a scene: a capture folder with raw.png, truth.exr and meta.json.

    Args:
        scene: a bundled name (see 'dasim list scenes', staircase:14 for one of a family), a TOML file, a Mitsuba XML
            file, or a random scene: random:SEED:INDEX, or random:FILE.toml:SEED:INDEX with what it is drawn from; it
            fits the picture's size
        out: the capture folder
        camera: a bundled name (see 'dasim list cameras') or a TOML file
        focus: focus distance in metres; by default what the scene proposes, else the camera's own
        seed: of all random numbers
        size: WxH pixels, a central crop of the sensor at unchanged pixel pitch
        spp: samples a pixel and stop, or auto: until rendering noise is below --noise-share
        noise_share: rendering noise over the sensor's own that auto aims at, at the median pixel of every channel
        exposure: exposure time in seconds; automatic by default
        diffraction: wave, airy or off
        variant: Mitsuba variant: auto, cuda_ad_spectral, llvm_ad_spectral or scalar_spectral
        unit_cm: of a Mitsuba XML file, the length of its unit; 100 by default
        near_infrared: of a Mitsuba XML file, the rule for its RGB surfaces: print, dyed, or achromatic by default
        illuminant: of a Mitsuba XML file, the spectrum of its RGB lights; D65 by default
    """
    import dasim
    from dasim import random_scenes
    from dasim.files import check_output
    from dasim.render import backend
    from dasim.simulation import check_camera, check_options
    from dasim.specification import parse

    check_output(out, "capture")
    check_options(spp, seed, diffraction, noise_share)
    choices = {"unit_cm": unit_cm, "near_infrared": near_infrared, "illuminant": illuminant}
    given = {name: value for name, value in choices.items() if value is not None}
    whole = chosen = dasim.load_camera(camera)
    if size is not None:
        chosen = dasim.cropped(whole, *_size(size))
    described: dasim.Scene | dasim.MitsubaScene
    if random_scenes.is_random(scene) and not given:
        described, drawn = random_scenes.named(scene, chosen)
    else:
        described, drawn = dasim.load_scene(scene, camera=whole, **given), dasim.Exposure()
    chosen = dasim.focused(chosen, described) if focus is None else dasim.refocused(chosen, focus)
    options: dict[str, Any] = {} if spp is None else {"spp": spp}
    times = drawn if exposure is None else parse(dasim.Exposure, {"time_s": exposure}, "--exposure")
    check_camera(chosen, backend.choose(variant).variant)
    _say_variant(variant)
    with _progress() as progress:
        shot = dasim.simulate(
            described,
            chosen,
            seed,
            exposure=times,
            diffraction=diffraction,
            variant=variant,
            noise_share=noise_share,
            progress=progress,
            **options,
        )
    dasim.save_capture(out, shot.capture, shot.truth)
    for note in shot.capture.provenance["notes"]:
        print(f"note: {note}")
    shares = shot.capture.provenance.get("rendering_noise_share", {})
    if shares:
        listed = ", ".join(f"{name} {share:.2f}" for name, share in shares.items())
        print(f"rendering noise over the sensor's own: {listed} ({shot.capture.provenance['spp']} samples)")
    print(f"capture: {out} ({shot.capture.exposure_s * 1e3:.3g} ms)")
    return 0


@app.command
def calibrate(
    *,
    out: Path | None = None,
    camera: str = "da-mobile",
    focus: float | None = None,
    illuminant: Annotated[list[str] | None, Parameter(negative="")] = None,
    diffraction: str | None = None,
    captures: Path | None = None,
    format_: Annotated[str | None, Parameter(name="--format")] = None,
    print_distances: Annotated[bool, Parameter(negative="")] = False,
    save_captures: Path | None = None,
) -> int:
    """Measure a PSF bank from pictures of a point source, simulated ones or your own.

    Args:
        out: the bank, one .npz file
        camera: a bundled name or a TOML file
        focus: focus distance in metres; the camera's own by default
        illuminant: of simulated pictures, lights of the bank; all by default
        diffraction: of simulated pictures: wave (the default), airy or off; the same as that of the captures
        captures: a folder with your own pictures: raw files, and captures.csv with a line for each (columns file,
            light, depth_m, exposure_s; also gain, and position where the source stood at several places)
        format_: of your own pictures: raw10, raw12, raw16 or left-aligned, as of 'dasim recon'
        print_distances: print the distances from the lens at which to photograph the point source, and end
        save_captures: write the simulated pictures to this folder, in the form that --captures reads, and end
    """
    import dasim
    from dasim import illuminants
    from dasim.calibration import CALIBRATION_LIGHTS
    from dasim.files import check_output, save_bank
    from dasim.simulation import check_options
    from recon.point_files import KIND
    from validation.banks import simulated_bank

    chosen = dasim.load_camera(camera)
    if focus is not None:
        chosen = dasim.refocused(chosen, focus)
    if print_distances:
        return _print_distances(chosen)
    if captures is not None and (illuminant or diffraction or save_captures):
        raise InputError("--captures: your own pictures decide lights and diffraction; leave the other option out")
    if save_captures is not None and out is not None:
        raise InputError("--save-captures: writes pictures and no bank; leave --out out")
    if captures is None and format_ is not None:
        raise InputError("--format: is for your own pictures; name their folder with --captures")
    lights = tuple(dict.fromkeys(illuminant or CALIBRATION_LIGHTS))
    for light in lights:
        illuminants.illuminant(light)
    check_options(None, 0, diffraction)
    if save_captures is not None:
        check_output(save_captures, KIND)
        return _save_captures(save_captures, chosen, lights, diffraction or "wave")
    if out is None:
        raise InputError("--out is missing; name the bank's file, such as bank.npz")
    _check_bank_output(out)
    with _progress() as progress:
        if captures is None:
            bank = simulated_bank(chosen, lights=lights, diffraction=diffraction or "wave", progress=progress)
        else:
            bank, notes = _measured_bank(captures, chosen, format_, progress)
            for note in notes:
                print(f"note: {note}")
    save_bank(out, bank)
    print(f"bank: {out} ({', '.join(bank.lights)}; {len(bank.depth_m)} levels, {bank.depth_m[-1]:.3g} to "
          f"{bank.depth_m[0]:.3g} m)")  # fmt: skip
    return 0


def _print_distances(camera: Camera) -> int:
    from dasim.calibration import levels
    from dasim.camera import depth_of_blur_m
    from recon.point_table import DEPTH_TOLERANCE

    depths, blurs = levels(camera)
    margin = DEPTH_TOLERANCE * blurs[1]
    nearest, farthest = (depth_of_blur_m(camera, blurs + side * margin) for side in (1, -1))
    print(
        f"# camera '{camera.name}' focused at {camera.lens.focus_distance_m:g} m: metres from the lens to the pinhole;"
    )
    print("# a picture counts from from_m to to_m; you may stop after any level, and leave none out before it")
    print("level  distance_m   from_m     to_m  blur_px")
    for row in zip(range(len(depths)), depths, nearest, farthest, blurs, strict=True):
        print("{:>5}  {:>10.5f}  {:>7.5f}  {:>7.5f}  {:>7.1f}".format(*row))
    return 0


def _save_captures(out: Path, camera: Camera, lights: tuple[str, ...], diffraction: str) -> int:
    from dasim.calibration import calibration_captures
    from recon.point_files import write_point_pictures

    count = write_point_pictures(out, calibration_captures(camera, lights, diffraction=diffraction), camera)
    print(f"captures: {out} ({count} pictures of {', '.join(lights)})")
    return 0


def _measured_bank(
    folder: Path, camera: Camera, kind: str | None, progress: Progress
) -> tuple[PsfBank, tuple[str, ...]]:
    """A bank of a user's own pictures, and what is to be said of it."""
    from dasim import illuminants
    from dasim.calibration import levels
    from recon import calibrate as measured
    from recon.point_files import read_point_pictures

    found = read_point_pictures(
        folder, camera, *levels(camera), known_light=illuminants.illuminant, kind=kind, progress=progress
    )
    return measured(found.pictures, camera, progress=progress), found.notes


@app.command
def recon(
    capture: Path | None = None,
    *,
    out: Path | None = None,
    camera: str | None = None,
    format_: Annotated[str | None, Parameter(name="--format")] = None,
    exposure: float | None = None,
    gain: float | None = None,
    focus: float | None = None,
    bank: Path | None = None,
    preset: str | None = None,
    settings: Path | None = None,
    print_settings: Annotated[bool, Parameter(negative="")] = False,
    flat: Path | None = None,
    also: Annotated[list[str] | None, Parameter(negative="", consume_multiple=True)] = None,
) -> int:
    """Reconstruct a capture: picture, depth, all-in-focus picture. Of a camera without infrared, the picture alone.

    Args:
        capture: a capture folder, or with --camera a raw mosaic: a 16-bit PNG, TIFF or NPY file, or packed pixels
        out: the reconstruction folder
        camera: of a raw file: a bundled name or a TOML file with mosaic, bit depth, black level and noise; the
            picture's own size counts
        format_: of a raw file: raw10 or raw12 (MIPI packing), raw16 (two bytes, low first), all without header and of
            the camera's size; left-aligned for PNG, TIFF or NPY values shifted up to 16 bits
        exposure: of a raw file, in seconds, for the dark signal; 0.01 by default
        gain: of a raw file, analogue, a factor on the camera's own; 1 by default
        focus: of a raw file, focus distance in metres; the camera's own by default
        bank: a PSF bank; by default one is calibrated for the capture's camera and focus, and kept in the cache
        preset: bands (the default), paper, likelihood or chakrabarti-zickler
        settings: a TOML file with settings that differ from the paper's preset, as --print-settings writes it
        print_settings: print the settings as TOML, with what each means, and end
        flat: a capture of an even surface that fills the frame, to undo the lens shading in the pictures; of the same
            kind as the capture
        also: further pictures of the all-in-focus one: anaglyph (red-cyan), stereo (side by side), ply or glb (textured
            surface)
    """
    import dasim
    import recon as reconstruction
    from dasim.files import check_output
    from recon import settings as known
    from recon.mosaic import grids
    from recon.output import check_extras, save_reconstruction
    from recon.raw_files import load_input

    chosen = known.chosen(preset, settings)
    if print_settings:
        print(known.to_toml(chosen), end="")
        return 0
    if capture is None or out is None:
        raise InputError("recon: needs a capture and --out FOLDER (see 'dasim recon --help')")
    check_output(out, "reconstruction")
    check_extras(also or ())
    model = None if camera is None else dasim.load_camera(camera)
    if focus is not None:
        if model is None:
            raise InputError("--focus: is for raw files with --camera; a capture folder says it itself")
        model = dasim.refocused(model, focus)
    shot, even = (
        None if path is None else load_input(path, model, kind=format_, exposure_s=exposure, gain=gain)
        for path in (capture, flat)
    )
    assert shot is not None
    if even is not None:
        reconstruction.check_flat(even, shot.camera)
    if "IR" not in grids(shot.camera):  # a mosaic that cannot be reconstructed is refused before a bank is made
        return _picture_alone(shot, even, chosen, bank, out)
    with _progress() as progress:
        kernels = _bank(bank, shot, progress)
        result = reconstruction.reconstruct(
            shot, kernels, chosen, flat=even, progress=lambda s, x: progress("reconstructing", x)
        )
        save_reconstruction(out, result, also or ())
    for note in result.notes:
        print(f"note: {note}")
    print(f"reconstruction: {out} (light by white balance: {result.light})")
    return 0


@app.command
def refocus(
    reconstruction: Path,
    *,
    depth: float,
    out: Path,
    f_number: float | None = None,
    bank: Path | None = None,
) -> int:
    """Focus a reconstructed picture after the shot, at any depth and aperture.

    Args:
        reconstruction: a reconstruction folder
        depth: distance in metres that becomes sharp
        out: the picture to write, a PNG file; an earlier one is replaced
        f_number: of the lens; the camera's own by default
        bank: the PSF bank of the reconstruction; by default that of the camera's description
    """
    import recon as pipeline
    from recon.output import displayed, load_reconstruction, write_picture
    from validation.banks import simulated_bank

    if out.suffix.lower() != ".png" or out.is_dir() or not out.resolve().parent.is_dir():
        raise InputError(f"--out {out}: is not a PNG file in a folder that exists")
    for option, value in (("--depth", depth), ("--f-number", f_number)):
        if value is not None and not 0 < value < float("inf"):
            raise InputError(f"{option} {value:g}: must be above 0")
    found = load_reconstruction(reconstruction)
    with _progress() as progress:
        kernels = pipeline.load_bank(bank) if bank is not None else simulated_bank(found.camera, progress=progress)
    write_picture(out, displayed(pipeline.refocus(found, kernels, depth, f_number), found))
    print(f"picture: {out} (focused at {depth:g} m, f/{f_number or found.camera.lens.f_number:g})")
    return 0


def _bank(path: Path | None, shot: Capture, progress: Progress) -> PsfBank:
    """The bank of a file, or the one that the camera's own description gives."""
    from dasim.files import load_bank
    from validation.banks import simulated_bank

    if path is not None:
        return load_bank(path)
    if "raw_file" in shot.provenance:
        print(
            f"note: without --bank the kernels are those that the description of camera '{shot.camera.name}' predicts; "
            "of a real camera, measure them (dasim calibrate --captures)"
        )
    return simulated_bank(shot.camera, diffraction=shot.provenance.get("diffraction", "wave"), progress=progress)


def _picture_alone(shot: Capture, even: Capture | None, chosen: Settings, bank: Path | None, out: Path) -> int:
    from recon import develop
    from recon.output import save_picture

    if bank is not None:
        raise InputError(f"--bank: camera '{shot.camera.name}' has no infrared pixels and so no depth; leave it out")
    picture = develop(shot, chosen, flat=even)
    save_picture(out, picture)
    print(f"note: camera '{shot.camera.name}' has no infrared pixels: the picture alone, no depth")
    print(f"picture: {out} (light by white balance: {picture.light})")
    return 0


@app.command
def score(
    result: Path,
    capture: Path,
    *,
    confidence: Path | None = None,
    scale: float | None = None,
    json_file: Annotated[Path | None, Parameter(name="--json")] = None,
) -> int:
    """Score a reconstruction, or anybody's depth map, against the ground truth of its capture.

    Args:
        result: a reconstruction folder, or a depth map: EXR or NPY in metres, 16-bit PNG with --scale
        capture: the capture folder with truth.exr; or, for a reconstruction of a photograph of your own, the depths
            that you measured: EXR or NPY in metres, 16-bit PNG with --scale, one for each pixel, NaN (0) where unknown
        confidence: with a depth map, how sure it is of each pixel (same formats, any unit, more is surer)
        scale: metres of one unit of the depth map, or of the measured depths
        json_file: also write the figures to this file
    """
    from dasim.files import load_capture, load_truth
    from recon.output import load_reconstruction
    from validation import scores
    from validation.claim import plain_value
    from validation.depth_files import SUFFIXES, read_depth, read_map

    _check_score_output(json_file)
    if capture.is_file() and capture.suffix.lower() in SUFFIXES:
        from validation.own_truth import score_measured

        if confidence is not None or not result.is_dir():
            raise InputError(f"{capture}: measured depths judge a reconstruction folder, which says its camera")
        figures = score_measured(load_reconstruction(result), read_depth(capture, scale))
    elif result.is_file() or result.suffix.lower() in SUFFIXES:
        depth_m = read_depth(result, scale)
        trust = None if confidence is None else read_map(confidence)
        taken = load_capture(capture)
        figures = scores.score_map(depth_m, taken, load_truth(capture), trust)
    else:
        if confidence is not None or scale is not None:
            raise InputError("--confidence and --scale belong to a depth map; a reconstruction folder has its own")
        found = load_reconstruction(result)
        taken = load_capture(capture)  # a capture that is not whole is not scored
        figures = scores.score(found, taken, load_truth(capture))
    print(scores.shown(figures))
    if json_file is not None:
        content = {f.id: {"value": plain_value(f.value), "unit": f.unit} for f in figures}
        partial = json_file.with_name(f".{json_file.name}.partial")
        partial.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")
        partial.replace(json_file)
    return 0


@app.command
def validate(
    *,
    out: Annotated[Path | None, Parameter(name="--out")] = None,
    list_: Annotated[bool, Parameter(name="--list", negative="")] = False,
    only: Annotated[list[str] | None, Parameter(negative="", consume_multiple=True)] = None,
    quick: Annotated[bool, Parameter(negative="")] = False,
    gates: Path | None = None,
    fresh: Annotated[bool, Parameter(negative="")] = False,
    seeds: Whole = 1,
    jobs: Whole = 1,
    compare: Path | None = None,
    propose_gates: Path | None = None,
) -> int:
    """Hold the simulator against closed forms and independent methods; writes results, a report and junit.xml.

    A claim that an earlier run measured with the same code, data, libraries and renderer is not measured again.

    Args:
        out: folder to write; an earlier result there is replaced as a whole
        list_: list the claims and end
        only: ids of the claims to measure; all by default
        quick: only claims that take less than about 20 s each
        gates: a TOML file with limits that are added to the bundled ones, or replace them
        fresh: measure every claim again
        seeds: random numbers of claims that depend on them: with 3, each is measured with the seeds 0, 1 and 2, and its
            figures are means with their spread
        jobs: claims that are measured at once, each in a process of its own
        compare: results.json of an earlier run: prints what became better and worse
        propose_gates: a TOML file to write, for --gates: limits from the measured means and their spread over --seeds
    """
    from dasim.files import check_output
    from dasim.render import backend
    from validation.claim_table import CLAIMS
    from validation.comparison import changes, load_results, report
    from validation.proposal import gate_file
    from validation.validate import all_gates, chosen, failed, run_claims

    names = chosen(CLAIMS, only or (), quick=quick)
    limits = all_gates(CLAIMS, gates)
    if list_:
        _list_claims(names, verbose=False)
        return 0
    if out is None:
        raise InputError("--out is missing; name a folder for the results")
    for option, number in (("--jobs", jobs), ("--seeds", seeds)):
        if number < 1:
            raise InputError(f"{option} {number}: must be 1 or more")
    if propose_gates is not None:
        if seeds < 2:
            raise InputError("--propose-gates: needs --seeds of 2 or more, since the margin comes from their spread")
        _check_new_file(propose_gates, "--propose-gates")
    earlier = None if compare is None else load_results(compare)
    check_output(out, "validation")
    _say_variant(None)
    variant = backend.choose().variant
    with _progress() as progress:
        outcomes = run_claims(
            out, names, CLAIMS, limits, variant=variant, seeds=seeds, fresh=fresh, jobs=jobs, progress=progress
        )
    for outcome in outcomes:
        for entry in outcome.claims:
            mark = {None: "", True: "passed", False: "FAILED"}[entry.passed]
            spread = "" if entry.spread is None else f"+- {entry.spread:.2g}"
            line = f"{entry.id:<44}{entry.value:>10.4g} {spread:<11}{entry.unit:<7}{entry.limit or '':<16}{mark}"
            print(f"{entry.id:<44}{entry.source}" if outcome.not_run or outcome.error else line)
    again = sum(outcome.stored for outcome in outcomes)
    if again:
        print(f"{again} of {len(outcomes)} claims are unchanged since an earlier run; --fresh measures them again")
    if propose_gates is not None:
        figures = [(entry, outcome.seeds) for outcome in outcomes for entry in outcome.claims]
        propose_gates.write_text(gate_file(figures), encoding="utf-8")
        print(f"limits: {propose_gates}")
    if earlier is not None:
        entries = [entry for outcome in outcomes for entry in outcome.claims]
        print("\n".join(report(changes(earlier, entries, set(names)))))
    print(f"report: {out / 'report.html'}")
    return 1 if failed(outcomes) else 0


@app.command
def emva(
    *,
    out: Out,
    camera: str = "da-mobile",
    channel: str = "G",
    gain: float = 1.0,
    seed: Whole = 0,
    size: str = "256x256",
) -> int:
    """Photograph an even light as EMVA 1288 measures a sensor: frames and the descriptor for its reference analyser.

    Args:
        out: folder to write; an earlier measurement there is replaced as a whole
        camera: a bundled name or a TOML file; its lens is not used
        channel: whose pixels are measured: R, G, B or IR
        gain: analogue gain; a higher one shows a read noise that rounding hides, but not the full well
        seed: of all random numbers
        size: WxH pixels of the frames
    """
    import dasim
    from dasim.emva import KIND, write_measurement
    from dasim.files import check_output
    from dasim.simulation import check_options
    from dasim.specification import parse

    check_output(out, KIND)
    check_options(None, seed, None)
    chosen = dasim.load_camera(camera)
    gain = parse(dasim.Exposure, {"gain": gain}, "--gain").gain
    with _progress() as progress:
        notes = write_measurement(
            out, chosen, channel=channel, gain=gain, seed=seed, size_px=_size(size), progress=progress
        )
    for note in notes:
        print(f"note: {note}")
    print(f"EMVA 1288 measurement: {out / 'descriptor.txt'}")
    return 0


@app.command(name="list")
def list_(kind: str, *, verbose: Annotated[bool, Parameter(negative="")] = False) -> int:
    """List what is bundled.

    Args:
        kind: scenes, cameras, materials, illuminants or claims
        verbose: with more detail
    """
    from dasim import camera, describe, scene

    if kind == "scenes":
        for name in scene.scene_names():
            print(f"{name:<16}{scene.load_scene(name).description}")
    elif kind == "cameras":
        for name in camera.camera_names():
            loaded = camera.load_camera(name)
            print(f"{name:<20}{loaded.description}")
            if verbose:
                print("\n".join(f"    {line}" for line in describe.described(loaded)) + "\n")
    elif kind == "materials":
        _list_materials(verbose=verbose)
    elif kind == "illuminants":
        _list_illuminants(verbose=verbose)
    elif kind == "claims":
        from validation.claim_table import CLAIMS

        _list_claims(list(CLAIMS), verbose=verbose)
    else:
        raise InputError(f"list '{kind}' is unknown; allowed are scenes, cameras, materials, illuminants, claims")
    return 0


def _list_materials(*, verbose: bool) -> None:
    from dasim import materials
    from dasim.render.reflection import normal_reflectance
    from dasim.spectra import WAVELENGTH_NM

    shown_nm = (450, 550, 650, 750, 800)
    if verbose:
        print(f"reflectance (metals, glass and coats: at normal incidence) at {', '.join(map(str, shown_nm))} nm")
    for name in materials.material_names():
        kind, source = materials.kind_and_source(name)
        if not verbose:
            print(f"{name:<24}{kind}")
            continue
        curve = normal_reflectance(materials.surface(name, Path(".")))
        values = " ".join(f"{curve[WAVELENGTH_NM == nm][0]:.2f}" for nm in shown_nm)
        print(f"{name:<24}{kind:<9}{values}  {source}")


def _list_illuminants(*, verbose: bool) -> None:
    from dasim import illuminants

    if verbose:
        print("name                  CCT K  near-IR  beyond the end of the table")
    for name in (*illuminants.ILLUMINANTS, *(illuminants.EXAMPLES if verbose else illuminants.PATTERNS)):
        if not verbose:
            print(name)
            continue
        about = illuminants.described(name)
        print(f"{about.name:<20}{about.cct_k:>7.0f}{about.near_infrared:>9.2f}  {about.beyond}")
    if verbose:
        print(
            "CCT: without what lies below 400 nm; near-IR: photons over 650-810 nm, over those of D65 at as many lux\n"
        )
        print("\n".join(f"also: {pattern}" for pattern in illuminants.PATTERNS))


def _list_claims(names: list[str], *, verbose: bool) -> None:
    from validation.claim_table import CLAIMS
    from validation.validate import title

    for name in names:
        text = f"\n{inspect.getdoc(CLAIMS[name].run)}\n" if verbose else title(CLAIMS[name])
        print(f"{name:<20}{'quick' if CLAIMS[name].quick else '':<7}{text}")


def _check_new_file(path: Path, option: str) -> None:
    """Refuse to overwrite anything, and a folder that is not there, before the work begins."""
    if path.exists():
        raise InputError(f"{option} {path}: exists; choose another name")
    if not path.resolve().parent.is_dir():
        raise InputError(f"{option} {path}: the folder {path.resolve().parent} does not exist")


def _check_score_output(out: Path | None) -> None:
    """Refuse to overwrite anything but an earlier score."""
    if out is None:
        return
    if not out.parent.is_dir():
        raise InputError(f"--json {out}: {out.parent} is no folder")
    if not out.exists():
        return
    try:
        earlier = json.loads(out.read_text(encoding="utf-8"))
        if all(set(figure) == {"value", "unit"} for figure in earlier.values()):
            return
    except (OSError, ValueError, AttributeError, TypeError):
        pass
    raise InputError(f"--json {out}: exists and is no earlier score; choose another name")


def _check_bank_output(out: Path) -> None:
    """Refuse to overwrite anything but a bank."""
    from dasim.files import load_bank

    if out.is_dir():
        raise InputError(f"output {out}: is a folder; a bank is one .npz file")
    if out.exists():
        try:
            load_bank(out)
        except InputError:
            raise InputError(f"output {out}: exists and is no PSF bank; choose another name") from None
    for parent in out.resolve().parents:
        if parent.exists():
            if not parent.is_dir():
                raise InputError(f"output {out}: {parent} is a file, not a folder")
            break


def _size(text: str) -> tuple[int, int]:
    width, _, height = text.partition("x")
    try:
        return int(width), int(height)
    except ValueError:
        raise InputError(f"--size '{text}' is not of the form WxH, such as 768x576") from None


def _say_variant(variant: str | None) -> None:
    from dasim.render import backend

    print(f"renderer: {backend.choose(variant).reason}", file=sys.stderr, flush=True)


if __name__ == "__main__":
    main()
