"""The score of Chakrabarti and Zickler (ECCV 2012): the gradients of a patch lie on one line in colour space."""

from __future__ import annotations

from typing import Literal

import numpy as np

from dasim.typing import Complex64Array, Float32Array
from recon import fourier
from recon.depth.grid import Grid, Window, filtered, plane_mean
from recon.depth.ncc import SMALLEST, correlate, reblur

ALIGNMENT_PRIOR = 1e-3  # mu, the weight of gradients in the kernel h_d, as published

Diagonals = Literal["right", "published"]


def colour_line(
    infrared: Complex64Array,
    green: Complex64Array,
    window: Window,
    diagonals: Diagonals,
    spectra: tuple[Complex64Array, Complex64Array],
    grid: Grid,
) -> tuple[Float32Array, Float32Array]:
    """Score of a level after Chakrabarti and Zickler (ECCV 2012), and the NCC of the same gradients, both [h, w].

    The kernel h_d = conj(H_IR) H_G / (|H_IR|^2 + mu |D|^2 / 2) gives infrared green's blur. At the true level, the
    gradients of a patch in the two channels lie on one line through the origin. The score is minus the logarithm of the
    smaller eigenvalue of their second moments, summed over four directions: as the variance of the distances from that
    line, it gives twice the log likelihood per sample. The published division by the score of a dummy kernel is the
    same for all levels, and is left out.

    Deviations: two channels instead of three; the patch of the other scores instead of lines of 15 pixels, so that
    all scores use the same windows. ``infrared`` and ``green`` are the transfer functions of the level, ``spectra``
    those of the two pictures, [h, w/2 + 1].
    """
    blur = reblur(infrared, green, ALIGNMENT_PRIOR / 2, grid.gradient)
    residual = np.zeros(grid.frame, np.float32)
    energies, products = np.zeros((2, *grid.frame), np.float32)
    for direction in directional(grid.shape, diagonals):
        predicted, observed = filtered(spectra[0], [direction * blur], grid), filtered(spectra[1], [direction], grid)
        power, energy, product = correlate(predicted, observed, window, grid.spacing_px)
        residual += (power + energy - np.hypot(power - energy, 2 * product)) / 2
        energies += np.sqrt(power * energy)
        products += product
    score = -np.log(np.maximum(residual, SMALLEST))
    return score, np.asarray(products / np.maximum(energies, SMALLEST), np.float32)


def directional(shape: tuple[int, int], diagonals: Diagonals) -> list[Complex64Array]:
    """Derivatives of a Gaussian of one sample along x, y and both diagonals, of unit norm, [h, w/2 + 1] each.

    With ``published``, both diagonals are the same one, as in the published code; with ``right`` they are orthogonal.
    """
    fy, fx = fourier.frequencies(shape)
    smooth = np.exp(-2 * np.pi**2 * (fy**2 + fx**2))
    dx, dy = 2j * np.pi * fx * smooth, 2j * np.pi * fy * smooth
    second = dx + dy if diagonals == "published" else dx - dy
    filters = [dx, dy, (dx + dy) / np.sqrt(2), second / np.sqrt(2)]
    norm = np.sqrt(plane_mean(np.abs(dx) ** 2, shape[1]))
    return [(f / norm).astype(np.complex64) for f in filters]
