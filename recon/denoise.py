"""Noise reduction (sec. 4.1): nonlocal means on each colour plane, eq. (2)-(5)."""

from __future__ import annotations

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray

Float32Array = NDArray[np.float32]

PATCH_PX = 3
SEARCH_PX = 9


def stabilise(electrons: Float32Array, coefficients: tuple[float, float, float]) -> Float32Array:
    """Map electrons so that their noise has standard deviation 1 everywhere, [h, w].

    The generalised Anscombe transform for a variance a + b x + c x^2 (read, shot and pixel-gain noise):
    T(x) = int dx / sqrt(a + b x + c x^2) = ln(2 sqrt(c (a + b x + c x^2)) + 2 c x + b) / sqrt(c);
    without the last term 2 sqrt(a + b x) / b. Used for distances only, so it is never inverted.
    """
    a, b, c = coefficients
    x = np.maximum(electrons, -0.5 * a / b).astype(np.float64)
    if c <= 0:
        return (2 / b * np.sqrt(a + b * x)).astype(np.float32)
    return (np.log(2 * np.sqrt(c * (a + b * x + c * x * x)) + 2 * c * x + b) / np.sqrt(c)).astype(np.float32)


def patch_weights(sigma_px: float, patch_px: int = PATCH_PX) -> Float32Array:
    """Gaussian weights G_rho of a patch, eq. (5), [patch, patch], of unit sum."""
    t = np.arange(patch_px) - patch_px // 2
    bell = np.exp(-0.5 * (t / sigma_px) ** 2)
    kernel = np.outer(bell, bell)
    return (kernel / kernel.sum()).astype(np.float32)


def nonlocal_means(
    plane: Float32Array, guide: Float32Array, bandwidth: float, patch_sigma_px: float = 1.0
) -> Float32Array:
    """Nonlocal means of a colour plane [h, w], eq. (3)-(5), weights from patches of ``guide``.

    W(p, q) = exp(-(G_rho * |g(p) - g(q)|^2)(0) / bandwidth), patches of 3x3, search of 9x9 pixels of the plane.
    ``guide`` is the plane with noise of standard deviation 1 (:func:`stabilise`), so that ``bandwidth`` is in
    units of the noise variance and fits dark and bright areas alike; the mean itself is taken of electrons,
    which keeps their scale. Borders are mirrored.
    """
    reach = SEARCH_PX // 2
    border = reach + PATCH_PX // 2
    wide, wide_guide = np.pad(plane, border, "symmetric"), np.pad(guide, border, "symmetric")
    out = np.empty_like(plane, dtype=np.float32)
    _nonlocal_means(wide, wide_guide, patch_weights(patch_sigma_px), np.float32(1 / bandwidth), reach, out)
    return out


@njit(cache=True, parallel=True, fastmath=False)
def _nonlocal_means(  # pragma: no cover - compiled
    plane: Float32Array,
    guide: Float32Array,
    patch: Float32Array,
    inverse_bandwidth: np.float32,
    reach: int,
    out: Float32Array,
) -> None:
    half = patch.shape[0] // 2
    border = reach + half
    for y in prange(out.shape[0]):
        for x in range(out.shape[1]):
            cy, cx = y + border, x + border
            total = np.float32(0)
            norm = np.float32(0)
            for dy in range(-reach, reach + 1):
                for dx in range(-reach, reach + 1):
                    distance = np.float32(0)
                    for j in range(-half, half + 1):
                        for i in range(-half, half + 1):
                            step = guide[cy + j, cx + i] - guide[cy + dy + j, cx + dx + i]
                            distance += patch[j + half, i + half] * step * step
                    weight = np.exp(-distance * inverse_bandwidth)
                    total += weight * plane[cy + dy, cx + dx]
                    norm += weight
            out[y, x] = total / norm
