"""How two channels of different blur are compared at one level (sec. 5.2): three ways to score a level.

``ncc`` is the paper's eq. (9)-(11); ``likelihood`` the conditional likelihood of the blurrier channel given the
sharper one; ``colour-line`` the closest prior work, Chakrabarti and Zickler (ECCV 2012). All work on spectra of
grids whose samples lie ``spacing_px`` apart: 2 for the colour planes of a mosaic, 1 for whole pictures.
"""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from dasim.typing import Complex64Array, Float32Array
from recon import fourier
from recon.settings import Settings

ROLL_OFF = 0.4  # of the cutoff: width of the band's smooth edge
SMALLEST = float(np.finfo(np.float32).tiny)
ALIGNMENT_PRIOR = 1e-3  # Chakrabarti and Zickler's weight of gradients in the kernel h_d
MIN_WEIGHT = 1e-9  # of the texture prior: keeps the closed form finite where a kernel passes nothing
MAX_MATCH = 1 - 1e-6  # of an NCC: keeps the logarithm of what is left unexplained finite


class Grid(NamedTuple):
    """A padded grid of ``shape``, the ``frame`` on it, and what every level uses: arrays [h, w/2 + 1]."""

    shape: tuple[int, int]
    frame: tuple[int, int]
    spacing_px: float
    band: Float32Array  # what is compared, 0..1
    filters: list[Complex64Array]  # gradients within the band
    gradient: Float32Array  # |D_x|^2 + |D_y|^2 of eq. (10), the inverse of a natural texture's power


class Weights(NamedTuple):
    """beta of eq. (9) for the sharper channel and for green: noise variance over the texture's power."""

    sharper: float
    green: float


def make_grid(shape: tuple[int, int], frame: tuple[int, int], spacing_px: float, settings: Settings) -> Grid:
    """The grid of :class:`Grid` with its filters."""
    filters = derivatives(shape, settings, spacing_px)
    band = band_pass(shape, settings, spacing_px).astype(np.float32)
    return Grid(shape, frame, spacing_px, band, filters, gradient_power(shape).astype(np.float32))


def band_pass(shape: tuple[int, int], settings: Settings, spacing_px: float) -> NDArray[np.float64]:
    """The band that is compared, 0..1, [h, w/2 + 1].

    It ends smoothly at ``cutoff_cycles_px`` (deviation: the paper does not limit it): towards the planes'
    own limit of 0.25 cycles a pixel, aliasing of green near focus grows.
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
    """Mean over the whole plane of frequencies of what is given on its half, [h, w/2 + 1]."""
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


def weight_of(transfers: Complex64Array, strength: float, grid: Grid, settings: Settings) -> float:
    """Noise variance over the power A of a texture of spectrum A / (|D_x|^2 + |D_y|^2): beta of eq. (9).

    A follows from the gradients' signal over noise in the picture, ``strength``, and the mean power of the transfer
    functions [level, h, w/2 + 1]: the weight is measured, not chosen.
    """
    share = (np.abs(transfers) ** 2).mean(axis=0) / np.maximum(grid.gradient, 1e-6)
    passed = sum(plane_mean(np.abs(f) ** 2 * share, grid.shape[1]) for f in grid.filters)
    noise = noise_gain(grid.filters, grid.shape[1])
    return max(settings.prior_factor * passed / (max(strength, SMALLEST) * noise), MIN_WEIGHT)


def reblur(infrared: Complex64Array, green: Complex64Array, beta: float, gradient: Float32Array) -> Complex64Array:
    """Filter that deblurs infrared and blurs it like green, eq. (9)-(10) in closed form.

    H_G conj(H_IR) / (|H_IR|^2 + beta (|D_x|^2 + |D_y|^2)), from the two transfer functions [h, w/2 + 1].
    """
    power = infrared.real**2 + infrared.imag**2
    return green * np.conj(infrared) / (power + np.float32(beta) * gradient + np.float32(1e-12))


def correlate(
    predicted: list[Float32Array], observed: list[Float32Array], settings: Settings, grid: Grid
) -> tuple[Float32Array, Float32Array, Float32Array]:
    """Energies of two sets of images and their product, means over the patch."""

    def mean(one: list[Float32Array], other: list[Float32Array]) -> Float32Array:
        return window_mean(np.sum([a * b for a, b in zip(one, other, strict=True)], axis=0), settings, grid.spacing_px)

    return mean(predicted, predicted), mean(observed, observed), mean(predicted, observed)


def filtered(spectrum: Complex64Array, filters: list[Complex64Array], grid: Grid) -> list[Float32Array]:
    """Images of a spectrum after each filter, cut to the frame."""
    height, width = grid.frame
    return [fourier.inverse(spectrum * f, grid.shape)[:height, :width] for f in filters]


def whitening(
    infrared: Complex64Array, green: Complex64Array, weights: Weights, gradient: Float32Array
) -> Float32Array:
    """Variance of green given infrared at each frequency, in units of green's noise, [h, w/2 + 1].

    V = 1 + |H_G|^2 beta_IR / (beta_G (|H_IR|^2 + beta_IR |D|^2)): green's noise, and what of green's texture
    infrared cannot tell, for a texture of power A / |D|^2 and beta = noise variance / A in each channel.
    """
    own, other = (h.real**2 + h.imag**2 for h in (infrared, green))
    ratio = np.float32(weights.sharper / weights.green)
    variance = 1 + ratio * other / (own + np.float32(weights.sharper) * gradient + np.float32(1e-12))
    return variance.astype(np.float32)


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


def log_likelihood(ncc: NDArray, energy: NDArray, constant: float) -> NDArray:
    """Log likelihood of green given infrared at a level, by sample of the window, up to a constant.

    Green ~ N(g T I, c V): T the Wiener prediction of eq. (9)-(10), V of :func:`whitening`; the gain g and the scale c
    take their best values, so -2 log p = log(energy (1 - ncc^2)) + mean log V with the energy and the NCC of the
    whitened pictures. Deviation from eq. (11)-(12), where the NCC alone decides: where infrared is the blurrier
    channel (near focus, by diffraction) deblurring amplifies its noise, the NCC falls although the level is right,
    and the estimate runs off to larger levels.
    """
    return -np.log(np.maximum(energy * (1 - np.clip(ncc, 0, MAX_MATCH) ** 2), SMALLEST)) - constant


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

    ``observed`` are green's gradients, which the NCC takes as they are at every level.
    """
    mine, other, constant = level_filters(infrared, green, weights, settings, grid)
    if observed is None:
        observed = filtered(spectra[1], other, grid)
    power, energy, product = correlate(filtered(spectra[0], mine, grid), observed, settings, grid)
    ncc = product / np.sqrt(np.maximum(power * energy, SMALLEST))
    if settings.score == "ncc":
        return np.asarray(ncc, np.float32), np.asarray(ncc, np.float32)
    return log_likelihood(ncc, energy, constant).astype(np.float32), np.asarray(ncc, np.float32)


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
