"""The infrared channel (sec. 4.2 and 4.4): interpolation to full resolution, and its removal from R, G and B."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from dasim.base.errors import InputError
from dasim.camera import specification
from dasim.camera.radiometry import response
from dasim.camera.specification import Camera, Sensor, channels
from dasim.spectra import colour_checker, grid, illuminants
from dasim.typing import Float32Array, FloatArray
from dasim.values import Capture
from recon.picture import mosaic
from recon.picture.mosaic import Phase
from recon.settings import Settings

MOST_SATURATED = 0.001  # of a channel's pixels, in a capture that crosstalk is measured from
LEAST_SIGNAL = 0.02  # of full scale, mean of the infrared pixels there

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


def crosstalk(sensor: Sensor, measured: tuple[float, float, float] | None) -> FloatArray:
    """Shares alpha of the infrared signal in R, G and B, [3]: as measured, or eq. (8) of the response curves."""
    if measured is not None:
        return np.asarray(measured, np.float64)
    return specification.crosstalk(sensor).astype(np.float32).astype(np.float64)


def measured_crosstalk(capture: Capture) -> tuple[float, float, float]:
    """The shares alpha of eq. (8) for R, G and B, measured: a capture lit by near-infrared alone.

    The light may be infrared LEDs, or a lamp behind a filter that passes nothing below 650 nm; the surface is even.
    The ratios of the channels' means, for ``Settings.crosstalk``. Unlike the areas of the
    response curves they hold for the spectrum of this light.
    """
    electrons, saturated = mosaic.linearise(capture)
    own = mosaic.grids(capture.camera)
    if "IR" not in own:
        raise InputError(f"camera '{capture.camera.name}' has no infrared pixels; there is no crosstalk to measure")
    clipped = {name: float(saturated[mosaic.sites(found, saturated.shape)].mean()) for name, found in own.items()}
    if max(clipped.values()) > MOST_SATURATED:
        name = max(clipped, key=lambda key: clipped[key])
        raise InputError(f"capture: {clipped[name]:.1%} of channel {name} is saturated; take it with less light")
    mean = {name: float(electrons[mosaic.sites(found, electrons.shape)].mean()) for name, found in own.items()}
    if mean["IR"] < LEAST_SIGNAL * capture.camera.sensor.full_well_e / capture.gain:
        raise InputError("capture: shows too little infrared to measure crosstalk; take it with more light")
    red, green, blue = (max(mean[name] / mean["IR"], 0.0) for name in grid.CHANNELS[:3])
    return red, green, blue


def separation(camera: Camera, light: str, settings: Settings) -> FloatArray:
    """Matrix [3, channel] that removes infrared from R, G and B, for :func:`separate`.

    Eq. (7): one on the diagonal and -alpha in the column of infrared, alpha from the settings or by eq. (8). With
    ``infrared_removal = "matrix"`` the first three rows of :func:`crosstalk_matrix`. The identity for a camera
    without infrared pixels.
    """
    if "IR" not in channels(camera.sensor):
        return np.eye(3)
    if settings.infrared_removal == "matrix":
        return crosstalk_matrix(camera, light)[:3]
    return np.hstack([np.eye(3), -crosstalk(camera.sensor, settings.crosstalk)[:, None]])


def crosstalk_matrix(camera: Camera, light: str) -> FloatArray:
    """The full matrix [4, 4] of sensor makers: (R, G, B, IR) as captured to the signal of each in its own band alone.

    Least squares over the ColorChecker's 24 patches and white under the light, each weighted by 1 / its green, from
    the camera's response curves split at 650 nm: visible light for R, G and B, the rest for IR. (Deviation: eq. (7)
    removes infrared alone; this matrix also removes visible light from the infrared pixel.)
    """
    curves = response(camera)
    visible = grid.WAVELENGTH_NM < grid.NEAR_INFRARED_NM[0]
    wanted_curves = curves * np.vstack([visible, visible, visible, ~visible])
    patches = np.vstack([colour_checker.curve(name) for name in colour_checker.PATCHES])
    patches = np.vstack([patches, np.ones_like(grid.WAVELENGTH_NM)])[:, None, :] * light_power(light)
    seen, wanted = (grid.integrate(patches * c) for c in (curves, wanted_curves))
    weight = 1 / seen[:, 1:2]
    found, *_ = np.linalg.lstsq(weight * seen, weight * wanted, rcond=None)
    return np.asarray(found).T


def light_power(light: str) -> FloatArray:
    """Spectrum of a light on the wavelength grid; D65 for a name that ``dasim.spectra.illuminants`` does not know."""
    try:
        return illuminants.illuminant(light)
    except InputError:
        return illuminants.illuminant("D65")


def separate(image: Float32Array, matrix: NDArray) -> Float32Array:
    """Visible light alone: ``matrix`` [3, channel] times an image [h, w, channel], not below 0, [h, w, 3]."""
    return np.asarray(np.maximum(image @ matrix.astype(np.float32).T, 0), np.float32)
