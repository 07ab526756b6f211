"""Small parts of Mitsuba's descriptions.

Tested in tests/dasim/render/test_reflection.py.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from dasim.spectra import grid


def spectrum_dict(values: grid.FloatArray) -> dict[str, Any]:
    """A spectral curve on the wavelength grid."""
    if not np.any(values):  # a table without any light in it is refused
        return {"type": "uniform", "value": 0.0}
    return {
        "type": "regular",
        "wavelength_min": float(grid.WAVELENGTH_NM[0]),
        "wavelength_max": float(grid.WAVELENGTH_NM[-1]),
        "values": ",".join(f"{value:.9g}" for value in values),
    }


def transform(matrix: np.ndarray) -> Any:
    """A Mitsuba transform of a [4, 4] matrix."""
    import mitsuba as mi

    return mi.ScalarTransform4f(matrix)


def tensor(values: np.ndarray) -> Any:
    """A Mitsuba tensor of an array, in memory of Dr.Jit's own.

    Borrowed memory is aligned by chance, which decides the code that reads it, and with that whether a kernel that
    was compiled for an earlier picture fits this one.
    """
    import drjit as dr
    import mitsuba as mi

    flat = mi.Float(np.ascontiguousarray(values, dtype=np.float32).ravel())
    own = dr.zeros(mi.Float, values.size)
    dr.make_opaque(own)
    dr.scatter(own, flat, dr.arange(mi.UInt32, values.size))
    dr.eval(own)
    return mi.TensorXf(own, values.shape)
