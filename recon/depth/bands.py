"""Blur levels from the transfer between two channels, measured in frequency bands around each sample.

Deviation from eq. (9)-(12), the preset ``bands``. The paper deblurs infrared with one weight for the whole frame and
maximises the NCC of gradients. Where infrared is weak, or is the blurrier channel (near focus, because of
diffraction), its noise is then mistaken for blur, and levels near focus are overestimated by up to four.

Here, the energies <I I> of infrared and <G G> of green and their product <G I> are averaged in each band around each
sample. The bands are wide enough that their impulse responses stay within the patch. For a texture of power S and gain
g between the channels, and noise of variance s_IR^2,

    <I I> = S |H_IR|^2 + s_IR^2,   <G I> = g T (<I I> - s_IR^2),   T = S H_G conj(H_IR) / (S |H_IR|^2).

The residual <G I> - g T (<I I> - s_IR^2) has mean zero at the true level, whatever the texture, its contrast, and the
part of green's texture that is absent from infrared. The noise variance is known from the sensor. Red is compared in
the same way, because some surfaces, such as a red flower, have no texture in green. The patch follows the surface:
samples are weighted by the similarity of their ratio of visible light to infrared, which varies less within a material
than between materials.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from typing import NamedTuple

import cv2
import numpy as np
from numba import njit, prange
from numpy.typing import NDArray

from dasim.typing import Complex64Array, Float32Array, FloatArray
from recon import fourier
from recon.depth.channels import Also, Channel, kernels_without_infrared
from recon.depth.grid import Places, Window, gaussian_means, plane_mean, transform, window_mean

BANDS = 7  # a band's impulse response reaches about 1 / width = 33 px, the patch; narrower bands mix objects
LOWEST_CYCLES_PX = 0.025  # at lower frequencies, shading differs between channels
HIGHEST_CYCLES_PX = 0.235  # at higher frequencies, green of a mosaic is aliased near focus
GUIDE_BLUR_PX = 4.0  # sigma of the blur of the planes whose ratios separate materials
GUIDE_SIGMA = 0.12  # difference in the logarithm of these ratios at which a sample's weight is exp(-1/2)
TAP_PX = 8  # spacing of the samples of a patch in the weighted mean
TAP_BLUR = 0.6  # sigma of the blur before that mean, in tap spacings
LARGEST_EXPONENT = np.float32(8.0)  # samples of weight below exp(-8) are skipped
TABLE_GRID = 192  # samples per side of the grid on which the transfers of the levels are tabulated
GAIN_STEPS = 2  # iterations of the gain, on which the weights depend: first without it, then with it
SMALLEST_GAIN = 1e-3
TINY = np.float32(1e-12)


class Energies(NamedTuple):
    """Energies of two channels, means over the patch."""

    green: Float32Array  # <G G>, [band, h, w]
    sharper: Float32Array  # <I I>, [band, h, w]
    product: Float32Array  # <G I>, [band, h, w]
    green_noise: Float32Array  # variance, [h, w]
    sharper_noise: Float32Array  # variance, [h, w]
    values: FloatArray  # independent values in the patch, [band]


def scored(
    sharper: Channel,
    visible: Also,
    shape: tuple[int, int],
    window: Window,
    spacing_px: float,
    *,
    alike: bool,
    at: Places | None = None,
) -> Float32Array:
    """Log likelihood of each level, [level, h, w], summed over the visible channels without their infrared.

    Deviation: the paper compares unprocessed channels, with kernels that contain white's share of infrared in green.
    This share, and with it green's blur, differs between materials (it is far larger for a leaf). Infrared is
    therefore subtracted from both picture and kernels. The channels are treated as independent.

    Args:
        sharper: the infrared channel.
        visible: visible channels with their share of infrared.
        shape: of the padded grid.
        window: the patch.
        spacing_px: sample spacing, raw pixels.
        alike: whether the patch follows the surface (:func:`guide`).
        at: rows and columns of the samples that are scored; all by default.
    """
    height, width = sharper.variance.shape
    channels = (sharper, *(channel for channel, _ in visible))
    spectra, noise = [transform(sharper.plane, sharper.phase, shape, spacing_px)], [sharper.variance]
    for channel, leak in visible:
        spectrum = transform(channel.plane, channel.phase, shape, spacing_px)
        spectra.append(spectrum - np.complex64(leak.alpha) * spectra[0])
        noise.append((channel.variance + leak.alpha**2 * sharper.variance).astype(np.float32))
    planes = [np.ascontiguousarray(channel.plane[:height, :width]) for channel in channels]
    floors = [np.sqrt(channel.variance) for channel in channels]
    likeness = guide(planes[0], planes[1:], floors, spacing_px) if alike else None
    leaks = [leak.alpha for _, leak in visible]
    pairs = energies(spectra, noise, shape, window, spacing_px, leaks, likeness, at)
    score = np.zeros((len(sharper.kernels), *pairs[0].green_noise.shape), np.float32)
    for pair, (channel, leak) in zip(pairs, visible, strict=True):
        score += log_likelihood(
            pair, transfers(sharper.kernels, kernels_without_infrared(channel, leak, sharper), spacing_px)
        )
    return score


def filters(shape: tuple[int, int], spacing_px: float) -> Iterator[Float32Array]:
    """Ring-shaped band-pass filters, [h, w/2 + 1], that overlap by half; their squares sum to 1 within the range."""
    radius = np.hypot(*fourier.frequencies(shape, spacing_px))
    edges = np.linspace(LOWEST_CYCLES_PX, HIGHEST_CYCLES_PX, BANDS + 1)
    width = edges[1] - edges[0]
    for low, high in itertools.pairwise(edges):
        distance = np.minimum(np.abs(radius - (low + high) / 2) / width, 1)
        yield np.cos(np.pi / 2 * distance).astype(np.float32)


def transfers(kernels: NDArray, green_kernels: NDArray, spacing_px: float) -> Float32Array:
    """T of each level and band, [level, band], for a texture of natural power spectrum 1/f^2 within the band."""
    shape = (TABLE_GRID, TABLE_GRID)
    infrared = fourier.transfer(kernels, shape, spacing_px)
    green = fourier.transfer(green_kernels, shape, spacing_px)
    radius = np.hypot(*fourier.frequencies(shape, spacing_px))
    texture = np.maximum(radius, 0.5 / (TABLE_GRID * spacing_px)) ** -2
    table = np.empty((len(kernels), BANDS), np.float32)
    for index, ring in enumerate(filters(shape, spacing_px)):
        weight = texture * ring**2
        for level in range(len(kernels)):
            cross = plane_mean(weight * (green[level] * np.conj(infrared[level])).real, TABLE_GRID)
            power = plane_mean(weight * np.abs(infrared[level]) ** 2, TABLE_GRID)
            table[level, index] = cross / max(power, 1e-20)
    return table


def energies(
    spectra: Sequence[Complex64Array],
    noise: Sequence[Float32Array],
    shape: tuple[int, int],
    window: Window,
    spacing_px: float,
    leaks: Sequence[float] = (),
    likeness: Float32Array | None = None,
    at: Places | None = None,
) -> list[Energies]:
    """Energies in each band of the sharper channel with each visible one.

    Args:
        spectra: spectra of the channels, [h, w/2 + 1] each, the sharper one first.
        noise: noise variances of the channels, [h, w] each, in the same order; their size is the frame's.
        shape: of the padded grid.
        window: the patch.
        spacing_px: sample spacing, raw pixels.
        leaks: multiples of the sharper channel that were subtracted from each visible one. Their noise is then
            correlated, which is corrected here.
        likeness: the patches' guide [n, h, w] (:func:`guide`); None for the plain window.
        at: rows and columns of the samples whose patches are wanted; all by default.
    """
    height, width = noise[0].shape
    visible = len(spectra) - 1
    of = None if likeness is None else taps((height, width), window, spacing_px, at)

    def means(images: Sequence[Float32Array]) -> Float32Array:  # at the taps, or over the patch already
        if of:
            return gaussian_means(images, TAP_BLUR * of.step, of.places)
        return _window_means(images, window, spacing_px, at)

    share, stack = [], []
    for ring in filters(shape, spacing_px):
        share.append(plane_mean(ring**2, shape[1]))
        sharper, *others = (fourier.inverse(s * ring, shape)[:height, :width] for s in spectra)
        images = [sharper * sharper, *(o * o for o in others), *(o * sharper for o in others)]
        stack.append(means(images) / np.float32(share[-1]))
    found = np.concatenate([*stack, means(noise)])
    if of and likeness is not None:
        found = patch_means(found, likeness, of)
    variances = found[-len(noise) :]
    parts = found[: -len(noise)].reshape(len(share), 1 + 2 * visible, *found.shape[1:]).swapaxes(0, 1)
    samples = 4 * np.pi * (window.side_px / spacing_px) ** 2 / 12 * np.array(share)  # of a Gaussian patch
    pairs = []
    for number, leak in zip(range(1, visible + 1), leaks or [0.0] * visible, strict=True):
        product = parts[visible + number] + np.float32(leak) * variances[0]
        pairs.append(Energies(parts[number], parts[0], product, variances[number], variances[0], samples))
    return pairs


def guide(
    sharper: Float32Array, visible: Sequence[Float32Array], floors: Sequence[Float32Array], spacing_px: float
) -> Float32Array:
    """Logarithms of the ratios of the visible channels to the sharper one, in units of ``GUIDE_SIGMA``, [n, h, w].

    ``floors`` are lower bounds of the planes, [h, w] each, the sharper channel's first: noise standard deviations.
    """
    blurred = [
        np.log(np.maximum(cv2.GaussianBlur(plane, (0, 0), GUIDE_BLUR_PX / spacing_px), floor))
        for plane, floor in zip((sharper, *visible), floors, strict=True)
    ]
    return np.stack([(image - blurred[0]) / GUIDE_SIGMA for image in blurred[1:]]).astype(np.float32)


class Taps(NamedTuple):
    """Taps, the sampling points of patches: ``TAP_PX`` apart, each the mean of its surroundings.

    Patches whose centres are as far apart share taps, so that large frames need little memory.
    """

    step: int  # samples between taps
    sigma: float  # of the patch, samples
    places: Places | None  # rows and columns of the frame with taps; None for all
    rows: NDArray[np.intp]  # of each patch's taps among these, [patch, tap]; -1 outside of the frame
    columns: NDArray[np.intp]


def taps(frame: tuple[int, ...], window: Window, spacing_px: float, at: Places | None = None) -> Taps:
    """The taps of the patches centred at the rows and columns ``at`` of a frame [h, w]; all samples by default."""
    step = max(round(TAP_PX / spacing_px), 1)
    sigma = window.side_px / spacing_px / np.sqrt(12)
    radius = int(np.ceil(2 * sigma / step))
    needed, indices = [], []
    for middles, length in zip(at or [np.arange(length) for length in frame], frame, strict=True):
        wanted = middles[:, None] + step * np.arange(-radius, radius + 1)
        inside = (wanted >= 0) & (wanted < length)
        needed.append(np.unique(wanted[inside]))
        indices.append(np.where(inside, np.searchsorted(needed[-1], wanted), -1))
    return Taps(step, sigma, None if at is None else (needed[0], needed[1]), indices[0], indices[1])


def patch_means(sampled: Float32Array, likeness: Float32Array, of: Taps) -> Float32Array:
    """Means over patches of images [n, h, w] at the taps, weighted by similarity of ``likeness`` [m, h, w]."""
    if of.places is not None:
        likeness = np.ascontiguousarray(likeness[:, of.places[0][:, None], of.places[1]])
    result = np.empty((len(sampled), len(of.rows), len(of.columns)), np.float32)
    _bilateral(sampled, likeness, of.step, np.float32(of.sigma), of.rows, of.columns, result)
    return result


def _window_means(images: Sequence[Float32Array], window: Window, spacing_px: float, at: Places | None) -> Float32Array:
    """Means over the plain window, [n, row, column]."""
    means = np.stack([window_mean(np.ascontiguousarray(image), window, spacing_px) for image in images])
    return means if at is None else means[:, at[0][:, None], at[1]]


@njit(cache=True, parallel=True, fastmath=True)
def _bilateral(  # pragma: no cover - compiled
    stack: Float32Array,
    likeness: Float32Array,
    step: int,
    sigma: np.float32,
    rows: NDArray[np.intp],
    columns: NDArray[np.intp],
    result: Float32Array,
) -> None:
    """Bilateral means: Gaussian weights in space (``sigma`` samples) and in ``likeness`` (unit sigma).

    ``rows`` and ``columns`` [middle, tap] are places in the images, -1 outside of them, of taps ``step`` samples apart.
    """
    radius = rows.shape[1] // 2
    for row in prange(len(rows)):
        total = np.empty(len(stack), np.float32)
        y = rows[row, radius]
        for column in range(len(columns)):
            x = columns[column, radius]
            total[:] = 0
            norm = np.float32(0)
            for down in range(2 * radius + 1):
                yy = rows[row, down]
                if yy < 0:
                    continue
                for right in range(2 * radius + 1):
                    xx = columns[column, right]
                    if xx < 0:
                        continue
                    squares = ((down - radius) * step) ** 2 + ((right - radius) * step) ** 2
                    exponent = np.float32(squares) / (2 * sigma * sigma)
                    for c in range(likeness.shape[0]):
                        exponent += (likeness[c, y, x] - likeness[c, yy, xx]) ** 2 / 2
                    if exponent > LARGEST_EXPONENT:
                        continue
                    weight = np.exp(-exponent)
                    norm += weight
                    for k in range(len(stack)):
                        total[k] += weight * stack[k, yy, xx]
            for k in range(len(stack)):
                result[k, row, column] = total[k] / norm


def log_likelihood(pair: Energies, table: Float32Array) -> Float32Array:
    """Log likelihood of each level at every sample, [level, h, w], up to a constant; ``table`` [level, band] holds T.

    -1/2 sum r^2 / var(r) over the bands, with the residual r of the module's docstring at the best gain g, and
    var(r) = <I I> (V + g^2 T^2 s_IR^2 n) / N. V = <G G> - <G I>^2 / <I I> is the energy of green that infrared does
    not predict, at least green's noise variance; n = s_IR^2 / <I I> is the share of noise; N is the number of
    independent values.
    """
    score = np.empty((len(table), *pair.green_noise.shape), np.float32)
    _fit(
        pair.green, pair.sharper, pair.product, pair.green_noise, pair.sharper_noise,
        pair.values.astype(np.float32), table, score,
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
    """:func:`log_likelihood`, pixel by pixel."""
    levels, bands = table.shape
    for y in prange(green_noise.shape[0]):
        power = np.empty(bands, np.float32)
        signal = np.empty(bands, np.float32)
        unpredicted = np.empty(bands, np.float32)
        noise_power = np.empty(bands, np.float32)
        for x in range(green_noise.shape[1]):
            noise = sharper_noise[y, x]
            for b in range(bands):
                energy = sharper[b, y, x]
                power[b] = max(energy, noise) + TINY
                signal[b] = max(energy - noise, np.float32(0))
                rest = green[b, y, x] - product[b, y, x] ** 2 / (energy + TINY)
                unpredicted[b] = max(rest, green_noise[y, x]) + TINY
                noise_power[b] = noise * noise / power[b]
            for k in range(levels):
                gain = np.float32(0)
                for _ in range(GAIN_STEPS):
                    top = np.float32(0)
                    bottom = TINY
                    for b in range(bands):
                        step = table[k, b] * signal[b]
                        variance = unpredicted[b] + (gain * table[k, b]) ** 2 * noise_power[b]
                        weight = count[b] / (power[b] * variance)
                        top += weight * product[b, y, x] * step
                        bottom += weight * step * step
                    gain = max(top / bottom, np.float32(SMALLEST_GAIN))
                total = np.float32(0)
                for b in range(bands):
                    rest = product[b, y, x] - gain * table[k, b] * signal[b]
                    variance = unpredicted[b] + (gain * table[k, b]) ** 2 * noise_power[b]
                    total += count[b] * rest * rest / (power[b] * variance)
                score[k, y, x] = -total / 2


def standard_error(score: Float32Array) -> Float32Array:
    """Standard deviation of the level, [h, w], with the normalised likelihood as probability of each level.

    ``score`` is the log likelihood, [level, h, w].
    """
    top = score.max(axis=0)
    total, first, second = np.zeros((3, *top.shape), np.float32)
    for level, plane in enumerate(score):
        weight = np.asarray(cv2.exp(plane - top), np.float32).reshape(top.shape)
        total += weight
        first += weight * level
        second += weight * level**2
    mean = first / total
    return np.sqrt(np.maximum(second / total - mean**2, 0))
