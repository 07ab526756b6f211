"""Depth from the blur of green relative to infrared (sec. 5.2), eq. (9)-(12).

All is done on the colour planes' own grid of half the resolution: a plane holds no frequency above
0.25 cycles a pixel, so nothing is lost against interpolated images, whose interpolation would differ
between channels. Each plane is moved to the middle of the 2x2 blocks by the shift theorem. Whole pictures are the
case of samples one pixel apart.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from dasim.typing import Complex64Array, Float32Array
from recon import fourier
from recon.depth import bands, reblur
from recon.depth.reblur import Weights, window_mean
from recon.picture.mosaic import Phase
from recon.settings import Settings

Channel = tuple[Float32Array, Phase, Float32Array, NDArray]  # plane, phase, noise variance, kernels [level, y, x]

PLANE_SPACING_PX = 2.0
OFFSET_GRID = 96
REFERENCE_ERROR = 1.0  # levels: an estimate with this standard error has a confidence of one half
INDEPENDENT_SHARE = 0.5  # of a window's samples, after the band-pass
# Signal over noise of infrared's gradients for which the likelihood is computed; each sample takes the nearest.
# Too weak an assumption draws to small levels, too strong a one to large: a factor of three either way is harmless.
SMALLEST_SIGNAL = 1e-3  # of the brightest sample: darker means count as this
STRENGTHS = (1.0, 6.0, 36.0, 216.0)


class Leak(NamedTuple):
    """Infrared in a channel: alpha of eq. (8), and white's infrared electrons over its own under the light."""

    alpha: float
    white: float


Also = Sequence[tuple[Channel, Leak]]  # further visible channels, compared in the same way by the score ``bands``


class Signals(NamedTuple):
    """What the picture tells of its own gradients and noise at every sample, [h, w]."""

    snr: Float32Array  # signal over noise of the sharper channel's gradients, energies
    green_snr: Float32Array
    quieter: Float32Array  # noise variance over squared signal of green, relative to the sharper channel's


class Typical(NamedTuple):
    """What is measured once for the whole frame, so that its tiles are scored alike."""

    classes: list[tuple[Weights, NDArray]]  # weights of eq. (9), and the samples [h, w] that each holds for
    offset: NDArray[np.float64]  # of the refined peak at each level


class Match(NamedTuple):
    """What :func:`match` finds: scores [level, h, w], and what :func:`best_level` needs of them."""

    score: Float32Array
    plain: Float32Array  # NCC at the best level, [h, w]
    offset: NDArray[np.float64]  # of the refined peak at each level
    snr: Float32Array  # signal over noise of the sharper channel's gradients, energies, [h, w]
    green_snr: Float32Array


def transform(
    plane: Float32Array, phase: Phase, shape: tuple[int, int], spacing_px: float = PLANE_SPACING_PX
) -> Complex64Array:
    """Spectrum of a plane [h, w], padded to ``shape``, moved to the middle of the blocks of ``spacing_px``.

    ``phase`` is the place of its first sample in the block, in pixels.
    """
    fy, fx = fourier.frequencies(shape, spacing_px)
    middle = (spacing_px - 1) / 2
    shift = fy * (middle - phase[0]) + fx * (middle - phase[1])
    moved = np.exp(2j * np.pi * shift).astype(np.complex64)
    return fourier.forward(fourier.pad_blended(plane, shape)) * moved


def match(
    sharper: Channel,
    green: Channel,
    settings: Settings,
    spacing_px: float = PLANE_SPACING_PX,
    leak: Leak | None = None,
) -> Match:
    """Score of every level at every sample, by ``settings.score``.

    Each channel comes as (plane [h, w], phase, noise variance map, kernels [level, size, size]), samples
    ``spacing_px`` apart, kernels in pixels. ``leak`` serves the score ``bands`` alone.
    """
    found = signals(sharper, green, settings, spacing_px)
    told = typical(found, sharper[3], green[3], settings, spacing_px)
    score, plain = scores(sharper, green, told.classes, settings, spacing_px, leak)
    return Match(score, plain, told.offset, found.snr, found.green_snr)


