"""Conditional likelihood of the blurrier channel given the sharper one, at one blur level."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from dasim.typing import Complex64Array, Float32Array
from recon.depth.ncc import SMALLEST, Weights

MAX_NCC = 1 - 1e-6  # keeps the logarithm of the residual energy finite


def whitening(
    infrared: Complex64Array, green: Complex64Array, weights: Weights, gradient: Float32Array
) -> Float32Array:
    """Variance of green given infrared at each frequency, relative to green's noise variance, [h, w/2 + 1].

    V = 1 + |H_G|^2 beta_IR / (beta_G (|H_IR|^2 + beta_IR |D|^2)): green's noise plus the part of green's texture that
    infrared does not predict, for a texture of power A / |D|^2 and beta = noise variance / A in each channel.
    """
    infrared_power, green_power = (h.real**2 + h.imag**2 for h in (infrared, green))
    ratio = np.float32(weights.sharper / weights.green)
    variance = 1 + ratio * green_power / (infrared_power + np.float32(weights.sharper) * gradient + np.float32(1e-12))
    return variance.astype(np.float32)


def log_likelihood(ncc: NDArray, energy: NDArray, constant: float) -> NDArray:
    """Twice the log likelihood of green given infrared at a level, per sample of the window, up to a constant.

    Green ~ N(g T I, c V), with the Wiener prediction T of eq. (9)-(10) and V of :func:`whitening`. Gain g and scale c
    are fitted, so that -2 log p = log(energy (1 - ncc^2)) + mean log V, with ``energy`` of green and ``ncc`` of both
    channels after whitening. ``constant`` is mean log V over the band.

    Deviation: eq. (11)-(12) maximise the NCC alone. Where infrared is the blurrier channel (near focus, because of
    diffraction), deblurring amplifies its noise; the NCC then falls at the true level, and the estimate is biased to
    larger levels.
    """
    return -np.log(np.maximum(energy * (1 - np.clip(ncc, 0, MAX_NCC) ** 2), SMALLEST)) - constant
