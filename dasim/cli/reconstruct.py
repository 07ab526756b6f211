"""The commands that start from a capture: recon, refocus, score.

Tested in tests/dasim/cli/test_commands.py.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

from dasim.base.errors import InputError
from dasim.cli import options
from dasim.typing import Progress

if TYPE_CHECKING:
    from dasim.values import Capture, PsfBank
    from recon.settings import Settings


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
    from dasim.files.folders import check_output
    from recon import settings as known
    from recon.files.raw import load_input
    from recon.files.reconstruction import check_extras, save_reconstruction
    from recon.picture.mosaic import grids

    chosen = known.select(preset, settings)
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
    with options.progress() as progress:
        kernels = _bank(bank, shot, progress)
        result = reconstruction.reconstruct(
            shot, kernels, chosen, flat=even, progress=lambda s, x: progress("reconstructing", x)
        )
        save_reconstruction(out, result, also or ())
    for note in result.notes:
        print(f"note: {note}")
    print(f"reconstruction: {out} (light by white balance: {result.light})")
    return 0


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
    import dasim
    import recon as pipeline
    from recon.files.reconstruction import displayed, load_reconstruction, write_picture

    if out.suffix.lower() != ".png" or out.is_dir() or not out.resolve().parent.is_dir():
        raise InputError(f"--out {out}: is not a PNG file in a folder that exists")
    for option, value in (("--depth", depth), ("--f-number", f_number)):
        if value is not None and not 0 < value < float("inf"):
            raise InputError(f"{option} {value:g}: must be above 0")
    found = load_reconstruction(reconstruction)
    with options.progress() as progress:
        if bank is not None:
            kernels = pipeline.load_bank(bank)
        else:
            kernels = pipeline.calibrate(dasim.calibration_captures(found.camera), progress=progress)
    write_picture(out, displayed(pipeline.refocus(found, kernels, depth, f_number), found))
    print(f"picture: {out} (focused at {depth:g} m, f/{f_number or found.camera.lens.f_number:g})")
    return 0


def _bank(path: Path | None, shot: Capture, progress: Progress) -> PsfBank:
    """The bank of a file, or the one that the camera's own description gives."""
    import dasim
    import recon

    if path is not None:
        return recon.load_bank(path)
    if "raw_file" in shot.provenance:
        print(
            f"note: without --bank the kernels are those that the description of camera '{shot.camera.name}' predicts; "
            "of a real camera, measure them (dasim calibrate --captures)"
        )
    pictures = dasim.calibration_captures(shot.camera, diffraction=shot.provenance.get("diffraction", "wave"))
    return recon.calibrate(pictures, progress=progress)


def _picture_alone(shot: Capture, even: Capture | None, chosen: Settings, bank: Path | None, out: Path) -> int:
    from recon import develop
    from recon.files.reconstruction import save_picture

    if bank is not None:
        raise InputError(f"--bank: camera '{shot.camera.name}' has no infrared pixels and so no depth; leave it out")
    picture = develop(shot, chosen, flat=even)
    save_picture(out, picture)
    print(f"note: camera '{shot.camera.name}' has no infrared pixels: the picture alone, no depth")
    print(f"picture: {out} (light by white balance: {picture.light})")
    return 0


def score(
    result: Path,
    capture: Path | None = None,
    *,
    confidence: Path | None = None,
    scale: float | None = None,
    method: Annotated[list[str] | None, Parameter(negative="", consume_multiple=True)] = None,
    metric: Annotated[list[str] | None, Parameter(negative="", consume_multiple=True)] = None,
    bank: Path | None = None,
    gates: Path | None = None,
    json_file: Annotated[Path | None, Parameter(name="--json")] = None,
    junit: Path | None = None,
) -> int:
    """Score a reconstruction, a depth map, or the depth methods named, against the ground truth of the capture.

    Exit status 1 where a limit of --gates is missed.

    Args:
        result: a reconstruction folder, or a depth map: EXR or NPY in metres, 16-bit PNG with --scale; with --method
            the capture folder, and nothing else
        capture: the capture folder with truth.exr; or, for a reconstruction of a photograph of your own, the depths
            that you measured: EXR or NPY in metres, 16-bit PNG with --scale, one for each pixel, NaN (0) where unknown
        confidence: with a depth map, how sure it is of each pixel (same formats, any unit, more is surer)
        scale: metres of one unit of the depth map, or of the measured depths
        method: a depth method to run and score: a bundled name, or your function as package.module:function or
            file.py:function, with a name for its figures as NAME=file.py:function; figures are METHOD.FIGURE
        metric: your own function of a depth map in metres and the truth, named as a method is; it returns a number or
            a dict of numbers
        bank: with --method, a PSF bank; by default that of the camera's description
        gates: a TOML file with limits, whose keys are score.FIGURE
        json_file: also write the figures to this file
        junit: also write the verdicts to this file, as JUnit XML
    """
    from dasim.files.captures import load_capture, load_truth
    from recon.files.reconstruction import load_reconstruction
    from validation.gates.scored import check_score_files, judged_score, write_score
    from validation.method_scores import score_methods
    from validation.methods import named
    from validation.reports.lines import of_claim
    from validation.scores import score as scores
    from validation.scores.depth_files import SUFFIXES, read_depth, read_map
    from validation.scores.measured_truth import score_measured
    from validation.scores.metrics import load_metrics

    check_score_files(json_file, junit)
    judged_score("score", [], gates)  # a file that cannot be read is refused before the work begins
    methods, metrics = named(method or ()), load_metrics(metric or ())
    if methods:
        if capture is not None or confidence is not None or scale is not None:
            raise InputError("--method: runs on a capture; give its folder, and no map, --confidence or --scale")
        taken = load_capture(result)
        truth = load_truth(result)
        with options.progress() as progress:
            figures = score_methods(taken, truth, _bank(bank, taken, progress), methods, metrics)
    elif capture is None or bank is not None:
        raise InputError("score: needs a reconstruction or depth map and its capture; --bank is for --method")
    elif capture.is_file() and capture.suffix.lower() in SUFFIXES:
        if confidence is not None or metrics or not result.is_dir():
            raise InputError(
                f"{capture}: measured depths judge a reconstruction folder, which says its camera; --confidence and "
                "--metric do not go with them"
            )
        figures = score_measured(load_reconstruction(result), read_depth(capture, scale))
    elif result.is_file() or result.suffix.lower() in SUFFIXES:
        depth_m = read_depth(result, scale)
        trust = None if confidence is None else read_map(confidence)
        taken = load_capture(capture)
        figures = scores.score_map(depth_m, taken, load_truth(capture), trust, metrics=metrics)
    else:
        if confidence is not None or scale is not None:
            raise InputError("--confidence and --scale belong to a depth map; a reconstruction folder has its own")
        found = load_reconstruction(result)
        taken = load_capture(capture)  # a capture that is not whole is not scored
        figures = scores.score(found, taken, load_truth(capture), metrics=metrics)
    for name in [f"{own}." for own in methods] or [""]:
        print(f"method {name[:-1]}" if name else "", end="\n" if name else "")
        print(scores.table([replace(f, id=f.id.removeprefix(name)) for f in figures if f.id.startswith(name)]))
    entries = judged_score("score", figures, gates)
    for entry in entries:
        if entry.limit is not None:
            print(of_claim(entry))
    write_score("score", entries, json_file=json_file, junit=junit)
    return 1 if any(entry.passed is False for entry in entries) else 0
