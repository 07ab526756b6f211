"""Slanted-edge spatial frequency response, the e-SFR of ISO 12233."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from dasim.typing import FloatArray

OVERSAMPLING = 4  # bins per pixel
EDGE_WINDOW_PX = 8.0  # half width of the window in which a row's edge is located, in addition to the blur diameter


def slanted_edge_sfr(image: FloatArray, frequency: FloatArray, *, blur_px: float = 0.0) -> FloatArray:
    """SFR of a near-vertical edge in an image [y, x], at ``frequency`` in cycles per pixel across the edge; 1 at 0.

    The steps are those of ISO 12233 (annex on e-SFR, edition of 2014). The edge is located in each row by the centroid
    of the derivative, and a straight line is fitted through the rows. All pixels are projected along this line into
    bins of a quarter pixel. The binned profile is differentiated, multiplied by a Hamming window and Fourier
    transformed, and the result is corrected for the finite difference.

    Deviations from the standard: the averaging within a bin, a second factor of the same sinc, is corrected as well,
    and centroids are computed within ``EDGE_WINDOW_PX`` plus ``blur_px`` (the blur diameter) of the edge, because noise
    far from the edge would bias them.
    """
    slope, start = _edge_line(image, EDGE_WINDOW_PX + abs(blur_px))
    y, x = np.indices(image.shape)
    across = (x - (start + slope * y)) / np.hypot(1.0, slope)  # distance from the edge along its normal
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
    """Slope (pixels per row) and start of the edge x = start + slope y.

    The line is first fitted to whole rows and then to windows about the previous line, down to ``window_px``.
    """
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
    """The result that :func:`slanted_edge_sfr` should have for a known transfer function, its window included.

    ``mtf`` is the real, signed transfer function [..., n] from 0 in steps of ``mtf_step`` cycles per pixel up to where
    it vanishes; ``shape`` [y, x] is that of the frame, ``slope`` that of the edge in pixels per row. The line spread
    function is the cosine transform of ``mtf``, multiplied by the Hamming window of the measurement.
    """
    step, reach = _bins(shape, slope)
    half = (reach + 0.5) * step
    place = np.linspace(-half, half, 16 * reach + 1)
    at = mtf_step * np.arange(mtf.shape[-1])
    line = (mtf * np.where(at > 0, 1.0, 0.5)) @ np.cos(2 * np.pi * np.outer(at, place)) * _hamming(place, half)
    response = line @ np.exp(-2j * np.pi * np.outer(place, frequency))
    return np.abs(response) / line.sum(axis=-1, keepdims=True)


def _bins(shape: tuple[int, ...], slope: float) -> tuple[float, int]:
    """Width of a bin along the edge's normal, in pixels, and the number of bins on each side of the edge.

    A bin is a quarter pixel wide along a row. The bins cover the distance from the edge that every row contains.
    """
    rows, columns = shape[:2]
    step = 1 / (OVERSAMPLING * np.hypot(1.0, slope))
    return step, int((columns / 2 - abs(slope) * rows / 2 - 2) * OVERSAMPLING)


def _hamming(place: NDArray[Any], half: float) -> FloatArray:
    """Hamming window of half width ``half`` at positions ``place`` from its centre."""
    return 0.54 + 0.46 * np.cos(np.pi * place / half)
