"""Slanted-edge spatial frequency response, the e-SFR of ISO 12233."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from dasim.typing import FloatArray

OVERSAMPLING = 4  # bins a pixel
EDGE_WINDOW_PX = 8.0  # half width, beyond the blur, of the window in which a row's edge is sought


def slanted_edge_sfr(image: FloatArray, frequency: FloatArray, *, blur_px: float = 0.0) -> FloatArray:
    """SFR of a near-vertical edge in [y, x], at ``frequency`` (cycles a pixel across the edge); 1 at 0.

    The steps of ISO 12233 (annex on e-SFR, edition of 2014): the edge's place in each row by the centroid of the
    derivative, a straight line through the rows, all pixels projected along it into bins of a quarter pixel,
    derivative, Hamming window, Fourier transform, and the correction for the finite difference.

    Deviations: the averaging within a bin, a second factor of the same sinc, is corrected too; centroids are taken
    within ``EDGE_WINDOW_PX`` and ``blur_px`` (the blur's diameter) of the edge, since noise far away would drag them.
    """
    slope, start = _edge_line(image, EDGE_WINDOW_PX + abs(blur_px))
    y, x = np.indices(image.shape)
    across = (x - (start + slope * y)) / np.hypot(1.0, slope)  # from the edge, along its normal
    step, reach = _bins(image.shape, slope)
    index = np.floor(across / step + 0.5).astype(int) + reach
    inside = (index >= 0) & (index <= 2 * reach)
    count = np.bincount(index[inside], minlength=2 * reach + 1)
    spread = np.bincount(index[inside], image[inside], 2 * reach + 1) / np.maximum(count, 1)
    line: FloatArray = np.diff(spread)
    place = (np.arange(len(line)) + 0.5 - reach) * step
    line = line * _hamming(place, (reach + 0.5) * step)
    response = np.exp(-2j * np.pi * np.outer(frequency, place)) @ line / line.sum()
    return np.abs(response) / np.sinc(frequency * step) ** 2


def _edge_line(image: FloatArray, window_px: float) -> tuple[float, float]:
    """Slope (pixels a row) and start of the edge x = start + slope y; refined within a window about itself."""
    derivative = (image[:, 2:] - image[:, :-2]) / 2
    x, y = np.arange(1, image.shape[1] - 1), np.arange(image.shape[0])
    slope, start = 0.0, image.shape[1] / 2 - 0.5
    for width in (image.shape[1] / 2, 2 * window_px, window_px, window_px):
        weight = derivative * (np.abs(x - (start + slope * y[:, None])) <= width)
        slope, start = np.polyfit(y, weight @ x / weight.sum(axis=1), 1)
    return float(slope), float(start)


def windowed_response(
    mtf: FloatArray, mtf_step: float, shape: tuple[int, int], slope: float, frequency: FloatArray
) -> FloatArray:
    """What :func:`slanted_edge_sfr` finds in a frame of ``shape`` for a true transfer function, its window included.

    ``mtf`` holds the (signed, real) transfer function [..., n] from 0 in steps of ``mtf_step`` cycles a pixel up to
    where it vanishes. The line spread is its cosine transform, windowed as the measured one is.
    """
    step, reach = _bins(shape, slope)
    half = (reach + 0.5) * step
    place = np.linspace(-half, half, 16 * reach + 1)
    at = mtf_step * np.arange(mtf.shape[-1])
    line = (mtf * np.where(at > 0, 1.0, 0.5)) @ np.cos(2 * np.pi * np.outer(at, place)) * _hamming(place, half)
    response = line @ np.exp(-2j * np.pi * np.outer(place, frequency))
    return np.abs(response) / line.sum(axis=-1, keepdims=True)


def _bins(shape: tuple[int, ...], slope: float) -> tuple[float, int]:
    """Width of a bin along the edge's normal, a quarter pixel along the row, and the number of bins on each side."""
    rows, columns = shape[:2]
    step = 1 / (OVERSAMPLING * np.hypot(1.0, slope))
    return step, int((columns / 2 - abs(slope) * rows / 2 - 2) * OVERSAMPLING)  # what every row has


def _hamming(place: NDArray[Any], half: float) -> FloatArray:
    return 0.54 + 0.46 * np.cos(np.pi * place / half)
