"""The all-in-focus picture (sec. 5.4): each blur level deconvolved with a sparse-gradient prior, eq. (15)-(17)."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray

from recon import fourier
from recon.settings import Settings

Float32Array = NDArray[np.float32]
Complex64Array = NDArray[np.complex64]

PRIOR_POWER = 0.8  # eq. (16)
BETA_FIRST, BETA_GROWTH = 0.02, 2.0 * np.sqrt(2.0)  # of half-quadratic splitting (Krishnan and Fergus 2009, sec. 3)
TABLE_LIMIT, TABLE_SIZE = 64.0, 8193
DENSE_LEVELS, SPARSE_STEP = 8, 2  # every level up to here is deconvolved, then each second one
FEATHER_LEVELS = 1.0  # beyond the levels a layer serves: there the picture itself fades into its replacement
MARGIN_PX = 8


def sharpen(
    image: Float32Array,
    level: Float32Array,
    kernels: NDArray,
    noise_e: NDArray,
    settings: Settings,
) -> Float32Array:
    """All-in-focus picture [h, w, channel] from a linear one, its level map [h, w] and the bank's kernels.

    ``kernels`` is [level, channel, size, size], ``noise_e`` [channel] the noise's standard deviation. Each
    level that occurs is deconvolved; a pixel takes its value between the two nearest levels, eq. (17).
    Deviations from the paper: the regularised level map with fractions, not the raw one (no seams); what lies
    at other levels is replaced beforehand by a first estimate blurred to this level, because each
    layer's deconvolution assumes one blur everywhere; level 0, in focus, stays as captured.
    """
    nodes = _nodes(len(kernels))
    share = _shares(level, nodes)
    draft = _draft(image, share, nodes, kernels, noise_e)
    result = share[0][..., None] * image
    for index in range(1, len(nodes)):
        if not share[index].any():
            continue
        near = _near(level, nodes, index)
        rows, columns = _bounds(near > 0, kernels.shape[-1] // 2 + MARGIN_PX)
        box = (rows, columns)
        for channel in range(image.shape[-1]):
            kernel = kernels[nodes[index], channel]
            sharp = _layer(image[box][..., channel], draft[box][..., channel], near[box], kernel,
                           float(noise_e[channel]), settings)  # fmt: skip
            result[box][..., channel] += share[index][box] * sharp
    return np.maximum(result, 0)


def _nodes(levels: int) -> list[int]:
    """Levels that are deconvolved, from 0: blur grows slowly relative to itself at large levels."""
    dense = list(range(min(DENSE_LEVELS, levels)))
    return dense + list(range(DENSE_LEVELS, levels, SPARSE_STEP))


def _shares(level: Float32Array, nodes: list[int]) -> list[Float32Array]:
    """Weight of each node at each pixel: linear between neighbouring nodes, summing to 1."""
    position = np.interp(level, nodes, np.arange(len(nodes))).astype(np.float32)
    return [np.maximum(1 - np.abs(position - index), 0).astype(np.float32) for index in range(len(nodes))]


def _near(level: Float32Array, nodes: list[int], index: int) -> Float32Array:
    """1 where a node serves, falling to 0 over ``FEATHER_LEVELS`` beyond its neighbours."""
    below, above = nodes[index - 1], nodes[min(index + 1, len(nodes) - 1)]
    distance = np.maximum(below - level, level - above)
    return np.clip(1 - distance / FEATHER_LEVELS, 0, 1).astype(np.float32)


def _bounds(mask: NDArray, margin: int) -> tuple[slice, slice]:
    """Smallest box around a mask with a margin, within the frame."""
    found = []
    for axis, size in enumerate(mask.shape):
        index = np.flatnonzero(mask.any(axis=1 - axis))
        found.append(slice(max(int(index[0]) - margin, 0), min(int(index[-1]) + 1 + margin, size)))
    return found[0], found[1]


def _draft(
    image: Float32Array, share: list[Float32Array], nodes: list[int], kernels: NDArray, noise_e: NDArray
) -> Float32Array:  # fmt: skip
    """First all-in-focus estimate with the quadratic prior of eq. (10), in closed form over the whole frame."""
    shape = fourier.fast_shape(image.shape, kernels.shape[-1])
    height, width = image.shape[:2]
    gradient = _gradient_power(shape)
    draft = share[0][..., None] * image
    for channel in range(image.shape[-1]):
        padded = fourier.pad_blended(image[..., channel], shape)
        spectrum = fourier.forward(padded)
        beta = np.float32(_variance_ratio(image[..., channel], float(noise_e[channel])))
        for index in range(1, len(nodes)):
            if share[index].any():
                transfer = fourier.transfer(kernels[nodes[index], channel], shape)
                quotient = np.conj(transfer) / (np.abs(transfer) ** 2 + beta * gradient + np.float32(1e-9))
                sharp = fourier.inverse(spectrum * quotient, shape)[:height, :width]
                draft[..., channel] += share[index] * sharp
    return np.maximum(draft, 0)


def _variance_ratio(image: Float32Array, noise_e: float) -> float:
    """Weight beta of the quadratic prior: noise variance over the mean square of the picture's differences."""
    steps = 0.5 * (np.mean(np.diff(image, axis=0) ** 2) + np.mean(np.diff(image, axis=1) ** 2))
    return noise_e**2 / max(float(steps), 1e-3 * noise_e**2, 1e-12)


