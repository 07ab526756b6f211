"""Weighted median filter of levels, guided by the picture: it moves depth discontinuities to edges of the picture.

The level of a posterior is blurred where it is uncertain on which side of a discontinuity a sample lies. The filter
replaces each level by the median of the levels around it, weighted by similarity in the picture, by distance and by
certainty (Ma, He, Wei, Sun, Wu, "Constant time weighted median filtering for stereo matching and beyond", ICCV 2013).
A few rounds turn ramps between two surfaces into discontinuities. Planes do not change, because the median of the
levels around a sample of a plane is the level of the sample. A last step sharpens the ramps of a few samples that are
left: a sample takes the largest or the smallest level beside it, whichever is closer (toggle mapping; Kramer and
Bruckner, Pattern Recognition 7, 1975).

On noisy slopes the filter leaves terraces. The result therefore follows it near the discontinuities that it found, and
elsewhere mostly the levels before it.
"""

from __future__ import annotations

import cv2
import numpy as np
from numba import njit, prange

from dasim.typing import BoolArray, Float32Array

# Chosen on the set ``tune``.
# Radius of the neighbourhood and spacing of the samples used in it, for each round, in samples. The grid of samples
# changes, because a fixed grid would leave its pattern.
ROUNDS = ((20, 4), (18, 4), (18, 4), (10, 2), (4, 1))
NEARNESS = 1.0  # standard deviation of the weight by distance, over the radius
CONTRAST = 0.1  # of the weight by likeness, root mean square over the picture's channels
LEAST_SD = 0.3  # levels, added in quadrature: limits the weight of certain levels
LEAST_EXPONENT = -12.0  # of a weight; smaller ones do not count
BINS = 128  # of a histogram, evenly in the square root of the level, with its sign
# Levels that differ by more than both, STEP_SHARE of the largest, belong to two surfaces.
STEP_LEVELS, STEP_SHARE = 1.0, 0.1
BESIDE = np.ones((3, 3), np.uint8)
# Weight of the levels before the filter: 0 at a step, OWN_SHARE from REACH samples on, and half of it for a standard
# deviation of UNSURE_SD levels.
REACH, OWN_SHARE, UNSURE_SD = 6.0, 0.75, 8.0


def filtered(level: Float32Array, sd: Float32Array, picture: Float32Array) -> Float32Array:
    """Filtered levels, [h, w].

    Args:
        level: levels of either sign, [h, w].
        sd: their standard deviations, [h, w].
        picture: logarithms of the channels, [h, w, channel].
    """
    weight, found = np.asarray(1 / np.hypot(sd, LEAST_SD), np.float32), level
    picture = np.ascontiguousarray(picture, np.float32)
    for radius, stride in ROUNDS:
        found = _round(found, weight, picture, radius, stride)
    found = _sharpened(found)
    own = np.interp(_distance(_is_step(found)), (0, REACH), (0, OWN_SHARE)) / (1 + (sd / UNSURE_SD) ** 2)
    return np.asarray(found + own * (level - found), np.float32)


def _is_step(level: Float32Array) -> BoolArray:
    """Whether the levels around each sample belong to two surfaces, [h, w]."""
    high, low = cv2.dilate(level, BESIDE), cv2.erode(level, BESIDE)
    return np.asarray(high - low > np.maximum(STEP_LEVELS, STEP_SHARE * np.maximum(np.abs(high), np.abs(low))))


def _distance(mask: BoolArray) -> Float32Array:
    """Distance of each sample from a mask, [h, w]; ``REACH`` at least if the mask is empty."""
    if not mask.any():
        return np.full(mask.shape, REACH, np.float32)
    return np.asarray(cv2.distanceTransform((~mask).astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_PRECISE), np.float32)


def _sharpened(level: Float32Array) -> Float32Array:
    """The larger or the smaller of the levels around each sample, at steps; the same levels elsewhere."""
    high, low = cv2.dilate(level, BESIDE), cv2.erode(level, BESIDE)
    return np.where(_is_step(level), np.where(level - low > high - level, high, low), level)


@njit(fastmath=True, cache=True, parallel=True)
def _round(  # pragma: no cover - compiled
    level: Float32Array, weight: Float32Array, picture: Float32Array, radius: int, stride: int
) -> Float32Array:
    """One round; a median is interpolated in the histogram's bin that it lies in."""
    height, width, channels = picture.shape
    result = np.empty_like(level)
    roots = np.sign(level) * np.sqrt(np.abs(level))
    low = min(roots.min(), np.float32(0))
    range_ = np.sqrt(max(level.max(), np.float32(0)) + np.float32(1e-3)) - low
    of_contrast = np.float32(-1 / (2 * CONTRAST * CONTRAST * channels))
    of_distance = np.float32(-1 / (2 * NEARNESS * NEARNESS * radius * radius))
    places = (roots - low) / range_ * np.float32(BINS - 1)
    for y in prange(height):
        histogram = np.empty(BINS, np.float32)
        for x in range(width):
            histogram[:] = 0
            for dy in range(-radius, radius + 1, stride):
                for dx in range(-radius, radius + 1, stride):
                    row, column, distance = y + dy, x + dx, dy * dy + dx * dx
                    # At the frame's border the surroundings stay symmetric, so that a plane stays a plane.
                    inside = abs(dy) <= min(y, height - 1 - y) and abs(dx) <= min(x, width - 1 - x)
                    if not inside or distance > radius * radius:
                        continue
                    exponent = of_distance * np.float32(distance)
                    for channel in range(channels):
                        exponent += of_contrast * (picture[row, column, channel] - picture[y, x, channel]) ** 2
                    if exponent < LEAST_EXPONENT:
                        continue
                    own = weight[row, column] * np.exp(exponent)
                    place = places[row, column]
                    first = int(place)
                    share = place - first
                    histogram[first] += own * (1 - share)
                    if first + 1 < BINS:
                        histogram[first + 1] += own * share
            half, below, bin_ = histogram.sum() / 2, np.float32(0), 0
            if half == 0:  # nothing around is alike
                result[y, x] = level[y, x]
                continue
            while bin_ < BINS - 1 and below + histogram[bin_] < half:
                below += histogram[bin_]
                bin_ += 1
            middle = (bin_ - 0.5 + (half - below) / histogram[bin_]) / (BINS - 1)
            root = low + max(middle, 0) * range_
            result[y, x] = root * abs(root)
    return result
