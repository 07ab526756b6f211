"""The command calibrate: a PSF bank from pictures of a point source."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

from dasim.base.errors import InputError
from dasim.cli import options
from dasim.typing import Progress

if TYPE_CHECKING:
    from dasim.camera.specification import Camera
    from dasim.values import PsfBank


def calibrate(
    *,
    out: Path | None = None,
    camera: str = "da-mobile",
    focus: float | None = None,
    illuminant: Annotated[list[str] | None, Parameter(negative="")] = None,
    diffraction: str | None = None,
    field: options.Size | None = None,
    captures: Path | None = None,
    format_: Annotated[str | None, Parameter(name="--format")] = None,
    print_distances: Annotated[bool, Parameter(negative="")] = False,
    save_captures: Path | None = None,
) -> int:
    """Measure a PSF bank from pictures of a point source, simulated or your own.

    Args:
        out: output file of the bank, out/CAMERA.npz by default; an earlier bank there is replaced
        camera: a bundled name or a TOML file
        focus: focus distance in metres; the camera's by default
        illuminant: for simulated pictures, a light of the bank (may be repeated); all lights by default
        diffraction: for simulated pictures: wave (the default), airy or off; use that of the captures
        field: X,Y: place of the source's image in pixels from the optical axis, x to the right, y down; by default the
            middle of the camera's frame. For your own pictures 0,0: on the axis
        captures: a folder with your own pictures: raw files, and captures.csv with one line per file (columns file,
            light, depth_m, exposure_s; optionally gain, and position if the source stood at several places)
        format_: for your own pictures: raw10, raw12, raw16 or left-aligned, see 'dasim recon --help'
        print_distances: print the distances from the lens at which to photograph the point source, and exit
        save_captures: write the simulated pictures to this folder in the format that --captures reads, and exit
    """
    import dasim
    import recon
    from dasim.files.banks import save_bank
    from dasim.files.folders import check_output
    from dasim.simulation.calibration import CALIBRATION_LIGHTS
    from dasim.simulation.checks import check_options
    from dasim.spectra import illuminants
    from recon.files.point_pictures import KIND

    model = dasim.load_camera(camera)
    if focus is not None:
        model = dasim.refocused(model, focus)
    if print_distances:
        return _print_distances(model)
    if captures is not None and (illuminant or diffraction or save_captures):
        raise InputError(
            "--captures: your own pictures determine lights and diffraction; omit --illuminant, --diffraction and "
            "--save-captures"
        )
    if save_captures is not None and out is not None:
        raise InputError("--save-captures: writes pictures and no bank; omit --out")
    if captures is None and format_ is not None:
        raise InputError("--format: applies to your own pictures; give their folder with --captures")
    field_px = None if field is None else options.place("--field", field)
    lights = tuple(dict.fromkeys(illuminant or CALIBRATION_LIGHTS))
    for light in lights:
        illuminants.illuminant(light)
    check_options(None, 0, diffraction)
    if save_captures is not None:
        check_output(save_captures, KIND)
        return _save_captures(save_captures, model, lights, diffraction or "wave", field_px)
    if out is None:
        out = options.default_out(camera, ".npz")
    _check_bank_output(out)
    with options.progress() as progress:
        if captures is None:
            pictures = dasim.calibration_captures(model, lights, diffraction=diffraction or "wave", field_px=field_px)
            bank = recon.calibrate(pictures, progress=progress)
        else:
            bank, notes = _measured_bank(captures, model, format_, field_px or (0.0, 0.0), progress)
            for note in notes:
                print(f"note: {note}")
    save_bank(out, bank)
    print(f"bank: {out} ({', '.join(bank.lights)}; {len(bank.depth_m)} levels, {bank.depth_m[-1]:.3g} to "
          f"{bank.depth_m[0]:.3g} m)")  # fmt: skip
    return 0


def _print_distances(camera: Camera) -> int:
    import numpy as np

    from dasim.camera.geometry import depth_of_blur_m
    from dasim.simulation.calibration import levels, levels_behind
    from recon.files.point_table import DEPTH_TOLERANCE

    (depths, blurs), (behind_m, behind_px) = levels(camera), levels_behind(camera)
    numbers = range(1 - len(behind_m), len(depths))
    depths, blurs = np.append(behind_m[:0:-1], depths), np.append(behind_px[:0:-1], blurs)
    margin = DEPTH_TOLERANCE * (blurs[-1] - blurs[-2])
    nearest, farthest = (depth_of_blur_m(camera, blurs + side * margin) for side in (1, -1))
    farthest = np.where(farthest > 0, farthest, np.inf)
    print(
        f"# camera '{camera.name}' focused at {camera.lens.focus_distance_m:g} m: metres from the lens to the pinhole;"
    )
    print("# a picture is assigned to a level from from_m to to_m; you may stop after any level, without gaps")
    print("level  distance_m   from_m     to_m  blur_px")
    for row in zip(numbers, depths, nearest, farthest, blurs, strict=True):
        print("{:>5}  {:>10.5f}  {:>7.5f}  {:>7.5f}  {:>7.1f}".format(*row))
    return 0


def _save_captures(
    out: Path, camera: Camera, lights: tuple[str, ...], diffraction: str, field_px: tuple[float, float] | None
) -> int:
    from dasim.simulation.calibration import calibration_captures
    from recon.files.point_pictures import write_point_pictures

    pictures = calibration_captures(camera, lights, diffraction=diffraction, field_px=field_px)
    count = write_point_pictures(out, pictures, camera)
    print(f"captures: {out} ({count} pictures of {', '.join(lights)})")
    return 0


def _measured_bank(
    folder: Path, camera: Camera, kind: str | None, field_px: tuple[float, float], progress: Progress
) -> tuple[PsfBank, tuple[str, ...]]:
    """A bank from a user's own pictures, and notes on it."""
    from dasim.simulation.calibration import levels, levels_behind
    from dasim.spectra import illuminants
    from recon import calibrate as calibrate_bank
    from recon.files.point_pictures import read_point_pictures

    behind = len(levels_behind(camera)[0]) - 1
    pictures = read_point_pictures(
        folder, camera, *levels(camera), known_light=illuminants.illuminant, behind=behind, kind=kind, progress=progress
    )
    bank = calibrate_bank(pictures.pictures, camera, field_px=field_px, progress=progress)
    return bank, pictures.notes


def _check_bank_output(out: Path) -> None:
    """Raise InputError if the output exists and is not a bank."""
    from dasim.files.banks import load_bank
    from dasim.files.folders import check_output_file

    if out.is_file():
        try:
            load_bank(out)
        except InputError:
            raise InputError(f"output {out}: exists and is not a PSF bank; choose another name") from None
    check_output_file(out)
