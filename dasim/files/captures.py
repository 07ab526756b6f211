"""Capture folders: raw mosaic, ground truth and meta.json."""

from __future__ import annotations

import json
import shutil
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydantic import ConfigDict, Field

from dasim.base import untrusted
from dasim.base.errors import InputError, shortened
from dasim.base.toml import Specification, parse
from dasim.camera.geometry import depth_of_blur_m, intrinsic_matrix, level_blur_px
from dasim.camera.specification import Camera
from dasim.files.folders import new_folder, software_versions
from dasim.files.png import read_png16, write_png16
from dasim.files.truth import read_truth_parts, truth_of, write_truth
from dasim.values import Capture, Truth

CAPTURE_SCHEMA = 4
RAW_SCALES = tuple(2**power for power in range(11))  # factors that scale numbers of 16 down to 6 bits to 16 bits
READABLE_SCHEMAS = (
    3,
    CAPTURE_SCHEMA,
)  # 3 lacks mean_e_variance and focus_e, and states the share of noise at the median alone


def level_table(camera: Camera) -> list[dict[str, float]]:
    """Table of a camera's blur levels for ``meta.json``: level, visible blur in px and depth in metres."""
    blurs = level_blur_px(camera)
    depths = depth_of_blur_m(camera, blurs)
    return [
        {"level": k, "blur_px": float(b), "depth_m": float(d)}
        for k, (b, d) in enumerate(zip(blurs, depths, strict=True))
    ]


def save_capture(path: Path, capture: Capture, truth: Truth | None) -> None:
    """Write a capture folder: ``raw.png`` (16 bits), ``truth.exr`` (multi-part) and ``meta.json``."""
    with new_folder(path, "capture") as folder:
        if truth is not None:
            write_truth(folder / "truth.exr", truth)
        _write_picture(folder, capture)


def _write_picture(folder: Path, capture: Capture) -> None:
    """Write ``raw.png``, and ``meta.json`` with the sizes of all files of the folder."""
    write_png16(folder / "raw.png", capture.raw_dn)
    meta = capture_meta(capture) | {
        "software": software_versions(),
        "file_bytes": {file.name: file.stat().st_size for file in sorted(folder.iterdir())},
    }
    (folder / "meta.json").write_text(json.dumps(meta, indent=1) + "\n", encoding="utf-8")


def save_series(path: Path, shots: Iterable[tuple[Capture, Truth | None]]) -> None:
    """Write captures to the numbered folders ``000``, ``001``, ... of a folder, and a list of them, ``series.json``.

    The file of a truth that two successive captures share is copied.
    """
    with new_folder(path, "series of captures") as folder:
        rows: list[dict[str, Any]] = []
        last: Truth | None = None
        for number, (capture, truth) in enumerate(shots):
            name = f"{number:03d}"
            (folder / name).mkdir()
            if truth is not None and truth is last:
                shutil.copyfile(folder / rows[-1]["folder"] / "truth.exr", folder / name / "truth.exr")
            elif truth is not None:
                write_truth(folder / name / "truth.exr", truth)
            _write_picture(folder / name, capture)
            last = truth
            row = {"folder": name, "exposure_s": capture.exposure_s, "gain": capture.gain, "seed": capture.seed}
            rows.append(row | {"saturated_pixels": capture.provenance.get("saturated_pixels")})
        content = {"captures": rows, "software": software_versions()}
        (folder / "series.json").write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")


def capture_meta(capture: Capture) -> dict[str, Any]:
    """Content of ``meta.json`` except for file sizes and software versions."""
    return {
        "schema": CAPTURE_SCHEMA,
        "camera": capture.camera.model_dump(mode="json"),
        "intrinsic_matrix_px": intrinsic_matrix(capture.camera).tolist(),
        "levels": level_table(capture.camera),
        "exposure_s": capture.exposure_s,
        "gain": capture.gain,
        "seed": capture.seed,
        "illuminant": capture.illuminant,
        "provenance": capture.provenance,
    }


def load_capture(path: Path) -> Capture:
    """Read a capture folder; raises InputError if a file is missing, truncated or inconsistent with the others."""
    path = Path(path)
    meta = _read_meta(path)
    sizes = meta.get("file_bytes", {})
    if not isinstance(sizes, dict) or any(Path(name).name != name for name in sizes):
        raise InputError(f"{path}/meta.json: file_bytes must be a table of the names of files in the folder")
    for name in {"raw.png", *sizes}:
        _check_size(path / name, meta)
    return capture_of(meta, unscaled(read_png16(path / "raw.png"), meta, f"{path}/raw.png"), str(path))


