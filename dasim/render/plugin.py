"""Spectra, transforms and tensors for Mitsuba.

Tested in tests/dasim/render/test_reflection.py.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from dasim.spectra import grid


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


def tensor(values: np.ndarray) -> Any:
    """Mitsuba's float32 tensor of an array, copied into memory that Dr.Jit allocates.

    The alignment of memory that numpy allocates varies, and Dr.Jit compiles different code for different alignments: a
    kernel that was compiled for one picture might not be reused for the next.
    """
    import drjit as dr
    import mitsuba as mi

    flat = mi.Float(np.ascontiguousarray(values, dtype=np.float32).ravel())
    copy = dr.zeros(mi.Float, values.size)
    dr.make_opaque(copy)
    dr.scatter(copy, flat, dr.arange(mi.UInt32, values.size))
    dr.eval(copy)
    return mi.TensorXf(copy, values.shape)
