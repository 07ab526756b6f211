"""Depth and confidence maps that another program wrote: EXR, NPY, 16-bit PNG.

Tested in tests/validation/scores/test_depth.py.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from dasim.base import untrusted
from dasim.base.errors import InputError
from dasim.files.png import read_png16
from dasim.typing import FloatArray

SUFFIXES = (".exr", ".npy", ".png")
EXR_CHANNELS = ("Z", "depth.Z", "depth", "Y", "R")  # that are tried, in this order


def read_depth(path: Path, metres_per_unit: float | None = None) -> FloatArray:
    """Read depth z in metres, [h, w]; NaN where the file has no estimate.

    EXR files (channel Z, depth, Y or R) and NPY files are in metres unless ``metres_per_unit`` is given; 16-bit PNG
    files require it, and 0 in them means no estimate. Raises InputError for a file that is not a single map.
    """
    if metres_per_unit is not None and not metres_per_unit > 0:
        raise InputError(f"--scale {metres_per_unit:g}: must be above 0, the metres of one unit")
    depth = read_map(path)
    if path.suffix.lower() == ".png":
        if metres_per_unit is None:
            raise InputError(f"{path}: a PNG holds whole numbers; say with --scale how many metres one unit is")
        depth[depth == 0] = np.nan
    depth = depth * (metres_per_unit or 1.0)
    depth[~(np.isfinite(depth) & (depth > 0))] = np.nan
    if np.isnan(depth).all():
        raise InputError(
            f"{path}: holds no depth at all; needed are metres above 0, NaN or 0 where there is no estimate"
        )
    return depth


def read_map(path: Path) -> FloatArray:
    """Read one number per pixel, [h, w], without conversion."""
    if not path.exists() or path.is_dir():
        raise InputError(f"{path}: does not exist, or is a folder that is not a reconstruction")
    suffix = path.suffix.lower()
    if suffix == ".png":
        return read_png16(path).astype(np.float64)
    if suffix == ".npy":
        values = _read_npy(path)
    elif suffix == ".exr":
        values = _read_exr(path)
    else:
        raise InputError(f"{path}: unknown kind of file; allowed are {', '.join(SUFFIXES)}")
    values = np.squeeze(values)
    if values.ndim != 2 or not np.issubdtype(values.dtype, np.number) or np.iscomplexobj(values):
        raise InputError(
            f"{path}: holds an array of shape {values.shape} and type {values.dtype}; needed is [h, w] of numbers"
        )
    return values.astype(np.float64)


def _read_npy(path: Path) -> NDArray:
    values = untrusted.array(path, str(path))
    if values.ndim:
        untrusted.check_pixels((values.size, 1), str(path))
    return values


def _read_exr(path: Path) -> NDArray:
    import OpenEXR

    untrusted.check_exr(path, str(path))
    try:
        with untrusted.quiet(), OpenEXR.File(str(path), separate_channels=True) as file:
            channels = {name: channel.pixels for part in file.parts for name, channel in part.channels.items()}
    except (OSError, ValueError, RuntimeError) as error:
        raise InputError(f"{path}: cannot be read as EXR: {error}") from None
    for name in EXR_CHANNELS:
        if name in channels:
            return np.asarray(channels[name])
    raise InputError(f"{path}: has no channel {', '.join(EXR_CHANNELS)}; it has {', '.join(channels) or 'none'}")
