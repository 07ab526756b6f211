"""The grid on which two channels are compared (sec. 5.2): its band, its gradients, and means over the patch.

Samples lie ``spacing_px`` apart: 2 for the colour planes of a mosaic, 1 for whole pictures.
"""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from dasim.typing import Complex64Array, Float32Array
from recon import fourier
from recon.picture.mosaic import Phase
from recon.settings import Settings

PLANE_SPACING_PX = 2.0
ROLL_OFF = 0.4  # of the cutoff: width of the band's smooth edge


class Grid(NamedTuple):
    """A padded grid of ``shape``, the ``frame`` on it, and what every level uses: arrays [h, w/2 + 1]."""

    shape: tuple[int, int]
    frame: tuple[int, int]
    spacing_px: float
    band: Float32Array  # what is compared, 0..1
    filters: list[Complex64Array]  # gradients within the band
    gradient: Float32Array  # |D_x|^2 + |D_y|^2 of eq. (10), the inverse of a natural texture's power


def make_grid(shape: tuple[int, int], frame: tuple[int, int], spacing_px: float, settings: Settings) -> Grid:
    """The grid of :class:`Grid` with its filters."""
    filters = derivatives(shape, settings, spacing_px)
    band = band_pass(shape, settings, spacing_px).astype(np.float32)
    return Grid(shape, frame, spacing_px, band, filters, gradient_power(shape).astype(np.float32))


def band_pass(shape: tuple[int, int], settings: Settings, spacing_px: float) -> NDArray[np.float64]:
    """The band that is compared, 0..1, [h, w/2 + 1].

    It ends smoothly at ``cutoff_cycles_px`` (deviation: the paper does not limit it): towards the planes'
    own limit of 0.25 cycles per pixel, aliasing of green near focus grows.
    """
    radius = np.hypot(*fourier.frequencies(shape, spacing_px))
    edge = settings.cutoff_cycles_px
    rise = np.clip((edge - radius) / (ROLL_OFF * edge) + 0.5, 0, 1)
    return 0.5 - 0.5 * np.cos(np.pi * rise)


def derivatives(shape: tuple[int, int], settings: Settings, spacing_px: float) -> list[Complex64Array]:
    """Filters of eq. (11)'s gradients, limited to the common band: nabla_x + nabla_y, or both one by one."""
    fy, fx = fourier.frequencies(shape, spacing_px)
    band = band_pass(shape, settings, spacing_px)
    dx, dy = (2j * np.pi * spacing_px * f * band for f in (fx, fy))
    filters = [dx + dy] if settings.gradient == "sum" else [dx, dy]
    return [f.astype(np.complex64) for f in filters]


def gradient_power(shape: tuple[int, int]) -> NDArray[np.float64]:
    """|D_x|^2 + |D_y|^2 of the differences of eq. (10), [h, w/2 + 1]: the inverse of a natural texture's power."""
    fy, fx = fourier.frequencies(shape)
    return 4 * np.sin(np.pi * fy) ** 2 + 4 * np.sin(np.pi * fx) ** 2


def plane_mean(power: NDArray, width: int) -> float:
    """Mean over the whole plane of frequencies of a function given on half of it, [h, w/2 + 1]."""
    twice = np.full(power.shape[1], 2.0)
    twice[0] = 1.0
    if width % 2 == 0:
        twice[-1] = 1.0
    return float((power * twice).sum() / (power.shape[0] * width))


def noise_gain(filters: list[Complex64Array], width: int) -> float:
    """Variance of white noise of variance 1 after filters given on the half-plane, their sum."""
    return sum(plane_mean(np.abs(f) ** 2, width) for f in filters)


def window_mean(image: Float32Array, settings: Settings, spacing_px: float = 2.0) -> Float32Array:
    """Mean over the patch of eq. (11) around each sample: a box, or a Gaussian of the box's variance."""
    side = settings.window_px / spacing_px
    border = cv2.BORDER_REFLECT
    if settings.window == "box":
        odd = 2 * int(side / 2) + 1
        return np.asarray(cv2.boxFilter(image, -1, (odd, odd), borderType=border), np.float32)
    return np.asarray(cv2.GaussianBlur(image, (0, 0), side / np.sqrt(12), borderType=border), np.float32)


def transform(
    plane: Float32Array, phase: Phase, shape: tuple[int, int], spacing_px: float = PLANE_SPACING_PX
) -> Complex64Array:
    """Spectrum of a plane [h, w], padded to ``shape``, moved to the middle of the blocks of ``spacing_px``.

    ``phase`` is the place of its first sample in the block, in pixels.
    """
    fy, fx = fourier.frequencies(shape, spacing_px)
    middle = (spacing_px - 1) / 2
    shift = fy * (middle - phase[0]) + fx * (middle - phase[1])
    moved = np.exp(2j * np.pi * shift).astype(np.complex64)
    return fourier.forward(fourier.pad_blended(plane, shape)) * moved


def filtered(spectrum: Complex64Array, filters: list[Complex64Array], grid: Grid) -> list[Float32Array]:
    """Images of a spectrum after each filter, cut to the frame."""
    height, width = grid.frame
    return [fourier.inverse(spectrum * f, grid.shape)[:height, :width] for f in filters]