def _gradient_power(shape: tuple[int, int]) -> Float32Array:
    """|D_x|^2 + |D_y|^2 of differences on the half-plane of frequencies."""
    fy, fx = fourier.frequencies(shape)
    return (4 * np.sin(np.pi * fy) ** 2 + 4 * np.sin(np.pi * fx) ** 2).astype(np.float32)


def _layer(
    image: Float32Array, draft: Float32Array, near: Float32Array, kernel: NDArray, noise_e: float, settings: Settings
) -> Float32Array:
    """One level and channel deconvolved, [h, w]: outside ``near`` the draft blurred to this level stands in."""
    shape = fourier.fast_shape(image.shape, kernel.shape[-1])
    transfer = fourier.transfer(kernel, shape)
    inner = (slice(0, image.shape[0]), slice(0, image.shape[1]))
    if near.min() < 1:
        blurred = fourier.inverse(fourier.forward(fourier.pad_blended(draft, shape)) * transfer, shape)[inner]
        image = near * image + (1 - near) * blurred
    noise = max(noise_e, 1e-3)
    steps = np.concatenate([np.abs(np.diff(draft, axis=0)).ravel(), np.abs(np.diff(draft, axis=1)).ravel()])
    spread = max(float(np.mean((steps / noise) ** PRIOR_POWER)), 1e-6)
    # exp(-kappa |g|^a) has E |g|^a = 1 / (a kappa): the prior's scale as the draft itself shows it
    kappa = 1 / (PRIOR_POWER * spread) / settings.sharpen_strength
    padded = fourier.pad_blended(image, shape) / np.float32(noise)
    return half_quadratic(padded, transfer, kappa, settings.sharpen_steps)[inner] * np.float32(noise)


def half_quadratic(image: Float32Array, transfer: Complex64Array, kappa: float, steps: int) -> Float32Array:
    """Minimise over f |h * f - I|^2 / 2 + kappa sum(|f_x|^0.8 + |f_y|^0.8), eq. (15)-(16), periodic frame.

    ``image`` has noise of standard deviation 1. Half-quadratic splitting: in turns, gradients w shrunk
    towards sparsity and f from the quadratic problem with them, their coupling beta growing each step.
    """
    shape = image.shape
    gradient = _gradient_power(shape)
    data, power = np.conj(transfer) * fourier.forward(image), np.abs(transfer) ** 2
    table = shrink_table()
    beta = BETA_FIRST * kappa
    result = image
    for _ in range(steps):
        scale = (kappa / beta) ** (1 / (2 - PRIOR_POWER))
        pull = np.empty_like(result)
        _shrunk_divergence(result, table, np.float32(scale), np.float32(TABLE_LIMIT), pull)
        spectrum = (data + np.float32(beta) * fourier.forward(pull)) / (
            power + np.float32(beta) * gradient + np.float32(1e-9)
        )
        result = fourier.inverse(spectrum, shape)
        beta *= BETA_GROWTH
    return result


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


@njit(cache=True, parallel=True)
def _shrunk_divergence(
    image: Float32Array, table: Float32Array, scale: np.float32, limit: np.float32, out: Float32Array
) -> None:  # pragma: no cover - compiled
    """D_x^T w_x + D_y^T w_y of the shrunk forward differences, periodic."""
    height, width = image.shape
    per_step = (table.shape[0] - 1) / limit

    for y in prange(height):
        down = (y + 1) % height
        up = (y - 1) % height
        for x in range(width):
            right = (x + 1) % width
            left = (x - 1) % width
            here = image[y, x]
            total = np.float32(0)
            for step, sign in (
                (here - image[y, left], 1.0),
                (image[y, right] - here, -1.0),
                (here - image[up, x], 1.0),
                (image[down, x] - here, -1.0),
            ):
                size = abs(step) / scale
                if size >= limit:
                    shrunk = size
                else:
                    place = size * per_step
                    low = int(place)
                    part = place - low
                    high = min(low + 1, table.shape[0] - 1)
                    shrunk = (1 - part) * table[low] + part * table[high]
                total += np.float32(sign * shrunk * scale * (1.0 if step >= 0 else -1.0))
            out[y, x] = total
