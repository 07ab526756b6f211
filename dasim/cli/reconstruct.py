"""The commands recon, refocus, view and score, which start from a capture.

Tested in tests/dasim/cli/test_recon.py, tests/dasim/cli/test_refocus.py, tests/dasim/cli/test_view.py and
tests/dasim/cli/test_score.py.
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

LARGEST = 1e6  # distance in metres, and f-number, of a refocused picture: beyond all depth of field


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
    """Reconstruct picture, depth and all-in-focus picture from a capture; without infrared pixels, the picture only.

    Args:
        capture: a capture folder, a DNG that dasim wrote, or with --camera a raw mosaic: an uncompressed DNG, a 16-bit
            PNG, TIFF or NPY file, or packed pixels
        out: output folder of the reconstruction, out/CAPTURE-recon by default; an earlier one there is replaced
        camera: for a raw file: a bundled name or a TOML file with mosaic, bit depth, black level and noise; the file
            sets the frame's size
        format_: for a raw file: raw10 or raw12 (MIPI packing) or raw16 (little-endian), all without header and in the
            camera's size; left-aligned for PNG, TIFF or NPY values shifted up to 16 bits
        exposure: for a raw file, exposure time in seconds, for the dark signal; 0.01 by default, or that of a DNG
        gain: for a raw file, analogue gain relative to the camera's; 1 by default, or that of a DNG that dasim wrote
        focus: for a raw file, focus distance in metres; the camera's by default
        bank: a PSF bank; by default one is calibrated for the camera and focus of the capture and stored in the cache
        preset: best (the default), fast, bands, paper, likelihood or chakrabarti-zickler
        settings: a TOML file with settings that differ from the preset paper, as --print-settings writes it
        print_settings: print the settings as TOML with their meanings, and exit
        flat: a capture of a uniform surface that fills the frame, to correct lens shading in the pictures; in the
            format of the capture
        also: further output from the all-in-focus picture: anaglyph (red-cyan), stereo (side by side), ply or glb
            (textured surface)
    """
    import dasim
    import recon as reconstruction
    from dasim.files.folders import check_output
    from recon import settings as known
    from recon.files.raw import load_input
    from recon.files.reconstruction import check_extras, save_reconstruction
    from recon.picture.mosaic import grids

    parameters = known.select(preset, settings)
    if print_settings:
        print(known.to_toml(parameters), end="")
        return 0
    if capture is None:
        raise InputError("recon: a capture is required (see 'dasim recon --help')")
    out = options.default_out(capture, "-recon") if out is None else out
    check_output(out, "reconstruction")
    check_extras(also or ())
    model = None if camera is None else dasim.load_camera(camera)
    if focus is not None:
        if model is None:
            raise InputError("--focus: applies to raw files with --camera; a capture folder contains its focus")
        model = dasim.refocused(model, focus)
    shot, even = (
        None if path is None else load_input(path, model, kind=format_, exposure_s=exposure, gain=gain)
        for path in (capture, flat)
    )
    assert shot is not None
    if even is not None:
        reconstruction.check_flat(even, shot.camera)
    if "IR" not in grids(shot.camera):  # before a bank is calibrated
        return _picture_alone(shot, even, parameters, bank, out)
    with options.progress() as progress:
        kernels = _bank(bank, shot, progress)
        result = reconstruction.reconstruct(
            shot, kernels, parameters, flat=even, progress=lambda s, x: progress("reconstructing", x)
        )
        save_reconstruction(out, result, also or (), raw_dn=shot.raw_dn)
    for note in result.notes:
        print(f"note: {note}")
    print(f"reconstruction: {out} (light by white balance: {result.light})")
    return 0


def refocus(
    reconstruction: Path,
    *,
    depth: float,
    out: Path | None = None,
    f_number: float | None = None,
    bank: Path | None = None,
) -> int:
    """Refocus a reconstruction at any depth and aperture.

    Args:
        reconstruction: a reconstruction folder
        depth: distance in metres of the new focal plane
        out: output picture, a PNG file, out/RECON-DEPTHm.png by default; an earlier one is replaced
        f_number: f-number of the lens; the camera's by default
        bank: the PSF bank of the reconstruction; by default calibrated from the camera's description
    """
    import dasim
    import recon as pipeline
    from recon.files.reconstruction import displayed, load_reconstruction, write_picture

    if out is None:
        out = options.default_out(reconstruction, f"-{depth:g}m.png")
    elif out.suffix.lower() != ".png" or out.is_dir() or not out.resolve().parent.is_dir():
        raise InputError(f"--out {out}: is not a PNG file in a folder that exists")
    for option, value in (("--depth", depth), ("--f-number", f_number)):
        if value is not None and not 0 < value <= LARGEST:
            raise InputError(f"{option} {value:g}: must be above 0, and at most {LARGEST:g}")
    rebuilt = load_reconstruction(reconstruction)
    with options.progress() as progress:
        if bank is not None:
            kernels = pipeline.load_bank(bank)
        else:
            kernels = pipeline.calibrate(dasim.calibration_captures(rebuilt.camera), progress=progress)
    write_picture(out, displayed(pipeline.refocus(rebuilt, kernels, depth, f_number), rebuilt))
    print(f"picture: {out} (focused at {depth:g} m, f/{f_number or rebuilt.camera.lens.f_number:g})")
    return 0


def view(
    folder: Path,
    *,
    out: Path | None = None,
    capture: Path | None = None,
    bank: Path | None = None,
    slices: options.Whole | None = None,
) -> int:
    """Write one page to explore a reconstruction or a capture in a browser: refocus, depth, 3D view, mosaic.

    The page contains everything and loads nothing from outside.

    Args:
        folder: a reconstruction folder; or a capture folder, for its mosaic, its channels and the truth alone
        out: the page, an HTML file, out/view.html by default; an earlier one is replaced
        capture: the capture folder of the reconstruction, for its mosaic and the truth; by default the folder
            'capture' beside the reconstruction, or NAME beside NAME-recon, if its camera is the same
        bank: the PSF bank of the reconstruction; by default calibrated from the camera's description
        slices: focus distances that are computed at the lens's own f-number, 2 or more; fewer at smaller apertures; by
            default one per blur level, at most 24
    """
    from dasim.base import atomic
    from validation.reports.view import page

    if out is None:
        out = Path("out/view.html")
    elif out.suffix.lower() != ".html" or out.is_dir() or not out.resolve().parent.is_dir():
        raise InputError(f"--out {out}: is not an HTML file in a folder that exists")
    if slices is not None and slices < 2:
        raise InputError(f"--slices {slices}: must be 2 or more")
    if (folder / "raw.png").is_file() and not (folder / "recon.exr").is_file():
        if (capture, bank, slices) != (None, None, None):
            raise InputError(
                f"view {folder}: is a capture; --capture, --bank and --slices apply to a reconstruction folder"
            )
        shot, truth = page.capture_of(folder)
        with options.progress() as progress:
            text = page.capture_page(shot, truth, progress)
    else:
        text = _view_of_reconstruction(folder, capture, bank, slices)
    atomic.write(out, text)
    print(f"page: {out} ({len(text.encode()) / 1e6:.1f} MB)")
    return 0


def _view_of_reconstruction(folder: Path, capture: Path | None, bank: Path | None, slices: int | None) -> str:
    import dasim
    import recon as pipeline
    from recon.files.reconstruction import load_reconstruction
    from validation.reports.view import page

    if not (folder / "recon.exr").is_file():
        raise InputError(
            f"view {folder}: is neither a reconstruction folder (meta.json, recon.exr) nor a capture folder "
            "(meta.json, raw.png); make one with 'dasim recon' or 'dasim render'"
        )
    rebuilt = load_reconstruction(folder)
    if capture is None:
        capture = page.capture_beside(folder, rebuilt)
    shot, truth = (None, None) if capture is None else page.capture_of(capture)
    if shot is None:
        print("note: no capture is known, so that the page has no mosaic and no truth; --capture names it")
    else:
        page.check_same(rebuilt, shot, str(capture))
    with options.progress() as progress:
        if bank is not None:
            kernels = pipeline.load_bank(bank)
        else:
            made = rebuilt.bank.get("diffraction")
            pictures = dasim.calibration_captures(
                rebuilt.camera, diffraction=made if made in ("airy", "off") else "wave"
            )
            kernels = pipeline.calibrate(pictures, progress=progress)
        return page.reconstruction_page(rebuilt, kernels, shot, truth, slices=slices, progress=progress)


def _bank(path: Path | None, shot: Capture, progress: Progress) -> PsfBank:
    """The bank from a file, or calibrated from the camera's description."""
    import dasim
    import recon

    if path is not None:
        return recon.load_bank(path)
    if "raw_file" in shot.provenance:
        print(
            f"note: without --bank the kernels are computed from the description of camera '{shot.camera.name}'; "
            "for a real camera, measure them (dasim calibrate --captures)"
        )
    pictures = dasim.calibration_captures(shot.camera, diffraction=shot.provenance.get("diffraction", "wave"))
    return recon.calibrate(pictures, progress=progress)


