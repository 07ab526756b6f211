"""The commands recon and refocus.

Tested in tests/dasim/cli/test_recon.py and tests/dasim/cli/test_refocus.py.
"""

from __future__ import annotations

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
    exposure: options.Seconds | None = None,
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
        exposure: for a raw file, exposure time in seconds, such as 0.02 or 1/60, for the dark signal; 0.01 by default,
            or that of a DNG
        gain: for a raw file, analogue gain relative to the camera's; 1 by default, or that of a DNG that dasim wrote
        focus: for a raw file, focus distance in metres; the camera's by default
        bank: a PSF bank; by default one is calibrated for the camera and focus of the capture and stored in the cache
        preset: best (the default), fast, bands, paper, likelihood or chakrabarti-zickler
        settings: a TOML file of settings, as --print-settings writes it; those left out have the values of the preset
            paper; excludes --preset
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
    if flat is not None and flat.is_dir() != capture.is_dir():
        raise InputError(
            f"--flat {flat}: is a {'folder' if flat.is_dir() else 'file'}, capture {capture} is not; give a flat in "
            "the format of the capture"
        )
    time_s = None if exposure is None else options.seconds("--exposure", exposure)
    shot, even = (
        None if path is None else load_input(path, model, kind=format_, exposure_s=time_s, gain=gain)
        for path in (capture, flat)
    )
    assert shot is not None
    if even is not None:
        reconstruction.check_flat(even, shot.camera)
    if "IR" not in grids(shot.camera):  # before a bank is calibrated
        return _picture_alone(shot, even, parameters, bank, out)
    with options.progress() as progress:
        kernels = bank_of(bank, shot, progress)
        result = reconstruction.reconstruct(
            shot, kernels, parameters, flat=even, progress=lambda s, x: progress("reconstructing", x)
        )
        notes = save_reconstruction(out, result, also or (), raw_dn=shot.raw_dn)
    for note in notes:
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


def bank_of(path: Path | None, shot: Capture, progress: Progress) -> PsfBank:
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
