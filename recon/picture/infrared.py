"""The infrared channel (sec. 4.2 and 4.4): interpolation to full resolution, and its removal from R, G and B."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from dasim.base.errors import InputError
from dasim.camera import specification
from dasim.camera.radiometry import response
from dasim.camera.rings import at_pixels, rings
from dasim.camera.sensor import channels
from dasim.camera.specification import Camera
from dasim.spectra import colour_checker, grid, illuminants
from dasim.typing import Float32Array, FloatArray
from dasim.values import Capture
from recon.picture import mosaic
from recon.picture.mosaic import Phase
from recon.settings import Settings

MOST_SATURATED = 0.001  # largest share of saturated pixels in a capture for the measurement of crosstalk
LEAST_SIGNAL = 0.02  # least mean of its infrared pixels, relative to full scale
MIDDLE_RINGS = 0.5  # of the field: on the axis 7 degrees, within which a coating shifts by a quarter of its edge

# Cubic convolution (Keys 1981, a = -1/2) on a grid of twice the density: weights at the samples and halfway between.
BICUBIC = np.array([-1, 0, 9, 16, 9, 0, -1], np.float32) / 16


def interpolate(plane: Float32Array, phase: Phase) -> Float32Array:
    """Bicubic interpolation of a colour plane [h/2, w/2] on the mosaic's own grid, [h, w] (sec. 4.2).

    ``phase`` is the position (row, column) of the plane's pixels in the 2x2 block. Sample (j, i) stays at pixel
    (2 j + row, 2 i + column), so that the result is registered with the other channels. Borders are mirrored about the
    frame's last pixels, which preserves the grid.
    """
    sparse = np.zeros((2 * plane.shape[0], 2 * plane.shape[1]), np.float32)
    sparse[phase[0] :: 2, phase[1] :: 2] = plane
    full = cv2.sepFilter2D(sparse, -1, BICUBIC, BICUBIC, borderType=cv2.BORDER_REFLECT_101)
    return np.asarray(full, np.float32)


def crosstalk(camera: Camera, measured: tuple[float, float, float] | None, angle_deg: float = 0.0) -> FloatArray:
    """Ratios alpha of the infrared in R, G and B to the IR signal, [3], at an angle of the field: eq. (8).

    ``measured`` are those of the axis; they change over the field as eq. (8) does.
    """
    alpha = specification.crosstalk(camera, angle_deg)
    if measured is not None:
        return np.asarray(measured, np.float64) * _relative(alpha, specification.crosstalk(camera))
    return alpha.astype(np.float32).astype(np.float64)


def crosstalk_over_field(camera: Camera) -> tuple[FloatArray, FloatArray]:
    """Eq. (8) on the rings of the frame relative to the axis, [ring, 3], and each pixel's fractional ring, [h, w]."""
    angles, place = rings(camera)
    alpha = np.stack([specification.crosstalk(camera, angle) for angle in angles])
    return _relative(alpha, alpha[0]), place


def _relative(alpha: FloatArray, on_axis: FloatArray) -> FloatArray:
    """Coefficients over those of the axis; 1 for a channel that sees no infrared there."""
    return np.divide(alpha, on_axis, out=np.ones_like(alpha), where=on_axis > 0)


def measured_crosstalk(capture: Capture) -> tuple[float, float, float]:
    """Measured alpha of eq. (8) for R, G and B on the axis, from a capture under near-infrared light alone.

    The results, for ``Settings.crosstalk``, are ratios of the channels' means in the part of the frame that is nearest
    to the axis. In a frame that does not contain the axis, they are divided by the change of alpha from the axis to
    there, which is known from the data sheet. Unlike the areas of the response curves, they hold for the spectrum of
    this light. Suitable are infrared LEDs, or a lamp behind a filter without transmission below 650 nm, on a uniform
    surface.
    """
    electrons, saturated = mosaic.linearise(capture)
    grids = mosaic.grids(capture.camera)
    if "IR" not in grids:
        raise InputError(f"camera '{capture.camera.name}' has no infrared pixels, so crosstalk cannot be measured")
    clipped = {name: float(saturated[mosaic.sites(g, saturated.shape)].mean()) for name, g in grids.items()}
    if max(clipped.values()) > MOST_SATURATED:
        name = max(clipped, key=lambda key: clipped[key])
        raise InputError(f"capture: {clipped[name]:.1%} of channel {name} is saturated; use less light")
    relative, place = crosstalk_over_field(capture.camera)
    middle = place <= place.min() + MIDDLE_RINGS
    mean = {name: float(electrons[mosaic.sites(g, electrons.shape) & middle].mean()) for name, g in grids.items()}
    if mean["IR"] < LEAST_SIGNAL * capture.camera.sensor.full_well_e / capture.gain:
        raise InputError("capture: too little infrared for the measurement of crosstalk; use more light")
    there = at_pixels(relative, place.min())
    red, green, blue = (
        max(mean[name] / mean["IR"], 0.0) / change for name, change in zip(grid.CHANNELS[:3], there, strict=True)
    )
    return red, green, blue


def separation(camera: Camera, light: str, settings: Settings, angle_deg: float = 0.0) -> FloatArray:
    """Matrix [3, channel] that removes infrared from R, G and B at an angle of the field, for :func:`separate`.

    For eq. (7), it has ones on the diagonal and -alpha in the column of infrared, with alpha from the settings or
    eq. (8). With ``infrared_removal = "matrix"``, it is the first three rows of :func:`crosstalk_matrix`. For a camera
    without infrared pixels, it is the identity.
    """
    if "IR" not in channels(camera.sensor):
        return np.eye(3)
    if settings.infrared_removal == "matrix":
        return crosstalk_matrix(camera, light, angle_deg)[:3]
    return np.hstack([np.eye(3), -crosstalk(camera, settings.crosstalk, angle_deg)[:, None]])


def crosstalk_matrix(camera: Camera, light: str, angle_deg: float = 0.0) -> FloatArray:
    """Full crosstalk matrix [4, 4]: from captured (R, G, B, IR) to the signal of each channel in its own band.

    A least-squares fit over the 24 patches of the ColorChecker and white under the light, each weighted by 1 / green.
    The response curves are split at 650 nm: visible light for R, G and B, the rest for IR. Deviation: eq. (7) removes
    infrared alone; this matrix also removes visible light from the infrared pixel.
    """
    curves = response(camera, angle_deg)
    visible = grid.WAVELENGTH_NM < specification.near_infrared_nm(camera, angle_deg)[0]
    band_curves = curves * np.vstack([visible, visible, visible, ~visible])
    patches = np.vstack([colour_checker.curve(name) for name in colour_checker.PATCHES])
    patches = np.vstack([patches, np.ones_like(grid.WAVELENGTH_NM)])[:, None, :] * light_power(light)
    captured, in_band = (grid.integrate(patches * c) for c in (curves, band_curves))
    weight = 1 / captured[:, 1:2]
    solution, *_ = np.linalg.lstsq(weight * captured, weight * in_band, rcond=None)
    return np.asarray(solution).T


def light_power(light: str) -> FloatArray:
    """Spectrum of a light on the wavelength grid, [wavelength]; D65 for unknown names."""
    try:
        return illuminants.illuminant(light)
    except InputError:
        return illuminants.illuminant("D65")


def separate(image: Float32Array, matrix: NDArray) -> Float32Array:
    """Visible light: ``matrix`` [3, channel] times an image [h, w, channel], clipped at 0, [h, w, 3]."""
    return np.asarray(np.maximum(image @ matrix.astype(np.float32).T, 0), np.float32)
