"""The fixed pattern of a sensor: what differs from pixel to pixel and is the same in every frame of one camera.

Sensitivity (PRNU), offset of pixels, rows and columns (DSNU), and dark current with its hot pixels belong to the sensor
``sensor_seed``, not to a frame. They are drawn in tiles that are counted from the pixel that the optical axis meets, so
that a window anywhere on the sensor has the pattern of that part of the whole.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from dasim.camera.sensor import Sensor, principal_point
from dasim.typing import Float32Array, FloatArray

TILE_PX = 64
_STAGES = {"prnu": 1, "dsnu": 2, "row": 3, "column": 4, "dark": 5, "hot": 6}
_FIRST_TILE = 2**20  # keys are not negative: tiles are counted from here

Draw = Callable[[np.random.Generator, tuple[int, ...]], NDArray]


class FixedPattern(NamedTuple):
    """Sensitivity, offset and dark current of each pixel of a frame, [h, w]."""

    sensitivity: Float32Array  # relative to the mean, 1 + PRNU
    offset_e: Float32Array  # of the read-out: pixels, rows and columns
    dark_e_s: FloatArray  # dark current at the sensor's temperature


def fixed_pattern(sensor: Sensor, shape: tuple[int, int]) -> FixedPattern:
    """The fixed pattern of the sensor, or of a frame of another ``shape`` [h, w] with the optical axis in its middle.

    Sensitivities are normal with the standard deviation ``prnu``, offsets normal with ``dsnu_e``, ``row_noise_e`` and
    ``column_noise_e``. Dark currents are log-normal about the sensor's mean, with the relative standard deviation
    ``dark_current_spread``. The share ``hot_pixel_share`` of the pixels has, in addition, an exponentially distributed
    current of the mean ``hot_pixel_e_s`` at 25 C.
    """
    seed = sensor.sensor_seed or 0
    height, width = shape
    axis_px = principal_point(sensor) if shape == (sensor.height_px, sensor.width_px) else (width / 2, height / 2)
    left, top = (-math.floor(place) for place in axis_px)

    def plane(stage: str, draw: Draw = np.random.Generator.standard_normal) -> Float32Array:
        return _drawn((seed, _STAGES[stage]), (top, left), (height, width), draw)

    def line(stage: str, first: int, count: int) -> Float32Array:
        return _drawn((seed, _STAGES[stage]), (first,), (count,), np.random.Generator.standard_normal)

    offset = sensor.dsnu_e * plane("dsnu")
    offset += sensor.row_noise_e * line("row", top, height)[:, None]
    offset += sensor.column_noise_e * line("column", left, width)[None, :]
    sensitivity = 1.0 + sensor.prnu * plane("prnu")
    log_variance = np.log1p(sensor.dark_current_spread**2)
    spread = np.exp(np.sqrt(log_variance) * plane("dark") - log_variance / 2)
    uniform = plane("hot", np.random.Generator.random)
    hot = uniform < sensor.hot_pixel_share
    # The uniform numbers below the share, divided by it, are uniform again: their logarithm is exponential.
    current = np.zeros(shape)
    current[hot] = -np.log1p(-uniform[hot] / sensor.hot_pixel_share)
    with np.errstate(over="ignore"):  # an infinite current is harmless: it only fills the well
        dark = (sensor.dark_current_e_s * spread + sensor.hot_pixel_e_s * current) * dark_heat(sensor)
    return FixedPattern(sensitivity, offset, dark)


def dark_heat(sensor: Sensor) -> float:
    """Dark current at the sensor's temperature over that at 25 C; it doubles every ``dark_doubling_k``."""
    heat: float = 2.0 ** ((sensor.temperature_c - 25.0) / sensor.dark_doubling_k)
    return heat


@lru_cache(maxsize=len(_STAGES))
def _drawn(
    key: tuple[int, int],
    first: tuple[int, ...],
    shape: tuple[int, ...],
    draw: Draw,
) -> Float32Array:
    """Random numbers at positions ``first`` to ``first`` + ``shape``; they depend on the position, not the window."""
    tiles = [range(low // TILE_PX, (low + size - 1) // TILE_PX + 1) for low, size in zip(first, shape, strict=True)]
    whole = np.empty([len(axis) * TILE_PX for axis in tiles], np.float32)
    for index in np.ndindex(*(len(axis) for axis in tiles)):
        place = [_FIRST_TILE + axis[i] for axis, i in zip(tiles, index, strict=True)]
        generator = np.random.Generator(np.random.Philox(np.random.SeedSequence((*key, *place))))
        where = tuple(slice(i * TILE_PX, (i + 1) * TILE_PX) for i in index)
        whole[where] = draw(generator, (TILE_PX,) * len(index))
    inner = tuple(
        slice(low - axis[0] * TILE_PX, low - axis[0] * TILE_PX + size)
        for low, axis, size in zip(first, tiles, shape, strict=True)
    )
    drawn = whole[inner]
    drawn.flags.writeable = False  # all frames of a camera share it
    return drawn
