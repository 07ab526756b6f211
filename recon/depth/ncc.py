"""The paper's comparison of two channels at one level (sec. 5.2), eq. (9)-(11): deblur, blur anew, correlate.

Tested in tests/recon/depth/test_level_score.py.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from dasim.typing import Complex64Array, Float32Array
from recon.depth.grid import Grid, noise_gain, plane_mean, window_mean
from recon.settings import Settings

SMALLEST = float(np.finfo(np.float32).tiny)
MIN_WEIGHT = 1e-9  # of the texture prior: keeps the closed form finite where a kernel passes nothing


class Weights(NamedTuple):
    """beta of eq. (9) for the sharper channel and for green: noise variance over the texture's power."""

    sharper: float
    green: float


def weight_of(transfers: Complex64Array, strength: float, grid: Grid, settings: Settings) -> float:
    """Noise variance over the power A of a texture of spectrum A / (|D_x|^2 + |D_y|^2): beta of eq. (9).

    A follows from the gradients' signal over noise in the picture, ``strength``, and the mean power of the transfer
    functions [level, h, w/2 + 1]: the weight is measured, not chosen.
    """
    share = (np.abs(transfers) ** 2).mean(axis=0) / np.maximum(grid.gradient, 1e-6)
    passed = sum(plane_mean(np.abs(f) ** 2 * share, grid.shape[1]) for f in grid.filters)
    noise = noise_gain(grid.filters, grid.shape[1])
    return max(settings.prior_factor * passed / (max(strength, SMALLEST) * noise), MIN_WEIGHT)


def reblur(infrared: Complex64Array, green: Complex64Array, beta: float, gradient: Float32Array) -> Complex64Array:
    """Filter that deblurs infrared and blurs it like green, eq. (9)-(10) in closed form.

    H_G conj(H_IR) / (|H_IR|^2 + beta (|D_x|^2 + |D_y|^2)), from the two transfer functions [h, w/2 + 1].
    """
    power = infrared.real**2 + infrared.imag**2
    return green * np.conj(infrared) / (power + np.float32(beta) * gradient + np.float32(1e-12))


def correlate(
    predicted: list[Float32Array], observed: list[Float32Array], settings: Settings, grid: Grid
) -> tuple[Float32Array, Float32Array, Float32Array]:
    """Energies of two sets of images and their product, means over the patch."""

    def mean(one: list[Float32Array], other: list[Float32Array]) -> Float32Array:
        return window_mean(np.sum([a * b for a, b in zip(one, other, strict=True)], axis=0), settings, grid.spacing_px)

    return mean(predicted, predicted), mean(observed, observed), mean(predicted, observed)
