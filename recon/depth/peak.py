"""The level of the best score (eq. (12)), refined between the levels of the bank, and its confidence."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from dasim.typing import Complex64Array, Float32Array, FloatArray
from recon import fourier
from recon.depth import bands
from recon.depth.grid import PLANE_SPACING_PX, Grid, plane_mean
from recon.depth.level_score import Score, level_filters
from recon.depth.likelihood import log_likelihood
from recon.depth.ncc import Weights

REFERENCE_ERROR = 1.0  # levels: an estimate with this standard error has a confidence of one half
ROUNDING = 12**-0.5  # standard deviation of a level that is known to be nearer to a whole number than to any other
INDEPENDENT_SHARE = 0.5  # independent samples after the band-pass, as a share of a window's samples


def best_level(
    score: Float32Array, ncc: Float32Array | None, offset: NDArray, window_px: float, *, is_likelihood: bool = False
) -> tuple[Float32Array, Float32Array]:
    """Level of the highest score, eq. (12), refined by a parabola through its neighbours; confidence 0..1; both [h, w].

    The confidence is s^2 / (s^2 + e^2), with s of one level and the standard error e. For the NCC n it is that of a
    least-squares fit, e^2 = (1 - n^2) / (N c n), where -c is the second derivative of the score, and N the number of
    independent samples in the window. For twice the log likelihood per sample, e^2 = 2 / (N c). It is 0 where the NCC
    is not positive.

    Args:
        score: score of each level, [level, h, w].
        ncc: NCC at the best level, [h, w]; None for the log likelihood of whole windows (:mod:`recon.depth.bands`),
            whose own spread over the levels then gives e, with that of rounding to one of them.
        offset: position of the parabola's vertex relative to each true level, [level] (:func:`peak_offset`).
        window_px: side of the patch, raw pixels.
        is_likelihood: whether the score is twice the log likelihood per sample, and not the NCC.
    """
    levels = len(score)
    peak = np.argmax(score, axis=0)
    # The first and the last level have one neighbour, which counts on both sides.
    neighbours = np.where(peak > 0, peak - 1, 1), peak, np.where(peak < levels - 1, peak + 1, levels - 2)
    before, at, after = (np.take_along_axis(score, index[None], 0)[0] for index in neighbours)
    curvature = 2 * at - before - after
    shift = 0.5 * (after - before) / np.where(curvature > 0, curvature, 1)
    vertex = peak + np.clip(shift, -0.5, 0.5)
    expected_vertex = np.maximum.accumulate(np.arange(levels) + offset)
    level = np.interp(vertex, expected_vertex, np.arange(levels)).astype(np.float32)
    if ncc is None:
        return level, confidence_of(np.hypot(bands.standard_error(score), ROUNDING)).astype(np.float32)
    top = np.clip(ncc, 0, 1)
    samples = INDEPENDENT_SHARE * (window_px / PLANE_SPACING_PX) ** 2
    information = samples * np.maximum(curvature, 0) * (0.5 if is_likelihood else top)
    residual = np.ones_like(top) if is_likelihood else np.maximum(1 - top**2, 1e-3)
    confidence = REFERENCE_ERROR**2 * information / (REFERENCE_ERROR**2 * information + residual)
    return level, np.nan_to_num(confidence).astype(np.float32)


def confidence_of(sd: FloatArray | Float32Array) -> NDArray[np.floating]:
    """Confidence 0..1 of a standard deviation in levels, s^2 / (s^2 + sd^2) with s of one level."""
    return np.asarray(REFERENCE_ERROR**2 / (REFERENCE_ERROR**2 + sd**2))


def sd_of(confidence: NDArray[np.floating]) -> NDArray[np.floating]:
    """Standard deviation in levels that a confidence 0..1 stands for, infinite for 0: :func:`confidence_of` undone."""
    with np.errstate(divide="ignore"):
        return np.asarray(REFERENCE_ERROR * np.sqrt(np.maximum(1 / confidence - 1, 0)))


def peak_offset(
    kernels: NDArray, green_kernels: NDArray, weights: Weights, score: Score, grid: Grid
) -> NDArray[np.float64]:
    """Difference between the refined peak and each true level, [level], from the kernels [level, y, x] alone.

    The score falls faster towards less blur than towards more. The vertex of a parabola therefore misses the maximum,
    by up to 0.3 levels. The offset follows from the expected scores of neighbouring levels, for a texture of natural
    spectrum (power 1/f^2) and the given ``weights`` of eq. (9), on a small ``grid``. Deviation: the paper describes
    no refinement.
    """
    small = fourier.transfer(kernels, grid.shape, grid.spacing_px)
    large = fourier.transfer(green_kernels, grid.shape, grid.spacing_px)
    texture = 1 / np.maximum(grid.gradient, grid.shape[0] ** -2)
    filters = [level_filters(s, g, weights, score, grid) for s, g in zip(small, large, strict=True)]
    offset = np.zeros(len(kernels))
    for true in range(1, len(kernels) - 1):
        powers = (
            texture * np.abs(small[true]) ** 2 + weights.sharper,
            texture * np.abs(large[true]) ** 2 + weights.green,
            texture * np.conj(large[true]) * small[true],
        )
        before, at, after = (_expected(filters[true + step], powers, grid.shape[1], score) for step in (-1, 0, 1))
        curvature = 2 * at - before - after
        offset[true] = np.clip(0.5 * (after - before) / curvature, -0.5, 0.5) if curvature > 0 else 0.0
    return offset


def _expected(
    filters: tuple[list[Complex64Array], list[Complex64Array], float],
    powers: tuple[NDArray, NDArray, NDArray],
    width: int,
    score: Score,
) -> float:
    """Expected score of a level from its ``filters`` (the result of :func:`level_filters`).

    ``powers`` are the power spectra of the sharper channel and of green, and their cross spectrum, [h, w/2 + 1].
    """
    infrared_filters, green_filters, constant = filters
    pairs = list(zip(infrared_filters, green_filters, strict=True))
    infrared = sum(plane_mean(powers[0] * np.abs(f) ** 2, width) for f in infrared_filters)
    green = sum(plane_mean(powers[1] * np.abs(g) ** 2, width) for g in green_filters)
    across = sum(plane_mean((powers[2] * f * np.conj(g)).real, width) for f, g in pairs)
    ncc = np.array(across / np.sqrt(infrared * green))
    return float(ncc if score == "ncc" else log_likelihood(ncc, np.array(green), constant))
