"""Spectra, transforms, tensors and textures for Mitsuba.

Tested in tests/dasim/render/test_reflection.py.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from dasim.spectra import grid

_ALIGNMENT = 64  # bytes, of the widest vectors


def spectrum_dict(values: grid.FloatArray) -> dict[str, Any]:
    """Mitsuba's description of a spectral curve [wavelength] on the wavelength grid."""
    if not np.any(values):  # Mitsuba refuses a table of zeros
        return {"type": "uniform", "value": 0.0}
    return {
        "type": "regular",
        "wavelength_min": float(grid.WAVELENGTH_NM[0]),
        "wavelength_max": float(grid.WAVELENGTH_NM[-1]),
        "values": ",".join(f"{value:.9g}" for value in values),
    }


def transform(matrix: np.ndarray) -> Any:
    """Mitsuba's transform of a matrix [4, 4]."""
    import mitsuba as mi

    return mi.ScalarTransform4f(matrix)


def instance(description: dict[str, Any]) -> Any:
    """A plugin of a description in the JIT variants; the description in the scalar ones."""
    import mitsuba as mi

    return description if mi.variant().startswith("scalar") else mi.load_dict(description)


def aligned(values: np.ndarray) -> np.ndarray:
    """An array, flat, as float32 (uint32 and float16 stay), at a multiple of 64 bytes: itself or a copy.

    The alignment of memory that numpy allocates varies, and Dr.Jit compiles different code for different alignments: a
    kernel that was compiled for one picture might not be reused for the next.
    """
    kind = values.dtype.type if values.dtype in (np.uint32, np.float16) else np.float32
    is_plain = values.dtype == kind and values.flags.c_contiguous and values.flags.writeable
    if is_plain and values.ctypes.data % _ALIGNMENT == 0:
        return values.reshape(-1)
    copy = aligned_zeros(values.shape, kind)
    copy[...] = values
    return copy.reshape(-1)


def aligned_zeros(shape: tuple[int, ...], kind: type = np.float32) -> np.ndarray:
    """Zeros at such an address; on processors, textures of the array share its memory."""
    size, item = int(np.prod(shape)), np.dtype(kind).itemsize
    memory: np.ndarray = np.zeros(size + _ALIGNMENT // item, kind)
    start = -memory.ctypes.data % _ALIGNMENT // item
    return memory[start : start + size].reshape(shape)


def tensor(values: np.ndarray) -> Any:
    """Mitsuba's tensor of an array, float16 or else float32, at an aligned address."""
    import mitsuba as mi

    if values.dtype == np.float16:
        return mi.TensorXf16(mi.Float16(aligned(values)), values.shape)
    return mi.TensorXf(mi.Float(aligned(values)), values.shape)


def texture(values: np.ndarray, **modes: Any) -> Any:
    """Texture of one to three dimensions of an array whose last axis holds channels, linear between its nodes.

    The texture units of graphics cards are not used: they interpolate in 256 steps between nodes (documentation of
    ``Texture`` in Dr.Jit), and bound the size of tables. On processors there are none.

    Args:
        values: [..., channel]; those of float16 are stored as such, and read in single precision.
        modes: ``filter_mode`` and ``wrap_mode`` of Dr.Jit's textures.
    """
    import mitsuba as mi

    is_half = values.dtype == np.float16
    kinds = {1: mi.Texture1f, 2: mi.Texture2f16 if is_half else mi.Texture2f, 3: mi.Texture3f}
    return kinds[values.ndim - 1](tensor(values), use_accel=False, **modes)
