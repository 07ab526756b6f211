"""PSF banks as compressed NPZ files."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dasim.base import atomic, untrusted
from dasim.base.errors import InputError
from dasim.base.toml import parse
from dasim.camera.sensor import channels
from dasim.camera.specification import Camera
from dasim.values import LevelsBehind, PsfBank

BANK_SCHEMA = 2
_TABLES = ("kernel", "depth_m", "blur_px")  # of levels
_BEHIND = "behind_"  # prefix of the tables of levels behind the focus, where a bank has them
LARGEST_KERNEL = 2.0  # 1 for all light in one pixel, and as much again for the noise of measured kernels
KERNEL_SUM_TOLERANCE = 1e-3  # of unit sums after rounding to float32


def bank_identity(bank: PsfBank) -> dict[str, Any]:
    """Identity of a bank as plain data: SHA-256 of its arrays, camera, focus, lights, levels."""
    digest = hashlib.sha256()
    behind = () if bank.behind is None else (bank.behind.kernel, bank.behind.depth_m, bank.behind.blur_px)
    for array in (bank.kernel, bank.signature, bank.depth_m, bank.blur_px, *behind):
        digest.update(np.ascontiguousarray(array, np.float32).tobytes())
    return {
        "sha256": digest.hexdigest(),
        "camera": bank.camera.name,
        "focus_distance_m": bank.camera.lens.focus_distance_m,
        "lights": list(bank.lights),
        "levels": len(bank.depth_m),
        "levels_behind": 0 if bank.behind is None else len(bank.behind.depth_m) - 1,
        "depths_m": [float(bank.depth_m.min()), float((bank.behind or bank).depth_m.max())],
        "diffraction": bank.diffraction,
        "field_px": list(bank.field_px),
    }


def save_bank(path: Path, bank: PsfBank) -> None:
    """Write a PSF bank as one compressed ``.npz``."""
    about = {
        "schema": BANK_SCHEMA,
        "lights": bank.lights,
        "diffraction": bank.diffraction,
        "field_px": bank.field_px,
        "camera": bank.camera.model_dump(mode="json"),
    }
    with atomic.writing(path) as file:
        np.savez_compressed(
            file,
            about=np.array(json.dumps(about)),
            kernel=bank.kernel,
            signature=bank.signature,
            depth_m=bank.depth_m,
            blur_px=bank.blur_px,
            **{} if bank.behind is None else {_BEHIND + name: getattr(bank.behind, name) for name in _TABLES},
        )


def load_bank(path: Path) -> PsfBank:
    """Read a PSF bank; raises InputError if the file is missing, damaged or not a bank."""
    path = Path(path)
    if not path.is_file():
        what = "is a folder; a bank is a single .npz file" if path.is_dir() else "no such file"
        raise InputError(f"bank {path}: {what}; make one with 'dasim calibrate'")
    try:
        data = untrusted.arrays(path, f"bank {path}")
        about = untrusted.json_values(str(data["about"]), f"bank {path}: about")
        arrays = {key: data[key] for key in ("signature", *_TABLES)}
        beyond = {key: data[_BEHIND + key] for key in _TABLES} if f"{_BEHIND}kernel" in data else None
        x, y = (float(value) for value in about.get("field_px", (0.0, 0.0)))
        lights = tuple(str(light) for light in about.get("lights", ()))
    except InputError as error:
        raise InputError(f"{error}; make one with 'dasim calibrate'") from None
    except (KeyError, TypeError, ValueError, OverflowError) as error:  # entries that are missing or of another type
        raise InputError(
            f"bank {path}: is not a bank, or is damaged ({type(error).__name__}); make one with 'dasim calibrate'"
        ) from None
    if about.get("schema") != BANK_SCHEMA:
        raise InputError(f"bank {path}: is not a bank of schema {BANK_SCHEMA}; make a new one with 'dasim calibrate'")
    camera = parse(Camera, about.get("camera"), f"bank {path}: camera")
    diffraction = str(about.get("diffraction", "measured"))
    if not np.isfinite([x, y]).all():
        raise InputError(f"bank {path}: its field_px is not finite")
    count = len(channels(camera.sensor))
    _check_tables(path, arrays, (len(lights), count))
    if arrays["signature"].shape != (len(lights), count) or not np.isfinite(arrays["signature"]).all():
        raise InputError(f"bank {path}: its signature does not fit its lights and channels, or is not finite")
    if (arrays["signature"] < 0).any() or not (arrays["signature"].sum(axis=1) > 0).all():
        raise InputError(f"bank {path}: its signature has negative numbers, or a light without any response")
    if beyond is not None:
        _check_tables(path, beyond, (len(lights), count))
    _check_order(path, arrays, nearer=True)
    if beyond is not None:
        _check_order(path, beyond, nearer=False)
    behind = None if beyond is None else LevelsBehind(**beyond)
    return PsfBank(lights=lights, diffraction=diffraction, camera=camera, field_px=(x, y), behind=behind, **arrays)


def _check_tables(path: Path, arrays: dict[str, NDArray], lights_and_channels: tuple[int, int]) -> None:
    """Raise InputError if kernels, depths and blurs of levels do not fit each other, or are none."""
    kernel, levels = arrays["kernel"], len(np.atleast_1d(arrays["depth_m"]))
    lights, count = lights_and_channels
    square = kernel.ndim == 5 and kernel.shape[3] == kernel.shape[4] and kernel.shape[3] % 2 == 1
    if not square or kernel.shape[:3] != (lights, levels, count) or 0 in kernel.shape:
        raise InputError(f"bank {path}: its kernels do not fit its lights, levels and channels")
    if levels < 2:
        raise InputError(f"bank {path}: has only one level; a bank has the focus and at least one level beside it")
    if any(arrays[name].shape != (levels,) for name in ("depth_m", "blur_px")):
        raise InputError(f"bank {path}: its tables do not fit its lights and levels")
    if any(array.dtype.kind not in "iuf" for array in arrays.values()):
        raise InputError(f"bank {path}: has values that are not numbers; make a new one with 'dasim calibrate'")
    if not all(np.isfinite(array).all() for array in arrays.values()):
        raise InputError(f"bank {path}: has values that are not finite")
    if np.abs(kernel).max() > LARGEST_KERNEL:
        raise InputError(f"bank {path}: has kernels beyond {LARGEST_KERNEL:g}; a kernel of unit sum has smaller values")
    if np.abs(kernel.sum(axis=(3, 4)) - 1).max() > KERNEL_SUM_TOLERANCE or (arrays["depth_m"] <= 0).any():
        raise InputError(f"bank {path}: its kernels are not of unit sum, or its depths not above 0")


def _check_order(path: Path, arrays: dict[str, NDArray], *, nearer: bool) -> None:
    """Raise InputError unless blur grows from level to level, and depth falls (``nearer``) or grows with it."""
    blur, depth = np.diff(np.abs(arrays["blur_px"])), np.diff(arrays["depth_m"])
    if (blur <= 0).any() or ((depth >= 0) if nearer else (depth <= 0)).any():
        way = "nearer to" if nearer else "farther from"
        raise InputError(
            f"bank {path}: levels are out of order; each must have more blur than the one before, and lie {way} the "
            "lens; make a new one with 'dasim calibrate'"
        )
