"""The level of the best score (eq. (12)), refined between the levels of the bank, and its confidence."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from dasim.typing import Complex64Array, Float32Array
from recon import fourier
from recon.depth import bands
from recon.depth.grid import PLANE_SPACING_PX, make_grid, plane_mean
from recon.depth.level_score import level_filters
from recon.depth.likelihood import log_likelihood
from recon.depth.ncc import Weights
from recon.settings import Settings

OFFSET_GRID = 96  # samples per side, on which expected scores are computed
REFERENCE_ERROR = 1.0  # levels: an estimate with this standard error has a confidence of one half
INDEPENDENT_SHARE = 0.5  # of a window's samples, after the band-pass


def best_level(
    score: Float32Array, plain: Float32Array, offset: NDArray, settings: Settings
) -> tuple[Float32Array, Float32Array]:
    """Level of the largest NCC, eq. (12), refined by a parabola through its neighbours; and a confidence 0..1.

    ``offset`` [level] is where the parabola's vertex lies for a true level (:func:`peak_offset`), undone here.

    The confidence is s^2 / (s^2 + e^2) with s one level and e the standard error of a least-squares fit:
    e^2 = (1 - n^2) / (N c n), n the ``plain`` NCC at its peak, -c its second derivative, N the window's independent
    samples. Zero where the NCC is not positive. With the score ``bands``, e follows from the likelihood itself.
    """
    levels = len(score)
    peak = np.argmax(score, axis=0)
    middle = np.clip(peak, 1, levels - 2)
    before, at, after = (np.take_along_axis(score, (middle + d)[None], 0)[0] for d in (-1, 0, 1))
    curvature = 2 * at - before - after
    shift = 0.5 * (after - before) / np.where(curvature > 0, curvature, 1)
    inside = (peak == middle) & (curvature > 0)
    vertex = np.where(inside, middle + np.clip(shift, -0.5, 0.5), peak)
    seen = np.maximum.accumulate(np.arange(levels) + offset)
    level = np.interp(vertex, seen, np.arange(levels)).astype(np.float32)
    if settings.score == "bands":
        error = bands.standard_error(score)
        return level, np.asarray(REFERENCE_ERROR**2 / (REFERENCE_ERROR**2 + error**2), np.float32)
    top = np.clip(plain, 0, 1)
    samples = INDEPENDENT_SHARE * (settings.window_px / PLANE_SPACING_PX) ** 2
    information = samples * np.maximum(curvature, 0) * top
    unexplained = np.maximum(1 - top**2, 1e-3)
    confidence = REFERENCE_ERROR**2 * information / (REFERENCE_ERROR**2 * information + unexplained)
    return level, np.nan_to_num(confidence).astype(np.float32)


def peak_offset(
    kernels: NDArray, green_kernels: NDArray, weights: Weights, settings: Settings, spacing_px: float
) -> NDArray[np.float64]:
    """How far the refined peak lies from each true level, [level], from the kernels alone.

    The score falls faster towards less blur than towards more, so the vertex of a parabola misses its maximum, up to
    0.3 levels. Expected score of neighbouring levels for a texture of natural spectrum (power 1/f^2) and the
    weights of eq. (9) given, on a small grid; deviation: the paper names no refinement.
    """
    shape = (OFFSET_GRID, OFFSET_GRID)
    grid = make_grid(shape, shape, spacing_px, settings)
    small = fourier.transfer(kernels, shape, spacing_px)
    large = fourier.transfer(green_kernels, shape, spacing_px)
    texture = 1 / np.maximum(grid.gradient, OFFSET_GRID**-2)
    steps = [level_filters(s, g, weights, settings, grid) for s, g in zip(small, large, strict=True)]
    offset = np.zeros(len(kernels))
    for true in range(1, len(kernels) - 1):
        powers = (
            texture * np.abs(small[true]) ** 2 + weights.sharper,
            texture * np.abs(large[true]) ** 2 + weights.green,
            texture * np.conj(large[true]) * small[true],
        )
        before, at, after = (_expected(steps[true + step], powers, shape, settings) for step in (-1, 0, 1))
        curvature = 2 * at - before - after
        offset[true] = np.clip(0.5 * (after - before) / curvature, -0.5, 0.5) if curvature > 0 else 0.0
    return offset


def _expected(
    step: tuple[list[Complex64Array], list[Complex64Array], float],
    powers: tuple[NDArray, NDArray, NDArray],
    shape: tuple[int, int],
    settings: Settings,
) -> float:
    """Score of a level for power spectra of the sharper channel, of green, and across, [h, w/2 + 1]."""
    mine, other, constant = step
    own, green, across = (
        sum(plane_mean(part, shape[1]) for part in parts)
        for parts in (
            [powers[0] * np.abs(m) ** 2 for m in mine],
            [powers[1] * np.abs(o) ** 2 for o in other],
            [(powers[2] * m * np.conj(o)).real for m, o in zip(mine, other, strict=True)],
        )
    )
    ncc = np.array(across / np.sqrt(own * green))
    return float(ncc if settings.score == "ncc" else log_likelihood(ncc, np.array(green), constant))
