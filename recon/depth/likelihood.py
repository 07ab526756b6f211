"""The conditional likelihood of the blurrier channel given the sharper one, at one level."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from dasim.typing import Complex64Array, Float32Array
from recon.depth.ncc import SMALLEST, Weights

MAX_MATCH = 1 - 1e-6  # of an NCC: keeps the logarithm of the unexplained energy finite


def whitening(
    infrared: Complex64Array, green: Complex64Array, weights: Weights, gradient: Float32Array
) -> Float32Array:
    """Variance of green given infrared at each frequency, in units of green's noise, [h, w/2 + 1].

    V = 1 + |H_G|^2 beta_IR / (beta_G (|H_IR|^2 + beta_IR |D|^2)): green's noise, and the part of green's texture that
    infrared does not predict, for a texture of power A / |D|^2 and beta = noise variance / A in each channel.
    """
    own, other = (h.real**2 + h.imag**2 for h in (infrared, green))
    ratio = np.float32(weights.sharper / weights.green)
    variance = 1 + ratio * other / (own + np.float32(weights.sharper) * gradient + np.float32(1e-12))
    return variance.astype(np.float32)


def log_likelihood(ncc: NDArray, energy: NDArray, constant: float) -> NDArray:
    """Log likelihood of green given infrared at a level, by sample of the window, up to a constant.

    Green ~ N(g T I, c V): T the Wiener prediction of eq. (9)-(10), V of :func:`whitening`; the gain g and the scale c
    are fitted, so -2 log p = log(energy (1 - ncc^2)) + mean log V with the energy and the NCC of the
    whitened pictures. Deviation from eq. (11)-(12), where the NCC alone decides: where infrared is the blurrier
    channel (near focus, by diffraction) deblurring amplifies its noise, the NCC falls although the level is right,
    and the estimate is biased to larger levels.
    """
    return -np.log(np.maximum(energy * (1 - np.clip(ncc, 0, MAX_MATCH) ** 2), SMALLEST)) - constant
