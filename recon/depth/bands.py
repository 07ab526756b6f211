"""Levels from the transfer between two channels, measured band by band around each sample.

Deviation from eq. (9)-(12), the preset ``bands``. The paper deblurs infrared with one weight for the frame and takes
the NCC of gradients. Where infrared is weak or the blurrier channel (near focus, by diffraction), its noise then is
mistaken for blur, and levels near focus are overestimated by up to four. Here energies of both channels and their
product are averaged in bands around each sample, wide enough that their impulse responses stay within the patch; for a
texture of power S in one,

    <I I> = S |H_IR|^2 + s_IR^2,   <G I> = g T (<I I> - s_IR^2),   T = S H_G conj(H_IR) / (S |H_IR|^2),

so that the residual <G I> - g T (<I I> - s_IR^2) is zero on average at the true level whatever the texture, how
strong it is, and how much of green's texture infrared does not share: the noise is known from the sensor. Red is
compared in the same way: a red flower has no green texture. The patch follows the surface: samples count by how alike
their ratio of visible to infrared is, which texture changes less than the step from one material to the next.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from typing import NamedTuple

import cv2
import numpy as np
from numba import njit, prange
from numpy.typing import NDArray

from dasim.typing import Complex64Array, Float32Array, FloatArray
from recon import fourier
from recon.depth.channels import Also, Channel
from recon.depth.grid import Grid, plane_mean, transform, window_mean
from recon.settings import Settings

BANDS = 7  # a ring's impulse response reaches about 1 / width: 33 px, as the patch; narrower ones smear over objects
LOWEST_CYCLES_PX = 0.025  # below, shading differs between channels
HIGHEST_CYCLES_PX = 0.235  # beyond, green of a mosaic is aliased near focus
GUIDE_BLUR_PX = 4.0  # of the planes, whose ratio tells materials apart
UNLIKE = 0.12  # in the logarithm of that ratio: weight exp(-1/2)
TAP_PX = 8  # between the samples of a patch; each is a mean itself, of TAP_BLUR taps
TAP_BLUR = 0.6
FARTHEST = np.float32(8.0)  # exponent of a weight that is not worth adding
TABLE_GRID = 192  # samples per side, on which the transfers of the levels are tabulated
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


def scored(
    sharper: Channel, visible: Also, spectrum: Complex64Array, grid: Grid, settings: Settings
) -> tuple[Float32Array, Float32Array]:
    """Scores by :mod:`recon.depth.bands`, of visible channels without their infrared; and 1 in place of an NCC.

    Deviation: the paper compares unprocessed channels, with kernels that hold white's share of infrared in green. The
    share differs from material to material (a leaf has far more), and with it green's blur: taken off on both sides.
    The channels count as independent.
    """
    (height, width), spacing_px = grid.frame, grid.spacing_px
    spectra, noise = [spectrum], [sharper[2]]
    for (plane, phase, variance, _), leak in visible:
        own = transform(plane, phase, grid.shape, spacing_px)
        spectra.append(own - np.complex64(leak.alpha) * spectrum)
        noise.append((variance + leak.alpha**2 * sharper[2]).astype(np.float32))
    planes = [np.ascontiguousarray(c[0][:height, :width]) for c in (sharper, *(channel for channel, _ in visible))]
    floors = [np.sqrt(c[2]) for c in (sharper, *(channel for channel, _ in visible))]
    likeness = guide(planes[0], planes[1:], floors, spacing_px) if settings.alike else None
    leaks = [leak.alpha for _, leak in visible]
    pairs = energies(spectra, noise, (grid.shape, grid.frame), settings, spacing_px, leaks, likeness)
    score = np.zeros((len(sharper[3]), height, width), np.float32)
    for pair, (channel, leak) in zip(pairs, visible, strict=True):
        share = leak.alpha * leak.white
        kernels = (channel[3] - share * sharper[3]) / (1 - share)
        score += log_likelihood(pair, transfers(sharper[3], kernels, spacing_px))
    return score, np.ones(grid.frame, np.float32)


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
    spectra: Sequence[Complex64Array],
    noise: Sequence[Float32Array],
    grid: tuple[tuple[int, int], tuple[int, int]],
    settings: Settings,
    spacing_px: float,
    leaks: Sequence[float] = (),
    likeness: Float32Array | None = None,
) -> list[Energies]:
    """Energies by bands of the sharper channel with each of the visible ones, from spectra and noise variances.

    The sharper channel comes first; ``grid`` is the padded shape and the frame. ``leaks`` times the sharper channel
    was taken off the visible ones before: their noises then have a product, undone here. ``likeness`` [n, h, w] as
    from :func:`guide` shapes the patches.
    """
    shape, frame = grid
    rings = filters(shape, spacing_px)
    share = np.array([plane_mean(ring**2, shape[1]) for ring in rings])
    visible = len(spectra) - 1
    found = np.empty((1 + 2 * visible, len(rings), *frame), np.float32)
    for index, ring in enumerate(rings):
        sharper, *others = (fourier.inverse(s * ring, shape)[: frame[0], : frame[1]] for s in spectra)
        parts = [sharper * sharper, *(o * o for o in others), *(o * sharper for o in others)]
        for part, image in enumerate(parts):
            found[part, index] = image / np.float32(share[index])
    stack = np.concatenate([found.reshape(-1, *frame), np.stack(noise)])
    stack = _means(stack, settings, spacing_px, likeness)
    found = stack[: -len(noise)].reshape(found.shape)
    variances = stack[-len(noise) :]
    samples = 4 * np.pi * (settings.window_px / spacing_px) ** 2 / 12 * share  # of a Gaussian patch
    pairs = []
    for number, leak in zip(range(1, visible + 1), leaks or [0.0] * visible, strict=True):
        product = found[visible + number] + np.float32(leak) * variances[0]
        pairs.append(Energies(found[number], found[0], product, variances[number], variances[0], samples))
    return pairs


def guide(
    sharper: Float32Array, visible: Sequence[Float32Array], floors: Sequence[Float32Array], spacing_px: float
) -> Float32Array:
    """Logarithms of the visible channels' ratios to the sharper one, in units of UNLIKE, [n, h, w].

    ``floors`` are the least values that count, the sharper channel's first: standard deviations of the noise.
    """
    blurred = [
        np.log(np.maximum(cv2.GaussianBlur(plane, (0, 0), GUIDE_BLUR_PX / spacing_px), floor))
        for plane, floor in zip((sharper, *visible), floors, strict=True)
    ]
    return np.stack([(image - blurred[0]) / UNLIKE for image in blurred[1:]]).astype(np.float32)


def _means(stack: Float32Array, settings: Settings, spacing_px: float, likeness: Float32Array | None) -> Float32Array:
    """Means over the patch of images [n, h, w], of samples that look alike where ``likeness`` is given."""
    if likeness is None:
        return np.stack([window_mean(image, settings, spacing_px) for image in stack])
    step = max(round(TAP_PX / spacing_px), 1)
    sigma = settings.window_px / spacing_px / np.sqrt(12)
    taps = np.stack([cv2.GaussianBlur(i, (0, 0), TAP_BLUR * step, borderType=cv2.BORDER_REFLECT) for i in stack])
    result = np.empty_like(taps)
    _alike(taps, likeness, int(np.ceil(2 * sigma / step)), step, np.float32(sigma), result)
    return result


@njit(cache=True, parallel=True, fastmath=True)
def _alike(  # pragma: no cover - compiled
    stack: Float32Array, likeness: Float32Array, radius: int, step: int, sigma: np.float32, result: Float32Array
) -> None:
    images, height, width = stack.shape
    for y in prange(height):
        total = np.empty(images, np.float32)
        for x in range(width):
            total[:] = 0
            norm = np.float32(0)
            for dy in range(-radius, radius + 1):
                yy = y + dy * step
                if yy < 0 or yy >= height:
                    continue
                for dx in range(-radius, radius + 1):
                    xx = x + dx * step
                    if xx < 0 or xx >= width:
                        continue
                    exponent = np.float32((dy * step) ** 2 + (dx * step) ** 2) / (2 * sigma * sigma)
                    for c in range(likeness.shape[0]):
                        exponent += (likeness[c, y, x] - likeness[c, yy, xx]) ** 2 / 2
                    if exponent > FARTHEST:
                        continue
                    weight = np.exp(-exponent)
                    norm += weight
                    for k in range(images):
                        total[k] += weight * stack[k, yy, xx]
            for k in range(images):
                result[k, y, x] = total[k] / norm


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
