"""The command view: a page to explore a reconstruction or a capture."""

from __future__ import annotations

from pathlib import Path

from dasim.base.errors import InputError
from dasim.cli import options

MOST_SLICES = 200


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
        out: the page, an HTML file, by default out/NAME-view.html with the folder's name; an earlier one is replaced
        capture: the capture folder of the reconstruction, for its mosaic and the truth; by default the folder
            'capture' beside the reconstruction, or NAME beside NAME-recon, if its camera is the same
        bank: the PSF bank of the reconstruction; by default calibrated from the camera's description
        slices: focus distances that are computed at the lens's own f-number, 2 or more; fewer at smaller apertures; by
            default one per blur level, at most 24
    """
    from dasim.base import atomic
    from validation.reports.view import page

    if out is None:
        out = Path("out") / f"{folder.resolve().name}-view.html"
    elif out.suffix.lower() != ".html" or out.is_dir() or not out.resolve().parent.is_dir():
        raise InputError(f"--out {out}: is not an HTML file in a folder that exists")
    if slices is not None and not 2 <= slices <= MOST_SLICES:
        raise InputError(f"--slices {slices}: must be 2 to {MOST_SLICES}")
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
        print("note: no capture found, so the page has no mosaic and no truth; give the capture with --capture")
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
