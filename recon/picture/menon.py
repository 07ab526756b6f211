"""Demosaicing of a Bayer mosaic by directional filtering with a posteriori decision (sec. 4.3).

Menon, Andriani and Calvagno, "Demosaicing with directional filtering and a posteriori decision", IEEE Transactions on
Image Processing 16, 2007. Green is interpolated along rows and along columns, and the direction in which the colour
differences vary less is kept. Red and blue follow with this direction, and a last step smooths the colour differences
along it. Results are those of ``colour-demosaicing``, which tests compare with, in a tenth of the time.

Tested in tests/recon/picture/test_mosaic.py.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from dasim.typing import BoolArray, Float32Array

REACH_PX = 12  # around a pixel, on which its colours depend; even, so that mirroring preserves the mosaic's phase


@njit(cache=True, nogil=True)
def demosaic(bayer: Float32Array, red: tuple[int, int]) -> Float32Array:  # pragma: no cover - compiled
    """Colours [h, w, 3] of a Bayer mosaic [h, w], right from ``REACH_PX`` within its borders on.

    ``red`` is the position (row, column) of red in the 2x2 block; blue is diagonal to it.
    """
    height, width = bayer.shape
    by_rows, out = np.zeros((height, width), np.bool_), np.zeros((height, width, 3), np.float32)
    _green(bayer, red, by_rows, out)
    _at_green(bayer, red, out)
    for y in range(2, height - 2):  # blue at red pixels and red at blue ones
        own, first = _samples(y, red)
        for x in range(2 + first, width - 2, 2):
            down, right = (0, 1) if by_rows[y, x] else (1, 0)
            before, after = out[y - down, x - right], out[y + down, x + right]
            other = 2 - own
            out[y, x, other] = bayer[y, x] + (before[other] + after[other] - before[own] - after[own]) / 2
    _refine(bayer, red, by_rows, out)
    return out


@njit(cache=True, nogil=True)
def _samples(y: int, red: tuple[int, int]) -> tuple[int, int]:  # pragma: no cover - compiled
    """Index of the colour that a row samples beside green, 0 for red and 2 for blue, and its first column."""
    return (0, red[1]) if y % 2 == red[0] else (2, 1 - red[1])


@njit(cache=True, nogil=True)
def _at_green(bayer: Float32Array, red: tuple[int, int], out: Float32Array) -> None:  # pragma: no cover - compiled
    """Red and blue at green pixels, from the differences to green of both neighbours in the row and in the column."""
    height, width = bayer.shape
    for y in range(1, height - 1):
        own, first = _samples(y, red)
        for x in range(1 + first, width - 1, 2):
            here = out[y, x, 1]
            beside = bayer[y, x - 1] - out[y, x - 1, 1] + bayer[y, x + 1] - out[y, x + 1, 1]
            above = bayer[y - 1, x] - out[y - 1, x, 1] + bayer[y + 1, x] - out[y + 1, x, 1]
            out[y, x, own] = here + beside / 2
            out[y, x, 2 - own] = here + above / 2


@njit(cache=True, nogil=True)
def _refine(
    bayer: Float32Array, red: tuple[int, int], by_rows: BoolArray, out: Float32Array
) -> None:  # pragma: no cover - compiled
    """Green at red and blue pixels, then all other interpolated colours, from mean differences along a direction."""
    height, width = bayer.shape
    for done in range(2):
        for y in range(2, height - 2):
            own, first = _samples(y, red)
            for x in range(2 + first, width - 2, 2):
                down, right = (0, 1) if by_rows[y, x] else (1, 0)
                before, here, after = out[y - down, x - right], out[y, x], out[y + down, x + right]
                new = 1 if done == 0 else 2 - own
                mean = before[own] - before[new] + here[own] - here[new] + after[own] - after[new]
                here[new] = bayer[y, x] - mean / 3
        if done == 0:
            _at_green(bayer, red, out)


@njit(cache=True, nogil=True)
def _green(
    bayer: Float32Array, red: tuple[int, int], by_rows: BoolArray, out: Float32Array
) -> None:  # pragma: no cover - compiled
    """The mosaic's samples, and green everywhere, in ``out``; whether green was interpolated along rows."""
    height, width = bayer.shape
    green, difference, step = np.zeros((3, 2, height, width), np.float32)
    for y in range(2, height - 2):
        for x in range(2 + _samples(y, red)[1], width - 2, 2):
            here = bayer[y, x]
            beside, far_beside = bayer[y, x - 1] + bayer[y, x + 1], bayer[y, x - 2] + bayer[y, x + 2]
            above, far_above = bayer[y - 1, x] + bayer[y + 1, x], bayer[y - 2, x] + bayer[y + 2, x]
            green[0, y, x] = beside / 2 + (2 * here - far_beside) / 4
            green[1, y, x] = above / 2 + (2 * here - far_above) / 4
            difference[0, y, x] = here - green[0, y, x]
            difference[1, y, x] = here - green[1, y, x]
    for y in range(2, height - 2):
        for x in range(2, width - 2):
            step[0, y, x] = abs(difference[0, y, x] - difference[0, y, x + 2])
            step[1, y, x] = abs(difference[1, y, x] - difference[1, y + 2, x])
    rows, columns = step
    for y in range(2, height - 2):
        own, first = _samples(y, red)
        for x in range(2, width - 2):
            if x % 2 != first:
                out[y, x, 1] = bayer[y, x]
                continue
            along = rows[y - 2, x - 2] + rows[y - 2, x] + rows[y - 1, x - 1] + 3 * (rows[y, x - 2] + rows[y, x])
            along += rows[y + 1, x - 1] + rows[y + 2, x - 2] + rows[y + 2, x]
            down = columns[y - 2, x - 2] + columns[y, x - 2] + columns[y - 1, x - 1]
            down += 3 * (columns[y - 2, x] + columns[y, x])
            down += columns[y - 1, x + 1] + columns[y - 2, x + 2] + columns[y, x + 2]
            by_rows[y, x] = down >= along
            out[y, x, own] = bayer[y, x]
            out[y, x, 1] = green[0, y, x] if by_rows[y, x] else green[1, y, x]
