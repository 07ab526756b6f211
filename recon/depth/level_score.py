"""The score of one level at every sample: the NCC of eq. (11), or the likelihood."""

from __future__ import annotations

import numpy as np

from dasim.typing import Complex64Array, Float32Array
from recon.depth.grid import Grid, filtered, plane_mean
from recon.depth.likelihood import log_likelihood, whitening
from recon.depth.ncc import SMALLEST, Weights, correlate, reblur
from recon.settings import Settings


def level_filters(
    infrared: Complex64Array, green: Complex64Array, weights: Weights, settings: Settings, grid: Grid
) -> tuple[list[Complex64Array], list[Complex64Array], float]:
    """Filters for infrared and for green at a level, and the level's constant of the likelihood."""
    blur = reblur(infrared, green, weights.sharper, grid.gradient)
    if settings.score == "ncc":
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
    settings: Settings,
    spectra: tuple[Complex64Array, Complex64Array],
    grid: Grid,
    observed: list[Float32Array] | None = None,
) -> tuple[Float32Array, Float32Array]:
    """Score of a level at each sample, [h, w], by ``settings.score``: ncc or likelihood; and the plain NCC.

    ``observed`` are green's gradients, which the NCC compares unfiltered at every level.
    """
    mine, other, constant = level_filters(infrared, green, weights, settings, grid)
    if observed is None:
        observed = filtered(spectra[1], other, grid)
    power, energy, product = correlate(filtered(spectra[0], mine, grid), observed, settings, grid)
    ncc = product / np.sqrt(np.maximum(power * energy, SMALLEST))
    if settings.score == "ncc":
        return np.asarray(ncc, np.float32), np.asarray(ncc, np.float32)
    return log_likelihood(ncc, energy, constant).astype(np.float32), np.asarray(ncc, np.float32)
