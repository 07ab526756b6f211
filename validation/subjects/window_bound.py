"""Cramer-Rao bound of the blur level of the window around each pixel of a capture.

The window is the paper's patch of 31 px, in green and infrared, the pair that sec. 5 compares. Its texture is a
Gaussian process with a power spectrum of 1 / f^2, which green and infrared share (coherence 1). The spectrum's shape is
known to the estimator; its strength and the gain between the channels are not. What is measured in the capture is the
strength around each pixel, in one octave of the sharp picture around 0.1 cycles/px (blur would hide it in the raw
picture), the gain of infrared, and the mean electrons, from which the sensor's data sheet gives the noise.

The bound neglects rendering noise, aliasing, the other channels, and windows with more than one depth. An estimate that
uses several windows of a surface, or more channels, can be better than the bound; textures that differ between green
and infrared make every estimate worse.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from dasim.bounds import cramer_rao
from dasim.camera import geometry
from dasim.camera import sensor as sensors
from dasim.camera.specification import Camera
from dasim.simulation.exposure import Shot
from dasim.typing import BoolArray, FloatArray
from validation.scores.depth import near_side
from validation.subjects.strips import BOUND_SHAPE, STRENGTHS, bound_table, patch_mean
from validation.subjects.texture import noise_variance

PLANES = ("G", "IR")
SPACING_PX = 2.0  # between samples of one channel in a 2x2 mosaic
BAND_SIGMAS_PX = (1.5, 3.0)  # of the Gaussians whose difference passes about an octave around 0.1 cycles/px
BLUR_PX = np.geomspace(3.0, 30.0, 10)  # visible blur at which the bound is computed; interpolated between
DEFAULT_LIGHT = "D65"  # of the transfer functions, for a capture whose light has no name


def level_bounds(shot: Shot, where: BoolArray) -> FloatArray:
    """Least standard deviation of the level from the window around each pixel of a mask [h, w], in levels, [n].

    The pixels of ``where`` should have a visible blur of 3 to 30 px, a texture, and no depth boundary in their blur.
    """
    if not where.any():
        return np.zeros(0)
    camera, truth = shot.capture.camera, shot.truth
    index = [truth.channels.index(name) for name in PLANES]
    sharp = [truth.sharp_e[..., channel].astype(np.float64) for channel in index]
    inner = near_side(truth) & ~truth.boundary
    power = [octave_power(picture, inner)[where] for picture in sharp]
    mean = truth.mean_e[where].mean(axis=0).astype(np.float64)
    contrast_e, gain = float(np.sqrt(power[0].mean())), float(np.sqrt(power[1].mean() / power[0].mean()))
    noise = noise_variance(camera, mean, shot.capture.exposure_s, shot.capture.gain)[index]
    table = _table(camera, shot.capture.illuminant or DEFAULT_LIGHT, contrast_e, noise * _sparsity(camera), gain)
    brightness = np.maximum(patch_mean(truth.mean_e[..., index[0]])[where] / mean[index[0]], 1e-3)
    strength = power[0] / contrast_e**2 / brightness  # the variance of shot noise rises with the window's brightness
    return _interpolated(table, strength, truth.blur_px[where].astype(np.float64))


def octave_power(picture: FloatArray, inner: BoolArray) -> FloatArray:
    """Variance of a picture [h, w] within one octave, in the window around each pixel, from the pixels ``inner``.

    For a spectrum of 1 / f^2 with the variance c^2 in every octave, the difference of two Gaussians of widths s and t
    passes c^2 / ln 2 times the integral of |exp(-2 pi^2 s^2 f^2) - exp(-2 pi^2 t^2 f^2)|^2 / f, which is
    ln((s^2 + t^2) / (2 s t)) (Frullani's integral).
    """
    narrow, wide = BAND_SIGMAS_PX
    band = _smooth(picture, narrow) - _smooth(picture, wide)
    passed = np.log((narrow**2 + wide**2) / (2 * narrow * wide)) / np.log(2.0)
    weight = np.maximum(patch_mean(inner), 1e-6)
    return np.asarray(patch_mean(band**2 * inner) / weight / passed)


def _smooth(picture: FloatArray, sigma_px: float) -> FloatArray:
    return np.asarray(cv2.GaussianBlur(picture, (0, 0), sigma_px, borderType=cv2.BORDER_REFLECT))


def _sparsity(camera: Camera) -> FloatArray:
    """Area per sample of each channel, relative to that of a 2x2 mosaic: as much more noise has each frequency."""
    block = np.array(camera.sensor.mosaic)
    return np.array([1 / (SPACING_PX**2 * np.mean(block == name)) for name in PLANES])


def _table(camera: Camera, light: str, contrast_e: float, noise: NDArray, gain: float) -> FloatArray:
    """Bound in levels for windows of each of ``STRENGTHS`` at each of ``BLUR_PX``, [strength, blur]."""
    index = [sensors.channels(camera.sensor).index(name) for name in PLANES]
    transfer, slope = cramer_rao.camera_transfers(camera, BLUR_PX, light, BOUND_SHAPE, spacing_px=SPACING_PX)
    power = cramer_rao.natural_power(BOUND_SHAPE, spacing_px=SPACING_PX, contrast=contrast_e)
    table = bound_table(transfer[:, index], slope[:, index], power, noise, spacing_px=SPACING_PX, gain=(1.0, gain))
    return table / float(geometry.level_blur_px(camera)[1])


def _interpolated(table: FloatArray, strength: FloatArray, blur_px: FloatArray) -> FloatArray:
    """The bound at strengths and blurs [n], interpolated in logarithms of all three."""
    places = [
        np.interp(np.log(np.maximum(values, 1e-12)), np.log(nodes), np.arange(len(nodes)))
        for values, nodes in ((strength, STRENGTHS), (blur_px, BLUR_PX))
    ]
    row, column = (np.minimum(place.astype(int), n - 2) for place, n in zip(places, table.shape, strict=True))
    a, b = (place - low for place, low in zip(places, (row, column), strict=True))
    logs = np.log(table)
    above = (1 - b) * logs[row, column] + b * logs[row, column + 1]
    below = (1 - b) * logs[row + 1, column] + b * logs[row + 1, column + 1]
    return np.asarray(np.exp((1 - a) * above + a * below))
