"""The infrared channel (sec. 4.2 and 4.4): interpolation to full resolution, and its removal from R, G and B."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from dasim import spectra
from dasim.camera import Camera, quantum_efficiency
from recon.mosaic import Phase

Float32Array = NDArray[np.float32]

# Cubic convolution (Keys 1981, a = -1/2) at half a sample, between the samples themselves; at twice the grid.
BICUBIC = np.array([-1, 0, 9, 16, 9, 0, -1], np.float32) / 16


def interpolate(plane: Float32Array, phase: Phase) -> Float32Array:
    """Bicubic interpolation of a colour plane [h/2, w/2] on the mosaic's own grid, [h, w] (sec. 4.2).

    ``phase`` is the (row, column) of the plane's pixels in the 2x2 block: sample (j, i) stays at pixel
    (2 j + row, 2 i + column), so the result lies on the other channels without a shift of half a pixel.
    Borders are mirrored about the frame's last pixels, which keeps the grid.
    """
    sparse = np.zeros((2 * plane.shape[0], 2 * plane.shape[1]), np.float32)
    sparse[phase[0] :: 2, phase[1] :: 2] = plane
    full = cv2.sepFilter2D(sparse, -1, BICUBIC, BICUBIC, borderType=cv2.BORDER_REFLECT_101)
    return np.asarray(full, np.float32)


def crosstalk(camera: Camera) -> Float32Array:
    """Shares alpha of the infrared signal in R, G and B, eq. (8), [3], from the sensor's response curves.

    The areas are taken on the sensor's response with its cutoff filter, so that light the filter stops
    beyond 800 nm does not count.
    """
    sensor = camera.sensor
    cutoff = spectra.short_pass(sensor.cutoff_nm, sensor.cutoff_width_nm)
    return spectra.ir_crosstalk(quantum_efficiency(sensor) * cutoff).astype(np.float32)


def remove(rgb: Float32Array, infrared: Float32Array, alpha: Float32Array, keep: NDArray | None = None) -> Float32Array:
    """Visible light alone, I_out = I_f - alpha I_IR, eq. (7), [h, w, 3], not below 0.

    ``keep`` marks saturated pixels: their sum is unknown, so they stay as they are (deviation: the paper
    does not treat them).
    """
    clean = np.maximum(rgb - alpha * infrared[..., None], 0)
    return clean if keep is None else np.where(keep[..., None], rgb, clean)
