"""Deconvolution with a sparse-gradient prior about a predicted gradient, eq. (15)-(16), by half-quadratic splitting."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numba import njit
from numpy.typing import NDArray

from recon import fourier

Float32Array = NDArray[np.float32]
Complex64Array = NDArray[np.complex64]

PRIOR_POWER = 0.8  # eq. (16)
BETA_FIRST, BETA_GROWTH = 0.02, 8.0  # of half-quadratic splitting (Krishnan and Fergus 2009, sec. 3, has 2 sqrt(2))
TABLE_LIMIT, TABLE_SIZE = 64.0, 8193
SMALLEST_GRADIENT = np.float32(1e-4)  # finite at frequency 0, where every kernel passes 1 and is certain
SMALLEST_POWER = np.float32(1e-9)  # keeps a division by zero out where neither kernel nor gradient passes anything


def half_quadratic(
    image: Float32Array,
    transfer: Complex64Array,
    kappa: NDArray,
    steps: int,
    expected: tuple[Float32Array, Float32Array] | None = None,
    trust: Float32Array | None = None,
) -> Float32Array:
    """Minimise over f |h * f - I|^2 / 2 + kappa sum(|f_x - e_x|^0.8 + |f_y - e_y|^0.8), eq. (15)-(16), periodic.

    ``image`` is [channel, h, w] with noise of standard deviation 1, ``transfer`` [channel, h, w/2 + 1], ``kappa``
    [channel], ``expected`` the gradients (x, y) [channel, h, w] that the prior expects; none: 0, as in the paper.
    ``trust`` [channel, h, w/2 + 1] weighs the data's frequencies (:func:`data_trust`).
    Half-quadratic splitting: in turns, gradients shrunk towards the expected ones and f from the quadratic problem
    with them, their coupling beta growing each step.
    """
    shape = (image.shape[-2], image.shape[-1])
    gradient = gradient_power(shape)
    weighted = np.conj(transfer) if trust is None else trust * np.conj(transfer)
    data, power = weighted * fourier.forward(image, 1), np.abs(transfer * weighted)
    none = np.zeros((image.shape[0], 1, 1), np.float32)
    wanted_x, wanted_y = expected or (none, none)
    table = shrink_table()
    factor = BETA_FIRST
    result = image
    pull = np.empty_like(image)
    scale = np.empty(len(image), np.float32)
    for _ in range(steps):
        scale[:] = factor ** (-1 / (2 - PRIOR_POWER))
        _shrunk_divergence(result, wanted_x, wanted_y, table, scale, np.float32(TABLE_LIMIT), pull)
        beta = (factor * np.asarray(kappa, np.float32))[:, None, None]
        spectrum = (data + beta * fourier.forward(pull, 1)) / (power + beta * gradient + SMALLEST_POWER)
        result = fourier.inverse(spectrum, shape, 1)
        factor *= BETA_GROWTH
    return result


def quadratic(
    spectrum: Complex64Array, transfer: Complex64Array, beta: NDArray, shape: tuple[int, int]
) -> Float32Array:
    """Minimise over f |h * f - I|^2 + beta (|f_x|^2 + |f_y|^2), eq. (9)-(10), in closed form.

    ``spectrum`` is the transform of I [channel, *shape]; the others as above.
    """
    weight = np.asarray(beta, np.float32)[:, None, None] * gradient_power(shape)
    spectrum = np.conj(transfer) * spectrum
    return fourier.inverse(spectrum / (np.abs(transfer) ** 2 + weight + SMALLEST_POWER), shape, 1)


def data_trust(variance: Float32Array, steps: NDArray, shape: tuple[int, int]) -> Float32Array:
    """Weight 1 / (1 + var(H) S) of data whose transfer function is known up to ``variance`` [channel, h, w/2 + 1].

    Noise has unit density, and what an uncertain kernel adds has var(H) S, with the scene's spectrum S of white
    gradients whose mean squares along x and y add up to ``steps`` [channel].
    """
    scene = np.asarray(steps, np.float32)[:, None, None] / (gradient_power(shape) + SMALLEST_GRADIENT)
    return (1 / (1 + variance * scene)).astype(np.float32)


@lru_cache(maxsize=16)
def gradient_power(shape: tuple[int, int]) -> Float32Array:
    """|D_x|^2 + |D_y|^2 of differences on the half-plane of frequencies."""
    fy, fx = fourier.frequencies(shape)
    return (4 * np.sin(np.pi * fy) ** 2 + 4 * np.sin(np.pi * fx) ** 2).astype(np.float32)


@lru_cache(maxsize=1)
def shrink_table() -> Float32Array:
    """Minimise over u |u|^0.8 + (u - v)^2 / 2 for v from 0 to ``TABLE_LIMIT``, [TABLE_SIZE].

    The positive minimum from Newton's iteration started at v, kept where it beats u = 0.
    """
    v = np.linspace(0, TABLE_LIMIT, TABLE_SIZE)
    a = PRIOR_POWER
    u = v.copy()
    for _ in range(30):
        safe = np.maximum(u, 1e-6)
        u = np.clip(safe - (a * safe ** (a - 1) + safe - v) / (a * (a - 1) * safe ** (a - 2) + 1), 1e-6, v + 1e-6)
    cost = u**a + (u - v) ** 2 / 2
    return np.where((cost < v**2 / 2) & (v > 0), u, 0).astype(np.float32)


@njit(cache=True, nogil=True)
def _shrink(  # pragma: no cover - compiled
    step: Float32Array, table: Float32Array, unit: np.float32, limit: np.float32, out: Float32Array
) -> None:
    """Differences of a row moved towards 0, by the table in units of ``unit``; beyond its ``limit`` as they are."""
    per_step = np.float32((table.size - 1) / (limit * unit))
    last = np.float32(table.size - 2)
    for x in range(step.size):
        size = abs(step[x])
        place = size * per_step
        low = np.int32(min(place, last))
        value = (table[low] + (place - np.float32(low)) * (table[low + 1] - table[low])) * unit
        value = value if place < last else size
        out[x] = value if step[x] >= 0 else -value


@njit(cache=True, nogil=True)
def _shrunk_divergence(  # pragma: no cover - compiled
    image: Float32Array,
    wanted_x: Float32Array,
    wanted_y: Float32Array,
    table: Float32Array,
    scale: Float32Array,
    limit: np.float32,
    out: Float32Array,
) -> None:
    """D_x^T w_x + D_y^T w_y of forward differences shrunk towards the wanted ones, periodic.

    Row by row, in loops that the compiler turns into vectors; the row above the first is the last one.
    """
    channels, height, width = image.shape
    own = wanted_x.shape[1] == height and wanted_x.shape[2] == width
    zero = np.zeros(width, np.float32)
    step, along_x, along_y, above = np.empty((4, width), np.float32)
    for c in range(channels):
        for row in range(-1, height):
            y = row if row >= 0 else height - 1
            here, below = image[c, y], image[c, y + 1 if y + 1 < height else 0]
            expected = wanted_y[c, y] if own else zero
            for x in range(width):
                step[x] = below[x] - here[x] - expected[x]
            _shrink(step, table, scale[c], limit, along_y)
            for x in range(width):
                along_y[x] += expected[x]
            if row >= 0:
                expected = wanted_x[c, y] if own else zero
                for x in range(width - 1):
                    step[x] = here[x + 1] - here[x] - expected[x]
                step[width - 1] = here[0] - here[width - 1] - expected[width - 1]
                _shrink(step, table, scale[c], limit, along_x)
                for x in range(width):
                    along_x[x] += expected[x]
                found = out[c, y]
                found[0] = along_x[width - 1] - along_x[0] + above[0] - along_y[0]
                for x in range(1, width):
                    found[x] = along_x[x - 1] - along_x[x] + above[x] - along_y[x]
            above[:] = along_y
