"""Light behind a stop by Huygens's principle: spherical waves from every place of the stop, added up.

Path lengths are exact distances; nothing is expanded about the axis or about the middle of the stop.

Tested in tests/validation/references/test_huygens.py.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dasim.typing import FloatArray

ROWS_AT_ONCE = 4


@dataclass(frozen=True)
class Bench:
    """A disc-shaped stop in a perfect lens, a sensor behind it and a point source before it; lengths in metres."""

    radius_m: float  # of the stop
    image_m: float  # from the lens to the sensor
    focus_m: float  # from the lens to the plane in focus
    depth_m: float  # from the lens to the plane of the source
    tangent: tuple[float, float]  # of the source's angle to the axis, (x, y): the source is at depth_m (x, y, 1)


def intensity(bench: Bench, wavelengths_nm: FloatArray, offset_m: FloatArray, cells: int) -> FloatArray:
    """Intensity around the image of the source, [wavelength, y, x], in the same units for all stops and wavelengths.

    U(P) = sum over rho of exp(i k (|Q rho| - |F rho| + |rho P| - |rho O|)) / (|Q rho| |rho P|), with Q the source, F
    the point in focus on the line from Q through the middle of the lens, and O the image of both. A perfect lens delays
    the light by -(|F rho| + |rho O|), so that all waves from F arrive at O in phase. The intensity is
    |U|^2 / (wavelength^2 area), so that equal light through the stop gives equal sums over the plane.

    Args:
        bench: stop, lens, sensor and source.
        wavelengths_nm: [wavelength].
        offset_m: places from O along x and along y, upright (as the scene is seen), [n].
        cells: of the stop, along its diameter; the phase must change by less than half a turn from cell to cell.
    """
    at = ((np.arange(cells) + 0.5) * 2 / cells - 1) * bench.radius_m
    x, y = (values.ravel() for values in np.meshgrid(at, at))
    cell_m = at[1] - at[0]
    open_share = np.clip((bench.radius_m - np.hypot(x, y)) / cell_m + 0.5, 0.0, 1.0)  # of each cell
    x, y, open_share = (values[open_share > 0] for values in (x, y, open_share))
    tx, ty = bench.tangent

    def before_lens(depth_m: float) -> FloatArray:
        return np.sqrt((tx * depth_m - x) ** 2 + (ty * depth_m - y) ** 2 + depth_m**2)

    def behind_lens(right_m: FloatArray, down_m: FloatArray) -> FloatArray:
        # What is seen at the right is imaged at the left.
        return np.sqrt((right_m + x) ** 2 + (down_m + y) ** 2 + bench.image_m**2)

    source, middle = before_lens(bench.depth_m), np.array([tx, ty]) * bench.image_m
    constant = source - before_lens(bench.focus_m) - behind_lens(middle[0], middle[1])
    result = np.empty((len(wavelengths_nm), len(offset_m), len(offset_m)))
    right = (middle[0] + offset_m)[None, :, None]
    for first in range(0, len(offset_m), ROWS_AT_ONCE):
        part = slice(first, first + ROWS_AT_ONCE)
        distance = behind_lens(right, (middle[1] + offset_m[part])[:, None, None])
        amplitude = (open_share / (source * distance)).astype(np.float32)
        path = distance + constant
        for index, wavelength_nm in enumerate(wavelengths_nm):
            turns = path / (wavelength_nm * 1e-9)
            phase = (2 * np.pi * (turns - np.rint(turns))).astype(np.float32)
            real, imaginary = ((amplitude * wave(phase)).sum(axis=-1) for wave in (np.cos, np.sin))
            result[index, part] = (real.astype(float) ** 2 + imaginary.astype(float) ** 2) / wavelength_nm**2
    return result * cell_m**2 / open_share.sum()
