"""Depth from the blur of green relative to infrared (sec. 5.2), eq. (9)-(12).

All steps work on the colour planes' own grid of half the resolution: a plane holds no frequency above
0.25 cycles per pixel, so that nothing is lost compared with interpolated images, whose interpolation would differ
between channels. Each plane is shifted to the centres of the 2x2 blocks by the shift theorem. Whole pictures are the
case of samples one pixel apart.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from dasim.typing import Complex64Array, Float32Array
from recon import fourier
from recon.depth import bands
from recon.depth.channels import Also, Channel, Leak
from recon.depth.colour_line import colour_line
from recon.depth.grid import PLANE_SPACING_PX, Grid, filtered, make_grid, noise_gain, transform, window_mean
from recon.depth.level_score import level_score
from recon.depth.ncc import Weights, weight_of
from recon.depth.peak import OFFSET_GRID, peak_offset
from recon.settings import Settings

# Signal over noise of infrared's gradients for which the likelihood is computed; each sample uses the nearest. Values
# assumed too low bias towards small levels, values too high towards large ones: a factor of three is harmless.
SMALLEST_SIGNAL = 1e-3  # of the brightest sample: darker means count as this
STRENGTHS = (1.0, 6.0, 36.0, 216.0)


class Signals(NamedTuple):
    """Signal-to-noise ratios of a picture's gradients at every sample, [h, w]."""

    snr: Float32Array  # signal over noise of the sharper channel's gradients, energies
    green_snr: Float32Array
    quieter: Float32Array  # noise variance over squared signal of green, relative to the sharper channel's


class Typical(NamedTuple):
    """Values measured once for the whole frame, so that all its tiles are scored with the same weights."""

    classes: list[tuple[Weights, NDArray]]  # weights of eq. (9), and the samples [h, w] that each holds for
    offset: NDArray[np.float64]  # of the refined peak at each level


class Match(NamedTuple):
    """Scores [level, h, w] of a frame, and what :func:`recon.depth.peak.best_level` needs with them."""

    score: Float32Array
    plain: Float32Array  # NCC at the best level, [h, w]
    offset: NDArray[np.float64]  # of the refined peak at each level
    snr: Float32Array  # signal over noise of the sharper channel's gradients, energies, [h, w]
    green_snr: Float32Array


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
    gain = noise_gain(grid.filters, grid.shape[1])

    def signal_over_noise(spectrum: Complex64Array, noise: Float32Array) -> Float32Array:
        images = filtered(spectrum, grid.filters, grid)
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
        return bands.scored(sharper, [(green, leak or Leak(0.0, 0.0)), *also], spectra[0], grid, settings)
    kernels = sharper[3]
    observed = filtered(spectra[1], grid.filters, grid) if settings.score == "ncc" else None
    score, ncc = np.empty((2, len(kernels), *grid.frame), np.float32)
    for level, (kernel, green_kernel) in enumerate(zip(kernels, green[3], strict=True)):
        own = fourier.transfer(kernel, grid.shape, spacing_px)
        other = fourier.transfer(green_kernel, grid.shape, spacing_px)
        if settings.score == "colour-line":
            score[level], ncc[level] = colour_line(own, other, settings, spectra, grid)
            continue
        for weights, where in classes:
            if where.any():
                found = level_score(own, other, weights, settings, spectra, grid, observed)
                score[level][where], ncc[level][where] = (f[where] for f in found)
    return score, np.take_along_axis(ncc, score.argmax(axis=0)[None], 0)[0]


def _spectra(
    sharper: Channel, green: Channel, settings: Settings, spacing_px: float
) -> tuple[Grid, tuple[Complex64Array, Complex64Array]]:
    height, width = sharper[2].shape
    whole = sharper[0].shape == (height, width)
    shape = padded_shape(sharper, spacing_px) if whole else (sharper[0].shape[0], sharper[0].shape[1])
    grid = make_grid(shape, (height, width), spacing_px, settings)
    first, second = (transform(plane, phase, shape, spacing_px) for plane, phase, _, _ in (sharper, green))
    return grid, (first, second)


def padded_shape(channel: Channel, spacing_px: float = PLANE_SPACING_PX) -> tuple[int, int]:
    """Size of the padded, periodic plane of a channel."""
    return fourier.fast_shape(channel[2].shape, int(np.ceil(channel[3].shape[-1] / spacing_px)))


def _unit_weight(kernels: NDArray, settings: Settings, spacing_px: float) -> float:
    """Weight beta of eq. (9) for gradients as strong as their noise: divide by the signal over noise."""
    shape = (OFFSET_GRID, OFFSET_GRID)
    grid = make_grid(shape, shape, spacing_px, settings)
    return weight_of(fourier.transfer(kernels, shape, spacing_px), 1.0, grid, settings)


def _quieter(
    sharper: Channel, green: Channel, brightest: tuple[float, float], settings: Settings, spacing_px: float
) -> Float32Array:
    """Noise variance over squared signal of green, relative to the sharper channel's, [h, w].

    The signal is the mean over the patch: a texture has about the same contrast in both channels, whatever their blur.
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
