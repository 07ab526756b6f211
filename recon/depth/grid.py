"""The grid on which two channels are compared (sec. 5.2): its frequency band, its gradients, means over the patch.

The sample spacing ``spacing_px`` is 2 raw pixels for the colour planes of a mosaic and 1 for full-resolution images.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Literal, NamedTuple

import cv2
import numpy as np
from numba import njit
from numpy.typing import NDArray

from dasim.base.threads import mapped
from dasim.typing import Complex64Array, Float32Array
from recon import fourier
from recon.picture.mosaic import Phase

PLANE_SPACING_PX = 2.0
GAUSSIAN_REACH = 4.0  # of a Gaussian window, in standard deviations
ROLL_OFF = 0.4  # width of the band's smooth edge, relative to the cutoff

Gradient = Literal["sum", "both"]


class Window(NamedTuple):
    """The patch of eq. (11): a box, or a Gaussian of the same variance."""

    side_px: float  # delta of eq. (11), raw pixels
    kind: Literal["gaussian", "box"]


class Grid(NamedTuple):
    """A padded grid of ``shape`` that holds a ``frame``, and the arrays [h, w/2 + 1] that all levels share."""

    shape: tuple[int, int]
    frame: tuple[int, int]
    spacing_px: float
    band: Float32Array  # weight of each frequency in the comparison, 0..1
    filters: list[Complex64Array]  # band-limited derivatives
    gradient: Float32Array  # |D_x|^2 + |D_y|^2 of eq. (10), the inverse of a natural texture's power


def make_grid(
    shape: tuple[int, int], frame: tuple[int, int], spacing_px: float, cutoff_cycles_px: float, gradient: Gradient
) -> Grid:
    """A grid with its filters; for the parameters see :class:`Grid`, :func:`band_pass` and :func:`derivatives`."""
    band = band_pass(shape, cutoff_cycles_px, spacing_px)
    filters = derivatives(shape, band, gradient, spacing_px)
    return Grid(shape, frame, spacing_px, band.astype(np.float32), filters, gradient_power(shape).astype(np.float32))


def band_pass(shape: tuple[int, int], cutoff_cycles_px: float, spacing_px: float) -> NDArray[np.float64]:
    """Weight of each frequency in the comparison, 0..1, [h, w/2 + 1]: a low-pass with a raised-cosine edge.

    ``cutoff_cycles_px`` is its half-value frequency, cycles per raw pixel. Deviation: the paper does not limit the
    band. Near focus, green of a mosaic is aliased increasingly up to the planes' Nyquist limit of 0.25.
    """
    radius = np.hypot(*fourier.frequencies(shape, spacing_px))
    rise = np.clip((cutoff_cycles_px - radius) / (ROLL_OFF * cutoff_cycles_px) + 0.5, 0, 1)
    return 0.5 - 0.5 * np.cos(np.pi * rise)


def derivatives(
    shape: tuple[int, int], band: NDArray[np.float64], gradient: Gradient, spacing_px: float
) -> list[Complex64Array]:
    """Derivative filters of eq. (11), limited to ``band``: nabla_x + nabla_y for ``sum``, each alone for ``both``."""
    fy, fx = fourier.frequencies(shape, spacing_px)
    dx, dy = (2j * np.pi * spacing_px * f * band for f in (fx, fy))
    filters = [dx + dy] if gradient == "sum" else [dx, dy]
    return [f.astype(np.complex64) for f in filters]


def gradient_power(shape: tuple[int, int]) -> NDArray[np.float64]:
    """|D_x|^2 + |D_y|^2 of the forward differences of eq. (10), [h, w/2 + 1].

    Its inverse approximates the power spectrum of a natural texture, 1/f^2.
    """
    fy, fx = fourier.frequencies(shape)
    return 4 * np.sin(np.pi * fy) ** 2 + 4 * np.sin(np.pi * fx) ** 2


def plane_mean(power: NDArray, width: int) -> float:
    """Mean over all frequencies of an even function given on the half-plane, [h, w/2 + 1]; ``width`` is w."""
    twice = np.full(power.shape[1], 2.0)
    twice[0] = 1.0
    if width % 2 == 0:
        twice[-1] = 1.0
    return float((power * twice).sum() / (power.shape[0] * width))


def noise_gain(filters: list[Complex64Array], width: int) -> float:
    """Variance of unit white noise after each filter [h, w/2 + 1], summed over the filters."""
    return sum(plane_mean(np.abs(f) ** 2, width) for f in filters)


def window_mean(image: Float32Array, window: Window, spacing_px: float = PLANE_SPACING_PX) -> Float32Array:
    """Mean of an image [h, w] over the patch around each sample, mirrored at the border."""
    side = window.side_px / spacing_px
    border = cv2.BORDER_REFLECT
    if window.kind == "box":
        odd = 2 * int(side / 2) + 1
        return np.asarray(cv2.boxFilter(image, -1, (odd, odd), borderType=border), np.float32)
    return np.asarray(cv2.GaussianBlur(image, (0, 0), side / np.sqrt(12), borderType=border), np.float32)


Places = tuple[NDArray[np.intp], NDArray[np.intp]]  # rows and columns of samples


def gaussian_means(images: Iterable[Float32Array], sigma: float, at: Places | None = None) -> Float32Array:
    """Images [h, w] averaged over a Gaussian of ``sigma`` samples, mirrored at the border, [n, row, column].

    The means are those ``at`` some rows and columns, or of all samples.
    """

    def everywhere(image: Float32Array) -> Float32Array:
        return np.asarray(cv2.GaussianBlur(image, (0, 0), sigma, borderType=cv2.BORDER_REFLECT), np.float32)

    def there(image: Float32Array) -> Float32Array:
        return _means_at(np.ascontiguousarray(image, np.float32), sigma, at) if at else everywhere(image)

    return np.stack(list(mapped(there, images, fourier.WORKERS)))


def _means_at(image: Float32Array, sigma: float, at: Places) -> Float32Array:
    height, width = image.shape
    radius = int(np.ceil(GAUSSIAN_REACH * sigma))
    kernel = np.exp(-0.5 * (np.arange(-radius, radius + 1) / sigma) ** 2)
    rows = fourier.mirrored(at[0][:, None] + np.arange(-radius, radius + 1), height)
    line = fourier.mirrored(np.arange(-radius, width + radius), width)
    result = np.empty((len(at[0]), len(at[1])), np.float32)
    _weighted_sums(image, (kernel / kernel.sum()).astype(np.float32), rows, line, at[1], result)
    return result


@njit(cache=True, nogil=True, fastmath=True)
def _weighted_sums(  # pragma: no cover - compiled
    image: Float32Array,
    kernel: Float32Array,
    rows: NDArray[np.intp],
    line: NDArray[np.intp],
    columns: NDArray[np.intp],
    result: Float32Array,
) -> None:
    """Sums weighted by the product of a kernel along both axes, of ``rows`` [row, tap] and columns from ``columns``.

    ``line`` are the columns of an extended row, the kernel's reach beyond the image on either side.
    """
    total = np.empty(image.shape[1], np.float32)
    extended = np.empty(len(line), np.float32)
    for row in range(len(rows)):
        total[:] = 0
        for tap in range(len(kernel)):
            weight, source = kernel[tap], image[rows[row, tap]]
            for x in range(len(total)):
                total[x] += weight * source[x]
        for x in range(len(line)):
            extended[x] = total[line[x]]
        for column in range(len(columns)):
            part = extended[columns[column] : columns[column] + len(kernel)]
            value = np.float32(0)
            for tap in range(len(kernel)):
                value += kernel[tap] * part[tap]
            result[row, column] = value


def transform(
    plane: Float32Array, phase: Phase, shape: tuple[int, int], spacing_px: float = PLANE_SPACING_PX
) -> Complex64Array:
    """Spectrum of a plane [h, w] padded to ``shape``, shifted to the centres of blocks of ``spacing_px`` pixels.

    ``phase`` is the position (row, column) of its first sample in the block, raw pixels.
    """
    middle = (spacing_px - 1) / 2
    along_y, along_x = (
        np.exp(2j * np.pi * f * (middle - start)).astype(np.complex64)
        for f, start in zip(fourier.frequencies(shape, spacing_px), phase, strict=True)
    )
    spectrum = fourier.forward(fourier.pad_blended(plane, shape))
    spectrum *= along_y
    spectrum *= along_x
    return spectrum


def filtered(spectrum: Complex64Array, filters: list[Complex64Array], grid: Grid) -> list[Float32Array]:
    """Images [h, w] of a spectrum after each filter, cropped to the frame."""
    height, width = grid.frame
    return [fourier.inverse(spectrum * f, grid.shape)[:height, :width] for f in filters]
