"""The command score: figures of reconstructions, depth maps and depth methods against the truth of a capture."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from dasim.base.errors import InputError
from dasim.camera.sensor import Sensor
from dasim.cli import options
from dasim.cli.reconstruct import bank_of


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
            figures = score_methods(photo, truth, bank_of(bank, photo, progress), methods, metrics)
    elif bank is not None:
        raise InputError("score: --bank applies to --method; omit it, or give --method with the capture folder")
    elif capture is None:
        raise InputError("score: give the capture folder, or measured depths, after RESULT (see 'dasim score --help')")
    elif capture.is_file() and capture.suffix.lower() in SUFFIXES:
        if not result.is_dir():
            raise InputError(
                f"{result}: is not a reconstruction folder, with which the measured depths in {capture} are compared; "
                "make one with 'dasim recon'"
            )
        if confidence is not None or metrics:
            raise InputError(f"{capture}: measured depths allow neither --confidence nor --metric; omit them")
        figures = score_measured(load_reconstruction(result), read_depth(capture, scale))
    elif result.is_file() or result.suffix.lower() in SUFFIXES:
        depth_m = read_depth(result, scale)
        trust = None if confidence is None else read_map(confidence)
        photo = load_capture(capture)
        figures = scores.score_map(depth_m, photo, load_truth(capture), trust, metrics=metrics)
    else:
        if confidence is not None or scale is not None:
            raise InputError(
                "--confidence, --scale: apply to a depth map; a reconstruction folder has its confidence, and depth in "
                "metres; omit them"
            )
        rebuilt = load_reconstruction(result)
        photo = load_capture(capture)  # also checks that the capture is complete
        truth = load_truth(capture)
        _check_sensor(rebuilt.camera.sensor, photo.camera.sensor, result, capture)
        if not truth.has("sharp_e"):
            print("note: the truth has no sharp_e, so pictures are not scored; add it to truth.keep of the dataset")
        figures = scores.score(rebuilt, photo, truth, metrics=metrics)
    for name in [f"{own}." for own in methods] or [""]:
        print(f"method {name[:-1]}" if name else "", end="\n" if name else "")
        print(scores.table([replace(f, id=f.id.removeprefix(name)) for f in figures if f.id.startswith(name)]))
    entries = judged_score("score", figures, gates)
    if limited := [entry for entry in entries if entry.limit is not None]:
        print("\n".join(of_claims(limited)))
    write_score("score", entries, json_file=json_file, junit=junit)
    return 1 if any(entry.passed is False for entry in entries) else 0


def _check_sensor(mine: Sensor, its: Sensor, result: Path, capture: Path) -> None:
    """Raise InputError if a reconstruction cannot be of a capture, because their mosaics or sizes differ.

    Other data of both cameras may differ: those of a data sheet from those of the hardware.
    """
    for name in ("width_px", "height_px", "mosaic"):
        if getattr(mine, name) != getattr(its, name):
            raise InputError(
                f"{result}: its {name} is {getattr(mine, name)}, that of {capture} {getattr(its, name)}; "
                "give the capture that was reconstructed"
            )