def signals(
    sharper: Channel,
    green: Channel,
    settings: Settings,
    spacing_px: float = PLANE_SPACING_PX,
    brightest: tuple[float, float] | None = None,
) -> Signals:
    """Signal over noise of two channels.

    Of tiles, ``brightest`` are the largest values of their frames, and the planes are larger than the variances: beyond
    these (below and to the right, periodic) they go on as the frame does.
    """
    grid, spectra = _spectra(sharper, green, settings, spacing_px)
    gain = reblur.noise_gain(grid.filters, grid.shape[1])

    def signal_over_noise(spectrum: Complex64Array, noise: Float32Array) -> Float32Array:
        images = reblur.filtered(spectrum, grid.filters, grid)
        energy = window_mean(np.sum([image * image for image in images], axis=0), settings, spacing_px)
        return energy / (gain * window_mean(noise, settings, spacing_px)) - 1

    snr, green_snr = signal_over_noise(spectra[0], sharper[2]), signal_over_noise(spectra[1], green[2])
    tops = brightest or (float(sharper[0].max()), float(green[0].max()))
    return Signals(snr, green_snr, _quieter(sharper, green, tops, settings, spacing_px))


def typical(
    found: Signals, kernels: NDArray, green_kernels: NDArray, settings: Settings, spacing_px: float = PLANE_SPACING_PX
) -> Typical:
    """The weights of eq. (9) and where a peak lies, from the signals of a whole frame."""
    if settings.score == "bands":  # has no weights, and its own refinement
        return Typical([], np.zeros(len(kernels)))
    unit = _unit_weight(kernels, settings, spacing_px)
    edges = (found.snr > settings.edge_snr) & (found.green_snr > settings.edge_snr)
    classes = _classes(found.snr, edges, found.quieter, unit, settings)
    if settings.score == "colour-line":  # published without refinement: its parabola is left as it is
        return Typical(classes, np.zeros(len(kernels)))
    most = max(classes, key=lambda item: int(item[1].sum()))[0]
    return Typical(classes, peak_offset(kernels, green_kernels, most, settings, spacing_px))


def scores(
    sharper: Channel,
    green: Channel,
    classes: list[tuple[Weights, NDArray]],
    settings: Settings,
    spacing_px: float = PLANE_SPACING_PX,
    leak: Leak | None = None,
    also: Also = (),
) -> tuple[Float32Array, Float32Array]:
    """Score of every level [level, h, w] with the weights of ``classes``, and the plain NCC at the best, [h, w].

    ``leak`` and ``also`` serve the score ``bands`` alone.
    """
    grid, spectra = _spectra(sharper, green, settings, spacing_px)
    if settings.score == "bands":
        return _by_bands(sharper, [(green, leak or Leak(0.0, 0.0)), *also], spectra[0], grid, settings)
    kernels = sharper[3]
    observed = reblur.filtered(spectra[1], grid.filters, grid) if settings.score == "ncc" else None
    score, ncc = np.empty((2, len(kernels), *grid.frame), np.float32)
    for level, (kernel, green_kernel) in enumerate(zip(kernels, green[3], strict=True)):
        own = fourier.transfer(kernel, grid.shape, spacing_px)
        other = fourier.transfer(green_kernel, grid.shape, spacing_px)
        if settings.score == "colour-line":
            score[level], ncc[level] = reblur.colour_line(own, other, settings, spectra, grid)
            continue
        for weights, where in classes:
            if where.any():
                found = reblur.level_score(own, other, weights, settings, spectra, grid, observed)
                score[level][where], ncc[level][where] = (f[where] for f in found)
    return score, np.take_along_axis(ncc, score.argmax(axis=0)[None], 0)[0]


