"""Levels from the transfer between two channels, measured band by band around each sample.

Deviation from eq. (9)-(12), the preset ``bands``. The paper deblurs infrared with one weight for the frame and takes
the NCC of gradients. Where infrared is weak or the blurrier channel (near focus, by diffraction), its noise then
passes for blur and levels near focus come out up to four too large. Here energies of both channels and their product
are averaged in narrow bands around each sample; for a texture of power S in a band,

    <I I> = S |H_IR|^2 + s_IR^2,   <G I> = g T (<I I> - s_IR^2),   T = S H_G conj(H_IR) / (S |H_IR|^2),

so that the residual <G I> - g T (<I I> - s_IR^2) is zero on average at the true level whatever the texture, how
strong it is, and how much of green's texture infrared does not share: the noise is known from the sensor.
"""

from __future__ import annotations

import itertools
from typing import NamedTuple

import cv2
import numpy as np
from numba import njit, prange
from numpy.typing import NDArray

from recon import fourier
from recon.comparison import plane_mean, window_mean
from recon.settings import Settings

Float32Array = NDArray[np.float32]
Complex64Array = NDArray[np.complex64]
FloatArray = NDArray[np.float64]

BANDS = 15
LOWEST_CYCLES_PX = 0.008
HIGHEST_CYCLES_PX = 0.17  # beyond, green of a mosaic is aliased near focus
TABLE_GRID = 192  # samples a side, on which the transfers of the levels are tabulated
GAIN_STEPS = 2  # the weights depend on the gain: once without, once with it
SMALLEST_GAIN = 1e-3
TINY = np.float32(1e-12)


class Energies(NamedTuple):
    """Means over the patch in each band, [band, h, w]; noise variances [h, w]; independent values in each, [band]."""

    green: Float32Array
    sharper: Float32Array
    product: Float32Array
    green_noise: Float32Array
    sharper_noise: Float32Array
    values: FloatArray


def filters(shape: tuple[int, int], spacing_px: float) -> list[Float32Array]:
    """Rings of frequencies [h, w/2 + 1], half overlapping; their squares add up to one within the range."""
    radius = np.hypot(*fourier.frequencies(shape, spacing_px))
    edges = np.linspace(LOWEST_CYCLES_PX, HIGHEST_CYCLES_PX, BANDS + 1)
    width = edges[1] - edges[0]
    distance = [np.abs(radius - (low + high) / 2) / width for low, high in itertools.pairwise(edges)]
    return [np.where(d < 1, np.cos(np.pi / 2 * np.minimum(d, 1)), 0).astype(np.float32) for d in distance]


def transfers(kernels: NDArray, green_kernels: NDArray, spacing_px: float) -> Float32Array:
    """T of each level and band, [level, band], for a texture of natural spectrum (power 1/f^2) within the band."""
    shape = (TABLE_GRID, TABLE_GRID)
    own = fourier.transfer(kernels, shape, spacing_px)
    other = fourier.transfer(green_kernels, shape, spacing_px)
    radius = np.hypot(*fourier.frequencies(shape, spacing_px))
    texture = np.maximum(radius, 0.5 / (TABLE_GRID * spacing_px)) ** -2
    table = np.empty((len(kernels), BANDS), np.float32)
    for index, ring in enumerate(filters(shape, spacing_px)):
        weight = texture * ring**2
        for level in range(len(kernels)):
            cross = plane_mean(weight * (other[level] * np.conj(own[level])).real, TABLE_GRID)
            power = plane_mean(weight * np.abs(own[level]) ** 2, TABLE_GRID)
            table[level, index] = cross / max(power, 1e-20)
    return table


