"""Comparison of two channels at one blur level (sec. 5.2), eq. (9)-(11): deblur, reblur, correlate.

Tested in tests/recon/depth/test_level_score.py.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from dasim.typing import Complex64Array, Float32Array
from recon.depth.grid import Grid, Window, noise_gain, plane_mean, window_mean

SMALLEST = float(np.finfo(np.float32).tiny)
MIN_WEIGHT = 1e-9  # smallest beta: keeps the closed form finite where the transfer function is 0


class Weights(NamedTuple):
    """beta of eq. (9) for the sharper channel and for green: noise variance divided by the texture's power."""

    sharper: float
    green: float


def weight_of(transfers: Complex64Array, snr: float, grid: Grid, prior_factor: float) -> float:
    """Beta of eq. (9): noise variance divided by A, for a texture of power spectrum A / (|D_x|^2 + |D_y|^2).

    A is measured: it follows from ``snr``, the ratio of gradient energy to noise in the picture, and the mean power of
    the transfer functions [level, h, w/2 + 1]. ``prior_factor`` multiplies the result.
    """
    share = (np.abs(transfers) ** 2).mean(axis=0) / np.maximum(grid.gradient, 1e-6)
    signal = sum(plane_mean(np.abs(f) ** 2 * share, grid.shape[1]) for f in grid.filters)
    noise = noise_gain(grid.filters, grid.shape[1])
    return max(prior_factor * signal / (max(snr, SMALLEST) * noise), MIN_WEIGHT)


def reblur(infrared: Complex64Array, green: Complex64Array, beta: float, gradient: Float32Array) -> Complex64Array:
    """Filter that deblurs infrared and blurs it as green is blurred, [h, w/2 + 1]: eq. (9)-(10) in closed form.

    H_G conj(H_IR) / (|H_IR|^2 + beta (|D_x|^2 + |D_y|^2)), with the transfer functions of both channels, [h, w/2 + 1],
    and ``gradient`` = |D_x|^2 + |D_y|^2.
    """
    power = infrared.real**2 + infrared.imag**2
    return green * np.conj(infrared) / (power + np.float32(beta) * gradient + np.float32(1e-12))


def correlate(
    predicted: list[Float32Array], observed: list[Float32Array], window: Window, spacing_px: float
) -> tuple[Float32Array, Float32Array, Float32Array]:
    """Energy of the predicted images, energy of the observed ones and their product, means over the patch, [h, w]."""

    def mean(one: list[Float32Array], other: list[Float32Array]) -> Float32Array:
        return window_mean(np.sum([a * b for a, b in zip(one, other, strict=True)], axis=0), window, spacing_px)

    return mean(predicted, predicted), mean(observed, observed), mean(predicted, observed)
