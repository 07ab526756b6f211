"""Conversion between blur levels and depths. Levels are even steps in dioptres, because blur is linear in dioptres.

Tested in tests/recon/depth/test_method.py, tests/recon/depth/test_side.py and tests/recon/test_real_camera.py.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dasim.typing import Float32Array, FloatArray


def level_of(depth_m: ArrayLike, level_depth_m: NDArray, behind_depth_m: NDArray | None = None) -> FloatArray:
    """Fractional level of depths in metres, from the depths of a bank's levels, as in :func:`depth_of`.

    The interpolation is linear in dioptres. Outside the range, it continues with the mean step of the levels from the
    focus on: levels are negative beyond the focus (level 0), and exceed the last level in front of it.
    """
    depths, first = _table(level_depth_m, behind_depth_m)
    vergence, table = 1 / np.asarray(depth_m, np.float64), 1 / depths
    inside = np.clip(vergence, table[0], table[-1])
    between = np.interp(inside, table, np.arange(len(table)) - first)
    return np.asarray(between + (vergence - inside) / dioptres_per_level(level_depth_m))


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
    depths, first = _table(level_depth_m, behind_depth_m)
    return (1 / np.interp(level, np.arange(len(depths)) - first, 1 / depths)).astype(np.float32)


def _table(level_depth_m: NDArray, behind_depth_m: NDArray | None) -> tuple[FloatArray, int]:
    """Depths in metres of all levels, from the farthest behind the focus to the nearest, and the index of level 0."""
    behind = level_depth_m[:0] if behind_depth_m is None else behind_depth_m[:0:-1]
    return np.concatenate([behind, level_depth_m]).astype(np.float64), len(behind)
