"""Noise reduction (sec. 4.1): nonlocal means on each colour plane, eq. (2)-(5)."""

from __future__ import annotations

import math

import numpy as np
from numba import njit, prange

from dasim.typing import Float32Array

PATCH_PX = 3
SEARCH_PX = 9


def stabilise(electrons: Float32Array, coefficients: tuple[float, float, float]) -> Float32Array:
    """Transform electrons so that their noise has standard deviation 1 everywhere, [h, w].

    The generalised Anscombe transform for a variance a + b x + c x^2 (read, shot and pixel-gain noise):
    T(x) = int dx / sqrt(a + b x + c x^2) = ln(2 sqrt(c (a + b x + c x^2)) + 2 c x + b) / sqrt(c),
    and 2 sqrt(a + b x) / b for c = 0. The result serves for patch distances alone and is never inverted.
    """
    a, b, c = coefficients
    x = np.maximum(electrons, -0.5 * a / b).astype(np.float64)
    if c <= 0:
        return (2 / b * np.sqrt(a + b * x)).astype(np.float32)
    return (np.log(2 * np.sqrt(c * (a + b * x + c * x * x)) + 2 * c * x + b) / np.sqrt(c)).astype(np.float32)


def patch_weights(sigma_px: float, patch_px: int = PATCH_PX) -> Float32Array:
    """Gaussian weights G_rho of a patch, eq. (5), [patch, patch], with unit sum."""
    t = np.arange(patch_px) - patch_px // 2
    bell = np.exp(-0.5 * (t / sigma_px) ** 2)
    kernel = np.outer(bell, bell)
    return (kernel / kernel.sum()).astype(np.float32)


def nonlocal_means(
    plane: Float32Array, guide: Float32Array, bandwidth: float, patch_sigma_px: float = 1.0
) -> Float32Array:
    """Nonlocal means of a colour plane [h, w], eq. (3)-(5), with weights from patches of ``guide``.

    W(p, q) = exp(-(G_rho * |g(p) - g(q)|^2)(0) / bandwidth), with patches of 3x3 and a search of 9x9 plane pixels.
    ``guide`` is the plane with noise of standard deviation 1 (:func:`stabilise`), so that ``bandwidth`` is in units of
    the noise variance, for dark and bright areas alike. The mean is that of electrons, which preserves their scale.
    Borders are mirrored. ``patch_sigma_px`` is rho of eq. (5).
    """
    reach = SEARCH_PX // 2
    border = reach + PATCH_PX // 2
    wide, wide_guide = (np.pad(a, border, "symmetric").astype(np.float32) for a in (plane, guide))
    (total,), norm = nonlocal_sums(wide[None], wide_guide, patch_sigma_px, bandwidth, reach)
    return total / norm


def nonlocal_sums(
    wide: Float32Array, wide_guide: Float32Array, patch_sigma_px: float, bandwidth: float, reach: int, stride: int = 1
) -> tuple[Float32Array, Float32Array]:
    """Sums over q of W(p, q) f(q) for each image f, [n, h, w], and of W(p, q), [h, w].

    Args:
        wide: the images f, [n, h', w'], with ``reach * stride + 1`` more pixels on each side than the result.
        wide_guide: image whose 3x3 patches give W, [h', w'].
        patch_sigma_px: rho of eq. (5).
        bandwidth: tau of eq. (4).
        reach: steps of the search along each axis, in each direction.
        stride: pixels per step.
    """
    border = reach * stride + PATCH_PX // 2
    height, width = (n - 2 * border for n in wide_guide.shape)
    bell = np.sqrt(np.diag(patch_weights(patch_sigma_px)))  # the patch weights are the outer product of this
    total, norm = np.empty((len(wide), height, width), np.float32), np.empty((height, width), np.float32)
    _nonlocal_sums(wide, wide_guide, bell, np.float32(np.log2(np.e) / bandwidth), reach, stride, total, norm)
    return total, norm


# 2^f for |f| <= 1/2 by its Taylor series, to 2e-7: enough for float32.
_POWERS = tuple(np.float32(np.log(2) ** k / math.factorial(k)) for k in range(7))
_HALF, _FAINTEST = np.float32(0.5), np.float32(-126)  # as powers of 2: the smallest normal float32


@njit(cache=True, parallel=True)
def _nonlocal_sums(  # pragma: no cover - compiled
    wide: Float32Array,
    guide: Float32Array,
    bell: Float32Array,
    inverse_bandwidth: np.float32,
    reach: int,
    stride: int,
    total_out: Float32Array,
    norm_out: Float32Array,
) -> None:
    """Row by row, and all pixels of a row for one shift before the next, in loops that the compiler vectorises."""
    images, height, width = total_out.shape
    border = reach * stride
    c0, c1, c2, c3, c4, c5, c6 = _POWERS
    edge, middle = bell[0], bell[1]
    for y in prange(height):
        column = np.empty(width + 2, np.float32)
        mantissa = np.empty(width, np.float32)
        exponent = np.empty(width, np.int32)
        power = exponent.view(np.float32)
        total = np.zeros((images, width), np.float32)
        norm = np.zeros(width, np.float32)
        top = y + border
        for dy in range(-border, border + 1, stride):
            for dx in range(-border, border + 1, stride):
                here0, here1, here2 = guide[top], guide[top + 1], guide[top + 2]
                there0, there1, there2 = guide[top + dy], guide[top + dy + 1], guide[top + dy + 2]
                for x in range(width + 2):
                    above = here0[x + border] - there0[x + border + dx]
                    level = here1[x + border] - there1[x + border + dx]
                    below = here2[x + border] - there2[x + border + dx]
                    column[x] = edge * (above * above + below * below) + middle * level * level
                for x in range(width):
                    distance = edge * (column[x] + column[x + 2]) + middle * column[x + 1]
                    log2_weight = max(-distance * inverse_bandwidth, _FAINTEST)
                    whole = np.floor(log2_weight + _HALF)
                    f = log2_weight - whole
                    mantissa[x] = c0 + f * (c1 + f * (c2 + f * (c3 + f * (c4 + f * (c5 + f * c6)))))
                    exponent[x] = (np.int32(whole) + np.int32(127)) << np.int32(23)
                for x in range(width):
                    mantissa[x] *= power[x]
                    norm[x] += mantissa[x]
                for image in range(images):
                    values, sums = wide[image, top + 1 + dy], total[image]
                    for x in range(width):
                        sums[x] += mantissa[x] * values[x + border + 1 + dx]
        total_out[:, y] = total
        norm_out[y] = norm
