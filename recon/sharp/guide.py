"""The gradients that the prior of the deconvolution expects: those of a sharp guide, scaled to each channel.

Tested in tests/recon/sharp/test_sharpen.py.
"""

from __future__ import annotations

import cv2
import numpy as np
from numba import njit

from dasim.typing import Float32Array

WINDOW_PX = 5.0  # sigma of the window in which the guide's gradients are fitted to a channel's
FLOOR = 1e-3  # regularisation of that fit, relative to the mean gradient energy
BLOCK_PX = 4  # the fit is computed once per block of this side, and is linear in between
# Sigma of the window in blocks: means over blocks and linear interpolation widen it.
WINDOW_BLOCKS = np.sqrt(WINDOW_PX**2 - (BLOCK_PX**2 - 1) / 12 - BLOCK_PX**2 / 6) / BLOCK_PX


def energy(image: Float32Array) -> float:
    """Mean square gradient along x plus that along y of an image [h, w]."""
    return sum(float(np.mean(np.diff(image, axis=axis) ** 2)) for axis in (0, 1))


def expected_gradients(
    picture: Float32Array, guide: Float32Array, blurred: Float32Array, mean_energy: float
) -> tuple[Float32Array, Float32Array]:
    """Gradients (x, y) [channel, h, w] of the sharp guide [h, w], scaled to each channel of the blurred picture.

    The factor is a least-squares fit in a window around each pixel, of the gradients of the guide ``blurred`` by the
    mean of the picture's kernels, [h, w], to those of the picture: both then contain the same frequencies. All are
    periodic, of sizes that are multiples of ``BLOCK_PX``. ``mean_energy`` is that of the gradients of the blurred guide
    in the frame.
    """
    channels, height, width = picture.shape
    sums = np.empty((1 + channels, height // BLOCK_PX, width // BLOCK_PX), np.float32)
    _products(picture, blurred, sums)
    weight = 1 / (_window(sums[0]) + np.float32(FLOOR * mean_energy + 1e-12))
    expected_x, expected_y = np.empty((2, channels, height, width), np.float32)
    for channel, product in enumerate(sums[1:]):
        factor = cv2.resize(_window(product) * weight, (width, height), interpolation=cv2.INTER_LINEAR)
        _scaled(np.asarray(factor, np.float32), guide, expected_x[channel], expected_y[channel])
    return expected_x, expected_y


def _window(blocks: Float32Array) -> Float32Array:
    return np.asarray(cv2.GaussianBlur(blocks, (0, 0), WINDOW_BLOCKS, borderType=cv2.BORDER_REFLECT), np.float32)


@njit(cache=True, nogil=True, fastmath=True)
def _products(picture: Float32Array, blurred: Float32Array, out: Float32Array) -> None:  # pragma: no cover - compiled
    """Means over blocks of |grad b|^2, and of grad b . grad p of each channel, [1 + channel, h, w].

    Gradients are periodic forward differences.
    """
    channels, height, width = picture.shape
    rows, columns = out.shape[1:]
    side = height // rows
    sums = np.empty((1 + channels, width), np.float32)
    along_x, along_y = np.empty((2, width), np.float32)
    for row in range(rows):
        sums[:] = 0
        for y in range(row * side, (row + 1) * side):
            down = y + 1 if y + 1 < height else 0
            _differences(blurred[y], blurred[down], along_x, along_y)
            for x in range(width):
                sums[0, x] += along_x[x] * along_x[x] + along_y[x] * along_y[x]
            for c in range(channels):
                here, below, total = picture[c, y], picture[c, down], sums[1 + c]
                for x in range(width - 1):
                    total[x] += along_x[x] * (here[x + 1] - here[x]) + along_y[x] * (below[x] - here[x])
                last = width - 1
                total[last] += along_x[last] * (here[0] - here[last]) + along_y[last] * (below[last] - here[last])
        for c in range(1 + channels):
            for column in range(columns):
                out[c, row, column] = sums[c, column * side : (column + 1) * side].sum() / (side * side)


@njit(cache=True, nogil=True, fastmath=True)
def _differences(  # pragma: no cover - compiled
    here: Float32Array, below: Float32Array, along_x: Float32Array, along_y: Float32Array
) -> None:
    """Periodic forward differences of a row, [w]."""
    for x in range(len(here) - 1):
        along_x[x] = here[x + 1] - here[x]
    along_x[-1] = here[0] - here[-1]
    for x in range(len(here)):
        along_y[x] = below[x] - here[x]


@njit(cache=True, nogil=True, fastmath=True)
def _scaled(  # pragma: no cover - compiled
    factor: Float32Array, guide: Float32Array, along_x: Float32Array, along_y: Float32Array
) -> None:
    """Periodic forward differences of the guide times a factor, [h, w] all."""
    height, width = guide.shape
    for y in range(height):
        _differences(guide[y], guide[y + 1 if y + 1 < height else 0], along_x[y], along_y[y])
        for x in range(width):
            along_x[y, x] *= factor[y, x]
            along_y[y, x] *= factor[y, x]