def unscaled(stored: NDArray[np.uint16], meta: dict[str, Any], where: str) -> NDArray[np.uint16]:
    """Raw numbers [h, w] of a stored picture, divided by the ``raw_scale`` of its ``meta.json`` (1 where it has none).

    Raises InputError where the scale is no power of two up to 1024, or the picture has numbers between its multiples.
    """
    scale = meta.get("raw_scale", 1)
    if scale not in RAW_SCALES or isinstance(scale, bool):
        raise InputError(
            f"{where}: meta.json states raw_scale {shortened(scale)}; a power of two, 1 to 1024, is allowed"
        )
    if scale == 1:
        return stored
    if np.any(stored % np.uint16(scale)):
        raise InputError(f"{where}: has numbers that are no multiples of {scale}, the raw_scale in meta.json")
    return np.asarray(stored // np.uint16(scale), np.uint16)


def capture_of(meta: dict[str, Any], raw: NDArray[np.uint16], where: str) -> Capture:
    """Capture from the content of its ``meta.json`` and its raw picture [h, w]; raises InputError if they disagree.

    ``where`` is the name of the folder, for messages.
    """
    about = parse(_CaptureMeta, meta, f"{where}/meta.json")
    camera = about.camera
    capture = Capture(
        raw_dn=raw,
        camera=camera,
        exposure_s=about.exposure_s,
        gain=about.gain,
        seed=about.seed,
        illuminant=about.illuminant,
        provenance=about.provenance,
    )
    sensor = camera.sensor
    if raw.shape != (sensor.height_px, sensor.width_px):
        raise InputError(
            f"{where}/raw.png: is {raw.shape[1]} x {raw.shape[0]} pixels, "
            f"meta.json says {sensor.width_px} x {sensor.height_px}"
        )
    return capture


def load_truth(path: Path) -> Truth:
    """Read the ground truth of a capture folder; raises InputError if it is missing or truncated.

    Samples of a dataset may lack parts of it: see :func:`dasim.files.truth.truth_of`.
    """
    path = Path(path)
    meta = _read_meta(path)
    _check_size(path / "truth.exr", meta)
    about = parse(_CaptureMeta, meta, f"{path}/meta.json")
    return truth_of(read_truth_parts(path / "truth.exr"), about.camera, str(path / "truth.exr"))


class _CaptureMeta(Specification):
    """The keys of ``meta.json`` that define a capture; all others are informative."""

    model_config = ConfigDict(frozen=True, extra="ignore", allow_inf_nan=False)

    camera: Camera
    exposure_s: float = Field(gt=0, le=1e10)  # also of the longest exposure in the widest bracket
    gain: float = Field(ge=1e-6, le=1e6)
    seed: int = Field(ge=0, lt=2**128)
    illuminant: str | None
    provenance: dict[str, Any]


def _check_size(file: Path, meta: dict[str, Any]) -> None:
    """Raise InputError if a file of a capture is missing or does not have the size that ``meta.json`` states."""
    if not file.is_file():
        raise InputError(f"{file}: is missing; a capture holds raw.png, truth.exr and meta.json")
    sizes = meta.get("file_bytes")
    expected = sizes.get(file.name) if isinstance(sizes, dict) else None
    if expected is not None and file.stat().st_size != expected:
        raise InputError(
            f"{file}: has {file.stat().st_size} bytes instead of {expected}; it is truncated or was changed"
        )


def _read_meta(path: Path) -> dict[str, Any]:
    """Content of ``meta.json`` in a capture folder; raises InputError if there is none of our schema."""
    if path.is_file():
        raise InputError(f"capture {path}: is a file; give the folder that holds raw.png, truth.exr and meta.json")
    if not path.is_dir():
        raise InputError(f"capture {path}: no such folder (a capture holds raw.png, truth.exr and meta.json)")
    file = path / "meta.json"
    if not file.exists():
        raise InputError(f"{file}: is missing; a capture holds raw.png, truth.exr and meta.json")
    meta = untrusted.json_object(file, str(file))
    if meta.get("schema") not in READABLE_SCHEMAS:
        readable = " or ".join(map(str, READABLE_SCHEMAS))
        raise InputError(f"{file}: is not a capture of schema {readable}")
    return meta
