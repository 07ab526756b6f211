"""The score of one blur level at every sample: the NCC of eq. (11), or the likelihood."""

from __future__ import annotations

from typing import Literal

import numpy as np

from dasim.typing import Complex64Array, Float32Array
from recon.depth.grid import Grid, Window, filtered, plane_mean
from recon.depth.likelihood import log_likelihood, whitening
from recon.depth.ncc import SMALLEST, Weights, correlate, reblur

Score = Literal["ncc", "likelihood"]


def level_filters(
    infrared: Complex64Array, green: Complex64Array, weights: Weights, score: Score, grid: Grid
) -> tuple[list[Complex64Array], list[Complex64Array], float]:
    """Filters for infrared, filters for green, and the constant of the likelihood (0 for the NCC) at one level.

    ``infrared`` and ``green`` are the transfer functions of the level, [h, w/2 + 1].
    """
    blur = reblur(infrared, green, weights.sharper, grid.gradient)
    if score == "ncc":
        return [f * blur for f in grid.filters], grid.filters, 0.0
    variance = whitening(infrared, green, weights, grid.gradient)
    weight = grid.band / np.sqrt(variance)
    power = grid.band**2
    width = grid.shape[1]
    constant = plane_mean(np.log(variance) * power, width) / plane_mean(power, width)
    return [weight * blur], [weight.astype(np.complex64)], constant


def level_score(
    infrared: Complex64Array,
    green: Complex64Array,
    weights: Weights,
    score: Score,
    window: Window,
    spectra: tuple[Complex64Array, Complex64Array],
    grid: Grid,
    observed: list[Float32Array] | None = None,
) -> tuple[Float32Array, Float32Array]:
    """Score of a level at each sample, and the NCC there, both [h, w].

    ``infrared`` and ``green`` are the transfer functions of the level, ``spectra`` those of the two pictures,
    [h, w/2 + 1]. ``observed`` are green's gradients [h, w], which the NCC compares unfiltered at every level; without
    it they are computed from ``spectra``.
    """
    infrared_filters, green_filters, constant = level_filters(infrared, green, weights, score, grid)
    if observed is None:
        observed = filtered(spectra[1], green_filters, grid)
    predicted = filtered(spectra[0], infrared_filters, grid)
    power, energy, product = correlate(predicted, observed, window, grid.spacing_px)
    ncc = product / np.sqrt(np.maximum(power * energy, SMALLEST))
    if score == "ncc":
        return np.asarray(ncc, np.float32), np.asarray(ncc, np.float32)
    return log_likelihood(ncc, energy, constant).astype(np.float32), np.asarray(ncc, np.float32)
