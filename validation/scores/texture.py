"""Pixels of a raw picture that show texture, determined from the capture and thus equal for all methods that are
scored.

Tested in tests/validation/scores/test_depth.py.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from dasim.typing import FloatArray
from dasim.values import Capture
from recon.picture import mosaic

WINDOW_PX = 31  # side of the square around a pixel: the paper's patch (sec. 5.2)
TEXTURE_SNR = 1.0  # gradient energy of the picture over that of its noise


def textured(capture: Capture) -> NDArray[np.bool_]:
    """Pixels [h, w] around which the energy of differences of green is more than twice that of noise."""
    return gradient_snr(capture) > TEXTURE_SNR


def gradient_snr(capture: Capture) -> FloatArray:
    """Energy of differences of raw green over that of their noise, less 1, averaged over ``WINDOW_PX``, [h, w].

    Differences are between green pixels one period of the mosaic apart, along both axes; the variance of their noise is
    twice that which the data sheet gives for their mean. Without texture the result is around 0.
    """
    electrons, _ = mosaic.linearise(capture)
    collected = mosaic.collected(electrons, capture.camera)
    variance = mosaic.noise_variance(capture, "G")
    energy, noise = np.zeros((2, *electrons.shape))
    block = np.array(capture.camera.sensor.mosaic)
    for row, column in zip(*np.nonzero(block == "G"), strict=True):
        grid = (slice(row, None, block.shape[0]), slice(column, None, block.shape[1]))
        for axis in (0, 1):
            near, far = _neighbours(electrons[grid], axis)
            part = (slice(near.shape[0]), slice(near.shape[1]))
            energy[grid][part] += (far - near) ** 2
            noise[grid][part] += 2 * variance.at(sum(_neighbours(collected[grid], axis)) / 2)
    signal, floor = (cv2.boxFilter(a, -1, (WINDOW_PX, WINDOW_PX), normalize=False) for a in (energy, noise))
    return np.asarray(signal / np.maximum(floor, 1e-9) - 1)


def _neighbours(plane: NDArray, axis: int) -> tuple[FloatArray, FloatArray]:
    """All samples but the last and all but the first along an axis."""
    whole = np.moveaxis(plane.astype(np.float64), axis, 0)
    return np.moveaxis(whole[:-1], 0, axis), np.moveaxis(whole[1:], 0, axis)