def _by_bands(
    sharper: Channel, visible: Also, spectrum: Complex64Array, grid: reblur.Grid, settings: Settings
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
    likeness = bands.guide(planes[0], planes[1:], floors, spacing_px) if settings.alike else None
    leaks = [leak.alpha for _, leak in visible]
    found = bands.energies(spectra, noise, (grid.shape, grid.frame), settings, spacing_px, leaks, likeness)
    score = np.zeros((len(sharper[3]), height, width), np.float32)
    for pair, (channel, leak) in zip(found, visible, strict=True):
        share = leak.alpha * leak.white
        kernels = (channel[3] - share * sharper[3]) / (1 - share)
        score += bands.log_likelihood(pair, bands.transfers(sharper[3], kernels, spacing_px))
    return score, np.ones(grid.frame, np.float32)


def _spectra(
    sharper: Channel, green: Channel, settings: Settings, spacing_px: float
) -> tuple[reblur.Grid, tuple[Complex64Array, Complex64Array]]:
    height, width = sharper[2].shape
    whole = sharper[0].shape == (height, width)
    shape = padded_shape(sharper, spacing_px) if whole else (sharper[0].shape[0], sharper[0].shape[1])
    grid = reblur.make_grid(shape, (height, width), spacing_px, settings)
    first, second = (transform(plane, phase, shape, spacing_px) for plane, phase, _, _ in (sharper, green))
    return grid, (first, second)


def padded_shape(channel: Channel, spacing_px: float = PLANE_SPACING_PX) -> tuple[int, int]:
    """Size in which a channel's plane is taken for periodic."""
    return fourier.fast_shape(channel[2].shape, int(np.ceil(channel[3].shape[-1] / spacing_px)))


def _unit_weight(kernels: NDArray, settings: Settings, spacing_px: float) -> float:
    """Weight beta of eq. (9) for gradients as strong as their noise: divide by the signal over noise."""
    shape = (OFFSET_GRID, OFFSET_GRID)
    grid = reblur.make_grid(shape, shape, spacing_px, settings)
    return reblur.weight_of(fourier.transfer(kernels, shape, spacing_px), 1.0, grid, settings)


def _quieter(
    sharper: Channel, green: Channel, brightest: tuple[float, float], settings: Settings, spacing_px: float
) -> Float32Array:
    """Noise variance over squared signal of green, relative to the sharper channel's, [h, w].

    The signal is the patch's mean: a texture has about the same contrast in both channels, whatever their blur.
    """
    relative = []
    for (plane, _, variance, _), top in ((green, brightest[1]), (sharper, brightest[0])):
        own = np.ascontiguousarray(plane[: variance.shape[0], : variance.shape[1]])
        mean = np.maximum(window_mean(own, settings, spacing_px), SMALLEST_SIGNAL * max(top, 1e-6))
        relative.append(window_mean(variance, settings, spacing_px) / mean**2)
    return relative[0] / relative[1]


def _classes(
    snr: Float32Array, edges: NDArray, quieter: Float32Array, unit: float, settings: Settings
) -> list[tuple[Weights, NDArray]]:
    """Weights of eq. (9) and the samples [h, w] that each holds for; ``unit`` is that of signals as strong as noise.

    Eq. (9) has one weight for the frame, so the NCC has one class, of the median over the edges.
    """

    def weights(strength: float, where: NDArray) -> Weights:
        ratio = float(np.median(quieter[where])) if where.any() else 1.0
        return Weights(unit / strength, unit / strength * ratio)

    if settings.score != "likelihood":
        strength = float(np.median(snr[edges])) if edges.any() else 1.0
        return [(weights(strength, edges), np.ones(snr.shape, bool))]
    middle = np.sqrt(np.array(STRENGTHS[1:]) * np.array(STRENGTHS[:-1]))
    index = np.searchsorted(middle, snr)
    return [
        (weights(strength, edges & (index == number)), index == number)
        for number, strength in enumerate(STRENGTHS)
        if (index == number).any()
    ]


def peak_offset(
    kernels: NDArray, green_kernels: NDArray, weights: Weights, settings: Settings, spacing_px: float
) -> NDArray[np.float64]:
    """How far the refined peak lies from each true level, [level], from the kernels alone.

    The score falls faster towards less blur than towards more, so the vertex of a parabola misses its maximum, up to
    0.3 levels. Expected score of neighbouring levels for a texture of natural spectrum (power 1/f^2) and the
    weights of eq. (9) given, on a small grid; deviation: the paper names no refinement.
    """
    shape = (OFFSET_GRID, OFFSET_GRID)
    grid = reblur.make_grid(shape, shape, spacing_px, settings)
    small = fourier.transfer(kernels, shape, spacing_px)
    large = fourier.transfer(green_kernels, shape, spacing_px)
    texture = 1 / np.maximum(grid.gradient, OFFSET_GRID**-2)
    steps = [reblur.level_filters(s, g, weights, settings, grid) for s, g in zip(small, large, strict=True)]
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
        sum(reblur.plane_mean(part, shape[1]) for part in parts)
        for parts in (
            [powers[0] * np.abs(m) ** 2 for m in mine],
            [powers[1] * np.abs(o) ** 2 for o in other],
            [(powers[2] * m * np.conj(o)).real for m, o in zip(mine, other, strict=True)],
        )
    )
    ncc = np.array(across / np.sqrt(own * green))
    return float(ncc if settings.score == "ncc" else reblur.log_likelihood(ncc, np.array(green), constant))


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
