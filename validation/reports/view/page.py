"""One HTML page that shows its contents in any browser, without a server and without loading anything."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import jinja2
import numpy as np

from dasim.base.errors import InputError
from dasim.camera.specification import Camera
from dasim.files.captures import load_capture, load_truth
from dasim.typing import Progress
from dasim.values import Capture, PsfBank, Reconstruction, Truth
from recon.picture.develop import develop
from recon.settings import DEFAULT
from validation.reports.view.contents import Contents, check_same, of_capture, of_reconstruction
from validation.reports.view.focal_stack import focal_stack
from validation.reports.view.packing import lossy

MOST_BYTES, AT_PIXELS = 15_000_000, 768 * 576  # largest page of frames up to this size; larger in proportion beyond
QUALITIES = (92, 85, 75)  # of WebP, the first that the page has room for
PARTS = Path(__file__).parent / "parts"
SCRIPTS = ("codec.js", "painter.js", "solid.js", "maps.js", "app.js")  # in this order
BESIDE = "capture"  # folder beside a reconstruction where `dasim demo` writes its capture


def reconstruction_page(
    result: Reconstruction,
    bank: PsfBank,
    capture: Capture | None = None,
    truth: Truth | None = None,
    *,
    slices: int | None = None,
    progress: Progress = lambda stage, share: None,
) -> str:
    """HTML page of a reconstruction.

    Args:
        result: the reconstruction.
        bank: its PSF bank, for the focal stack.
        capture: the capture it was made from, for the mosaic.
        truth: its ground truth.
        slices: focus distances at the lens's own aperture; see :func:`~.focal_stack.focus_depths_m`.
        progress: called with a stage and the share of it that is done.
    """
    stack = focal_stack(result, bank, slices, progress)
    return page(of_reconstruction(result, bank, stack, capture, truth))


def capture_page(capture: Capture, truth: Truth | None, progress: Progress = lambda stage, share: None) -> str:
    """HTML page of a capture without reconstruction."""
    progress("developing", 0.0)
    developed = develop(capture, DEFAULT, progress=lambda stage, share: progress("developing", share))
    return page(of_capture(capture, developed, truth))


def capture_of(folder: Path) -> tuple[Capture, Truth | None]:
    """Capture of a folder, with its ground truth where there is one."""
    capture = load_capture(folder)
    return capture, load_truth(folder) if (folder / "truth.exr").is_file() else None


def capture_beside(reconstruction: Path, result: Reconstruction) -> Path | None:
    """The folder ``capture`` beside a reconstruction, or NAME beside NAME-recon, if it has a capture of its camera."""
    place = reconstruction.resolve()
    for name in (BESIDE, place.name.removesuffix("-recon")):
        folder = place.parent / name
        try:
            check_same(result, load_capture(folder), str(folder))
        except InputError:
            continue
        return folder
    return None


def most_bytes_of(camera: Camera) -> int:
    """Largest size of a page in bytes."""
    return int(MOST_BYTES * max(1.0, camera.sensor.width_px * camera.sensor.height_px / AT_PIXELS))


def page(contents: Contents, most_bytes: int | None = None) -> str:
    """The page in the best quality that fits; raises InputError if none does.

    ``most_bytes`` is that of the frame by default.
    """
    most_bytes = most_bytes_of(contents.camera) if most_bytes is None else most_bytes
    size = 0
    for quality in QUALITIES:
        text = _page(contents, quality)
        size = len(text.encode())
        if size <= most_bytes:
            return text
    raise InputError(
        f"view: the page would have {size / 1e6:.1f} MB, more than {most_bytes / 1e6:g}; "
        "give fewer --slices, or a smaller frame"
    )


def _page(contents: Contents, quality: int) -> str:
    data = contents.plain() | {
        "pictures": [_picture(p.id, p.label, p.image, quality) for p in contents.pictures],
        "channels": [_picture(p.id, p.label, p.image, quality) for p in contents.channels],
        "stack": _stack(contents, quality),
    }
    environment = jinja2.Environment(loader=jinja2.FileSystemLoader(PARTS), autoescape=True)
    return environment.get_template("view.html").render(
        title=contents.title,
        facts=contents.facts,
        notes=contents.notes,
        style=(PARTS / "view.css").read_text(encoding="utf-8"),
        script="".join((PARTS / name).read_text(encoding="utf-8") for name in SCRIPTS),
        data=json.dumps(data, separators=(",", ":"), allow_nan=False).replace("<", "\\u003c"),
    )


def _picture(name: str, label: str, image: np.ndarray, quality: int) -> dict[str, Any]:
    return {"id": name, "label": label, "data": lossy(image, quality)}


def _stack(contents: Contents, quality: int) -> list[dict[str, Any]]:
    """Slices by f-number."""
    rows: dict[float, list[dict[str, Any]]] = {}
    for one in contents.stack:
        rows.setdefault(one.f_number, []).append({"depth_m": one.depth_m, "data": lossy(one.picture, quality)})
    return [{"f_number": number, "slices": slices} for number, slices in rows.items()]