def _picture_alone(shot: Capture, even: Capture | None, parameters: Settings, bank: Path | None, out: Path) -> int:
    from recon import develop
    from recon.files.reconstruction import save_picture

    if bank is not None:
        raise InputError(
            f"--bank: camera '{shot.camera.name}' has no infrared pixels and therefore no depth; omit --bank"
        )
    picture = develop(shot, parameters, flat=even)
    save_picture(out, picture, raw_dn=shot.raw_dn)
    print(f"note: camera '{shot.camera.name}' has no infrared pixels: picture only, no depth")
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
    """Score a reconstruction, a depth map or depth methods against the ground truth of a capture.

    The exit status is 1 if a figure violates a limit of --gates.

    Args:
        result: a reconstruction folder, or a depth map: EXR or NPY in metres, 16-bit PNG with --scale; with --method,
            the capture folder
        capture: the capture folder with truth.exr; or, for a reconstruction of your own photograph, measured depths:
            EXR or NPY in metres, 16-bit PNG with --scale, one value per pixel, NaN (PNG: 0) where unknown
        confidence: confidence of each pixel of a depth map (same formats, any unit, larger is more confident)
        scale: metres per unit of the depth map, or of the measured depths
        method: a depth method to run and score: a bundled name, or your function as package.module:function or
            file.py:function, or NAME=file.py:function to name its figures; figures are METHOD.FIGURE
        metric: your own function of a depth map in metres and the truth, named like a method; it returns a number or
            a dict of numbers
        bank: with --method, a PSF bank; by default calibrated from the camera's description
        gates: a TOML file with limits; its keys are score.FIGURE
        json_file: also write the figures to this file
        junit: also write the verdicts to this file, as JUnit XML
    """
    from dasim.files.captures import load_capture, load_truth
    from recon.files.reconstruction import load_reconstruction
    from validation.gates.scored import check_score_files, judged_score, write_score
    from validation.method_scores import score_methods
    from validation.methods import named
    from validation.reports.lines import of_claims
    from validation.scores import score as scores
    from validation.scores.depth_files import SUFFIXES, read_depth, read_map
    from validation.scores.measured_truth import score_measured
    from validation.scores.metrics import load_metrics

    check_score_files(json_file, junit)
    judged_score("score", [], gates)  # raises for an unreadable file before the work begins
    methods, metrics = named(method or ()), load_metrics(metric or ())
    if methods:
        if capture is not None or confidence is not None or scale is not None:
            raise InputError(
                "--method: runs on a capture; give the capture folder alone, without map, --confidence or --scale"
            )
        photo = load_capture(result)
        truth = load_truth(result)
        with options.progress() as progress:
            figures = score_methods(photo, truth, _bank(bank, photo, progress), methods, metrics)
    elif capture is None or bank is not None:
        raise InputError("score: needs a reconstruction or depth map and its capture; --bank applies to --method")
    elif capture.is_file() and capture.suffix.lower() in SUFFIXES:
        if confidence is not None or metrics or not result.is_dir():
            raise InputError(
                f"{capture}: measured depths are compared with a reconstruction folder, which contains the camera; "
                "omit --confidence and --metric"
            )
        figures = score_measured(load_reconstruction(result), read_depth(capture, scale))
    elif result.is_file() or result.suffix.lower() in SUFFIXES:
        depth_m = read_depth(result, scale)
        trust = None if confidence is None else read_map(confidence)
        photo = load_capture(capture)
        figures = scores.score_map(depth_m, photo, load_truth(capture), trust, metrics=metrics)
    else:
        if confidence is not None or scale is not None:
            raise InputError("--confidence and --scale apply to a depth map; a reconstruction folder contains both")
        rebuilt = load_reconstruction(result)
        photo = load_capture(capture)  # also checks that the capture is complete
        truth = load_truth(capture)
        if not truth.has("sharp_e"):
            print("note: the truth lacks sharp_e, so that pictures are not scored (a dataset's key truth.keep)")
        figures = scores.score(rebuilt, photo, truth, metrics=metrics)
    for name in [f"{own}." for own in methods] or [""]:
        print(f"method {name[:-1]}" if name else "", end="\n" if name else "")
        print(scores.table([replace(f, id=f.id.removeprefix(name)) for f in figures if f.id.startswith(name)]))
    entries = judged_score("score", figures, gates)
    if limited := [entry for entry in entries if entry.limit is not None]:
        print("\n".join(of_claims(limited)))
    write_score("score", entries, json_file=json_file, junit=junit)
    return 1 if any(entry.passed is False for entry in entries) else 0
