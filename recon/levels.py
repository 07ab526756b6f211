"""Conversion between blur levels and depths. Levels are even steps in dioptres, because blur is linear in dioptres.

Tested in tests/recon/depth/test_method.py, tests/recon/depth/test_side.py and tests/recon/test_real_camera.py.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dasim.typing import Float32Array, FloatArray


def level_of(depth_m: ArrayLike, level_depth_m: NDArray) -> FloatArray:
    """Fractional level of depths in metres, from the depths ``level_depth_m`` [level] of a bank's levels.

    The interpolation is linear in dioptres. Outside the range, it is the line through the first and the last level:
    levels are negative beyond the focus (level 0), and exceed the last level in front of it.
    """
    vergence, table = 1 / np.asarray(depth_m, np.float64), 1 / np.asarray(level_depth_m, np.float64)
    last = len(table) - 1
    between = np.interp(vergence, table, np.arange(len(table)))
    line = (vergence - table[0]) / (table[-1] - table[0]) * last
    return np.where((vergence < table[0]) | (vergence > table[-1]), line, between)


def level_sd_of(sd_m: NDArray, depth_m: NDArray, level_depth_m: NDArray) -> FloatArray:
    """Standard deviation in levels from one in metres: sd_m / z^2 is the standard deviation in dioptres."""
    return np.asarray(sd_m / depth_m.astype(np.float64) ** 2 / dioptres_per_level(level_depth_m))


def dioptres_per_level(level_depth_m: NDArray) -> float:
    """Mean vergence difference between neighbouring levels, 1/m, from their depths [level] in metres."""
    return (1 / float(level_depth_m[-1]) - 1 / float(level_depth_m[0])) / (len(level_depth_m) - 1)


def depth_of(level: NDArray, level_depth_m: NDArray, behind_depth_m: NDArray | None = None) -> Float32Array:
    """Depth in metres of levels: ``level_depth_m`` [level] interpolated in dioptres, clamped to its ends.

    ``behind_depth_m`` [level] are the depths of the levels behind the focus, from it outwards, which level -1, -2 and
    so on denote.
    """
    behind = level_depth_m[:0] if behind_depth_m is None else behind_depth_m[:0:-1]
    depth_m = np.concatenate([behind, level_depth_m])
    return (1 / np.interp(level, np.arange(len(depth_m)) - len(behind), 1 / depth_m)).astype(np.float32)
