"""Levels of pixels from those of the mosaic's 2x2 blocks: linear, except at depth discontinuities ("steps").

Linear interpolation turns a step between two blocks into a ramp over a few pixels, of levels that neither surface has.
Where the blocks around a pixel differ by more than a step, they are divided at the middle of their range into a lower
and a higher side. The pixel belongs to the side whose blocks have more weight, by distance and by similarity in the
picture, and takes their weighted mean: joint bilateral upsampling (Kopf, Cohen, Lischinski, Uyttendaele, SIGGRAPH 2007)
within one side.
"""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numpy as np
from numba import njit, prange

from dasim.typing import Float32Array
from recon.depth.weighted_median import STEP_LEVELS, STEP_SHARE

# 0.03 to 0.07 tie on ``tune``.
CONTRAST = 0.07  # of the weight by likeness, root mean square over the logarithms of the channels
REACH = 2  # distance in blocks at which the weight by distance, a tent, falls to 0
FLOOR_SHARE, FLOOR_E = 0.02, 1.0  # of the mean of a channel, and electrons: added before the logarithm
LEAST_WEIGHT = np.float32(1e-9)  # by likeness: with no block alike, the nearest one is taken


class Levels(NamedTuple):
    """Levels of either sign and their confidence 0..1, [h, w] each, of pixels or of blocks."""

    level: Float32Array
    confidence: Float32Array


def interpolated(blocks: Levels, shape: tuple[int, ...]) -> Levels:
    """Levels of every pixel of a frame of a ``shape`` [h, w] from those of the 2x2 blocks, by linear interpolation."""
    size = shape[1], shape[0]
    return Levels(
        *(np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_LINEAR), np.float32) for image in blocks)
    )


def take_sides(pixels: Levels, blocks: Levels, linear_e: Float32Array, ir_e: Float32Array) -> None:
    """Replace the interpolated levels of the pixels at steps, in place.

    Args:
        pixels: levels of every pixel, [h, w], see :func:`interpolated`.
        blocks: those of the 2x2 blocks, [h/2, w/2].
        linear_e: red, green and blue of the all-in-focus picture, [h, w, 3] electrons.
        ir_e: infrared, [h, w] electrons.
    """
    picture, floor = log_picture(linear_e, ir_e, blocks.level.shape)
    of_blocks = (np.ascontiguousarray(image, np.float32) for image in blocks)
    _take_sides(*of_blocks, picture, linear_e, ir_e, floor, *pixels)


def log_picture(
    linear_e: Float32Array, ir_e: Float32Array, shape: tuple[int, ...]
) -> tuple[Float32Array, Float32Array]:
    """Logarithms of the four channels in blocks, [channel, *shape], and what is added to each before, [channel].

    ``linear_e`` [h, w, 3] and ``ir_e`` [h, w] are electrons.
    """
    channels = [*np.moveaxis(linear_e, -1, 0), ir_e]
    floor = np.array([FLOOR_SHARE * max(float(image.mean()), 0.0) + FLOOR_E for image in channels], np.float32)
    size = shape[1], shape[0]
    picture = np.stack([cv2.resize(image, size, interpolation=cv2.INTER_AREA) for image in channels])
    return np.log(np.maximum(picture, 0) + floor[:, None, None]), floor


@njit(cache=True, parallel=True)
def _take_sides(  # pragma: no cover - compiled
    level: Float32Array,
    confidence: Float32Array,
    picture: Float32Array,
    linear_e: Float32Array,
    ir_e: Float32Array,
    floor: Float32Array,
    pixel_level: Float32Array,
    pixel_confidence: Float32Array,
) -> None:
    """:func:`take_sides`, with the ``picture`` of the blocks and its ``floor``."""
    height, width = ir_e.shape
    rows, columns = level.shape
    for y in prange(height):
        own = np.empty(len(floor), np.float32)
        sums = np.empty((2, 3), np.float32)  # of the lower and the higher blocks: weight, level, confidence
        row = (y - 1) // 2  # of the first of the two nearest blocks; its centre is at 2 row + 0.5
        for x in range(width):
            column = (x - 1) // 2
            low, high = np.float32(np.inf), np.float32(-np.inf)
            for i in range(max(row + 1 - REACH, 0), min(row + REACH + 1, rows)):
                for j in range(max(column + 1 - REACH, 0), min(column + REACH + 1, columns)):
                    low, high = min(low, level[i, j]), max(high, level[i, j])
            step = float(high - low)
            if step <= STEP_LEVELS or step <= STEP_SHARE * abs(low) or step <= STEP_SHARE * abs(high):
                continue
            _log_around(y, x, linear_e, ir_e, floor, own)
            sums[:] = 0
            for i in range(max(row + 1 - REACH, 0), min(row + REACH + 1, rows)):
                for j in range(max(column + 1 - REACH, 0), min(column + REACH + 1, columns)):
                    square = np.float32(0)
                    for channel in range(len(floor)):
                        square += (own[channel] - picture[channel, i, j]) ** 2
                    near = (1 - abs((y - 0.5) / 2 - i) / REACH) * (1 - abs((x - 0.5) / 2 - j) / REACH)
                    alike = np.exp(-square / (len(floor) * 2 * CONTRAST**2))
                    weight = np.float32(near) * (alike + LEAST_WEIGHT)
                    side = 0 if level[i, j] < (low + high) / 2 else 1
                    sums[side, 0] += weight
                    sums[side, 1] += weight * level[i, j]
                    sums[side, 2] += weight * confidence[i, j]
            side = 0 if sums[0, 0] > sums[1, 0] else 1
            pixel_level[y, x], pixel_confidence[y, x] = sums[side, 1] / sums[side, 0], sums[side, 2] / sums[side, 0]


@njit(cache=True)
def _log_around(  # pragma: no cover - compiled
    y: int, x: int, linear_e: Float32Array, ir_e: Float32Array, floor: Float32Array, result: Float32Array
) -> None:
    """Logarithms of the channels of a pixel, after a binomial filter of 3 x 3 pixels against noise."""
    height, width = ir_e.shape
    result[:] = 0
    for dy in range(-1, 2):
        for dx in range(-1, 2):
            row, column = min(max(y + dy, 0), height - 1), min(max(x + dx, 0), width - 1)
            weight = np.float32((2 - abs(dy)) * (2 - abs(dx)) / 16)
            for channel in range(3):
                result[channel] += weight * linear_e[row, column, channel]
            result[3] += weight * ir_e[row, column]
    for channel in range(4):
        result[channel] = np.log(max(result[channel], np.float32(0)) + floor[channel])