def energies(
    spectra: tuple[Complex64Array, Complex64Array],
    noise: tuple[Float32Array, Float32Array],
    grid: tuple[tuple[int, int], tuple[int, int]],
    settings: Settings,
    spacing_px: float,
    leak: float = 0.0,
) -> Energies:
    """Energies by bands of (sharper, green) spectra on the grid (padded shape, frame), with their noise variances.

    ``leak`` times the sharper channel was taken off green before: their noise then has a product, undone here.
    """
    shape, frame = grid
    rings = filters(shape, spacing_px)
    found = np.empty((3, len(rings), *frame), np.float32)
    share = np.array([plane_mean(ring**2, shape[1]) for ring in rings])
    for index, ring in enumerate(rings):
        sharper, green = (fourier.inverse(s * ring, shape)[: frame[0], : frame[1]] for s in spectra)
        for part, image in enumerate((green * green, sharper * sharper, green * sharper)):
            found[part, index] = window_mean(image, settings, spacing_px) / np.float32(share[index])
    sharper_noise, green_noise = (window_mean(n, settings, spacing_px) for n in noise)
    found[2] += np.float32(leak) * sharper_noise
    samples = 4 * np.pi * (settings.window_px / spacing_px) ** 2 / 12  # of a Gaussian patch
    return Energies(found[0], found[1], found[2], green_noise, sharper_noise, samples * share)


def log_likelihood(found: Energies, table: Float32Array) -> Float32Array:
    """Logarithm of each level's likelihood at every sample, [level, h, w], up to a constant.

    -1/2 sum over the bands of r^2 / var(r), r the residual above with the best gain g;
    var(r) = <I I> (V + g^2 T^2 s_IR^2 n) / N, V what green has beside (its noise at least), n the noise's share in
    <I I>, N independent values.
    """
    score = np.empty((len(table), *found.green_noise.shape), np.float32)
    _fit(
        found.green, found.sharper, found.product, found.green_noise, found.sharper_noise,
        found.values.astype(np.float32), table, score,
    )  # fmt: skip
    return score


@njit(cache=True, parallel=True, fastmath=True)
def _fit(  # pragma: no cover - compiled
    green: Float32Array,
    sharper: Float32Array,
    product: Float32Array,
    green_noise: Float32Array,
    sharper_noise: Float32Array,
    count: Float32Array,
    table: Float32Array,
    score: Float32Array,
) -> None:
    levels, bands = table.shape
    for y in prange(green_noise.shape[0]):
        own = np.empty(bands, np.float32)
        signal = np.empty(bands, np.float32)
        beside = np.empty(bands, np.float32)
        passed = np.empty(bands, np.float32)
        for x in range(green_noise.shape[1]):
            noise = sharper_noise[y, x]
            for b in range(bands):
                energy = sharper[b, y, x]
                own[b] = max(energy, noise) + TINY
                signal[b] = max(energy - noise, np.float32(0))
                rest = green[b, y, x] - product[b, y, x] ** 2 / (energy + TINY)
                beside[b] = max(rest, green_noise[y, x]) + TINY
                passed[b] = noise * noise / own[b]
            for k in range(levels):
                gain = np.float32(0)
                for _ in range(GAIN_STEPS):
                    top = np.float32(0)
                    bottom = TINY
                    for b in range(bands):
                        step = table[k, b] * signal[b]
                        variance = beside[b] + (gain * table[k, b]) ** 2 * passed[b]
                        weight = count[b] / (own[b] * variance)
                        top += weight * product[b, y, x] * step
                        bottom += weight * step * step
                    gain = max(top / bottom, np.float32(SMALLEST_GAIN))
                total = np.float32(0)
                for b in range(bands):
                    rest = product[b, y, x] - gain * table[k, b] * signal[b]
                    variance = beside[b] + (gain * table[k, b]) ** 2 * passed[b]
                    total += count[b] * rest * rest / (own[b] * variance)
                score[k, y, x] = -total / 2


def standard_error(score: Float32Array) -> Float32Array:
    """Standard deviation of the level, [h, w], its likelihood [level, h, w] taken for a probability."""
    top = score.max(axis=0)
    total, first, second = np.zeros((3, *top.shape), np.float32)
    for level, one in enumerate(score):
        weight = np.asarray(cv2.exp(one - top), np.float32).reshape(top.shape)
        total += weight
        first += weight * level
        second += weight * level**2
    mean = first / total
    return np.sqrt(np.maximum(second / total - mean**2, 0))
