"""The closest prior work, Chakrabarti and Zickler (ECCV 2012): gradients of a patch lie on one line in colour space."""

from __future__ import annotations

import numpy as np

from dasim.typing import Complex64Array, Float32Array
from recon import fourier
from recon.depth.grid import Grid, filtered, plane_mean
from recon.depth.ncc import SMALLEST, correlate, reblur
from recon.settings import Settings

ALIGNMENT_PRIOR = 1e-3  # Chakrabarti and Zickler's weight of gradients in the kernel h_d


def colour_line(
    infrared: Complex64Array,
    green: Complex64Array,
    settings: Settings,
    spectra: tuple[Complex64Array, Complex64Array],
    grid: Grid,
) -> tuple[Float32Array, Float32Array]:
    """Score of a level after Chakrabarti and Zickler (ECCV 2012), [h, w], and the NCC of the same gradients.

    Infrared, moved to green's blur by the kernel h_d = conj(H_IR) H_G / (|H_IR|^2 + mu |D|^2 / 2), mu = 1e-3 as they
    publish. Gradients of four directions; if the blur is right, those of a patch lie on one line through the
    origin of colour space: minus the smaller eigenvalue of their second moments, summed over the directions. Their
    division by the score of a dummy kernel is the same for all levels and does not move the maximum. Deviations: two
    channels instead of three, the patch of the other scores instead of lines of 15 pixels (the same windows for all).
    """
    blur = reblur(infrared, green, ALIGNMENT_PRIOR / 2, grid.gradient)
    unlike = np.zeros(grid.frame, np.float32)
    energies, products = np.zeros((2, *grid.frame), np.float32)
    for direction in directional(grid.shape, settings):
        predicted, observed = filtered(spectra[0], [direction * blur], grid), filtered(spectra[1], [direction], grid)
        power, energy, product = correlate(predicted, observed, settings, grid)
        unlike += (power + energy - np.hypot(power - energy, 2 * product)) / 2
        energies += np.sqrt(power * energy)
        products += product
    return -unlike, np.asarray(products / np.maximum(energies, SMALLEST), np.float32)


def directional(shape: tuple[int, int], settings: Settings) -> list[Complex64Array]:
    """Unit-norm derivatives of a Gaussian of one sample along x, y and both diagonals, [h, w/2 + 1] each.

    Their published code takes the same diagonal twice (``published``); the other one belongs there (``right``).
    """
    fy, fx = fourier.frequencies(shape)
    smooth = np.exp(-2 * np.pi**2 * (fy**2 + fx**2))
    dx, dy = 2j * np.pi * fx * smooth, 2j * np.pi * fy * smooth
    other = dx + dy if settings.diagonals == "published" else dx - dy
    found = [dx, dy, (dx + dy) / np.sqrt(2), other / np.sqrt(2)]
    norm = np.sqrt(plane_mean(np.abs(dx) ** 2, shape[1]))
    return [(f / norm).astype(np.complex64) for f in found]
