"""Scores of all blur levels from the blur of green relative to infrared (sec. 5.2), eq. (9)-(12).

All steps work on the grid of the colour planes, at half the resolution of the mosaic. A plane has no frequencies above
0.25 cycles per pixel, so nothing is lost compared with interpolated images, and no interpolation error differs between
the channels. Each plane is shifted to the centres of the 2x2 blocks by the shift theorem. Full-resolution images are
the case of a sample spacing of one pixel.
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
from recon.depth.grid import (
    PLANE_SPACING_PX,
    Grid,
    Places,
    Window,
    filtered,
    make_grid,
    noise_gain,
    transform,
    window_mean,
)
from recon.depth.level_score import level_score
from recon.depth.ncc import Weights, weight_of
from recon.depth.peak import peak_offset
from recon.settings import Settings

# Signal-to-noise ratios of infrared's gradients for which the likelihood is computed; each sample uses the nearest. A
# ratio that is too low biases to small levels, one that is too high to large levels; a factor of three is harmless.
STRENGTHS = (1.0, 6.0, 36.0, 216.0)
SMALLEST_SIGNAL = 1e-3  # lower bound of a patch's mean, relative to the brightest sample
WEIGHT_GRID = 96  # samples per side of the grid for the weights of eq. (9) and the offset of the peak


class Signals(NamedTuple):
    """Signal-to-noise ratios of the gradients at every sample, [h, w]: energy divided by noise variance."""

    snr: Float32Array  # of the sharper channel
    green_snr: Float32Array
    noise_ratio: Float32Array  # relative noise variance (variance / signal^2) of green divided by the sharper channel's


class FrameWeights(NamedTuple):
    """Values measured once for the whole frame, so that all its tiles are scored with the same weights."""

    classes: list[tuple[Weights, NDArray]]  # weights of eq. (9), and the mask [h, w] of the samples that use them
    offset: NDArray[np.float64]  # of the refined peak at each level, [level]


class Match(NamedTuple):
    """Scores of a frame, with the other arguments of :func:`recon.depth.peak.best_level`."""

    score: Float32Array  # [level, h, w]
    ncc: Float32Array | None  # NCC at the best level, [h, w]; None for the score ``bands``
    offset: NDArray[np.float64]  # of the refined peak at each level, [level]
    snr: Float32Array  # signal-to-noise ratio of the sharper channel's gradients, [h, w]
    green_snr: Float32Array  # [h, w]


def match(
    sharper: Channel,
    green: Channel,
    settings: Settings,
    spacing_px: float = PLANE_SPACING_PX,
    leak: Leak | None = None,
) -> Match:
    """Score of every level at every sample of a frame, by ``settings.score``.

    The sample spacing of both channels is ``spacing_px`` raw pixels. Only the score ``bands`` uses ``leak``.
    """
    signal = signals(sharper, green, settings, spacing_px)
    weights = frame_weights(signal, sharper.kernels, green.kernels, settings, spacing_px)
    score, ncc = scores(sharper, green, weights.classes, settings, spacing_px, leak)
    return Match(score, ncc, weights.offset, signal.snr, signal.green_snr)


def signals(
    sharper: Channel,
    green: Channel,
    settings: Settings,
    spacing_px: float = PLANE_SPACING_PX,
    brightest: tuple[float, float] | None = None,
) -> Signals:
    """Signal-to-noise ratios of two channels.

    For tiles, ``brightest`` gives the maxima of the two full planes. The planes of a tile are larger than the
    variances: they are periodic, with the halo below and to the right of the tile.
    """
    grid, spectra = _spectra(sharper, green, settings, spacing_px)
    window = window_of(settings)
    gain = noise_gain(grid.filters, grid.shape[1])

    def signal_over_noise(spectrum: Complex64Array, noise: Float32Array) -> Float32Array:
        images = filtered(spectrum, grid.filters, grid)
        energy = window_mean(np.sum([image * image for image in images], axis=0), window, spacing_px)
        return energy / (gain * window_mean(noise, window, spacing_px)) - 1

    snr, green_snr = signal_over_noise(spectra[0], sharper.variance), signal_over_noise(spectra[1], green.variance)
    maxima = brightest or (float(sharper.plane.max()), float(green.plane.max()))
    return Signals(snr, green_snr, _noise_ratio(sharper, green, maxima, window, spacing_px))


def frame_weights(
    signal: Signals, kernels: NDArray, green_kernels: NDArray, settings: Settings, spacing_px: float = PLANE_SPACING_PX
) -> FrameWeights:
    """Weights of eq. (9) and offsets of the peak, from the signals of a whole frame and the kernels [level, y, x]."""
    if settings.score == "bands" or settings.score == "joint":  # needs no weights, and its peak no correction
        return FrameWeights([], np.zeros(len(kernels)))
    shape = (WEIGHT_GRID, WEIGHT_GRID)
    grid = make_grid(shape, shape, spacing_px, settings.cutoff_cycles_px, settings.gradient)
    unit = weight_of(fourier.transfer(kernels, shape, spacing_px), 1.0, grid, settings.prior_factor)
    edges = (signal.snr > settings.edge_snr) & (signal.green_snr > settings.edge_snr)
    classes = _classes(signal, edges, unit, by_strength=settings.score == "likelihood")
    if settings.score == "colour-line":  # published without a correction of the peak
        return FrameWeights(classes, np.zeros(len(kernels)))
    most = max(classes, key=lambda item: int(item[1].sum()))[0]
    return FrameWeights(classes, peak_offset(kernels, green_kernels, most, settings.score, grid))


def scores(
    sharper: Channel,
    green: Channel,
    classes: list[tuple[Weights, NDArray]],
    settings: Settings,
    spacing_px: float = PLANE_SPACING_PX,
    leak: Leak | None = None,
    also: Also = (),
    at: Places | None = None,
) -> tuple[Float32Array, Float32Array | None]:
    """Score of every level, [level, h, w], and the NCC at the best level, [h, w] (None for the score ``bands``).

    ``classes`` are those of :func:`frame_weights`. Only the score ``bands`` uses ``leak``, ``also``, and ``at``, the
    rows and columns of the samples to score.
    """
    window = window_of(settings)
    if settings.score == "bands" or settings.score == "joint":  # the second adds to the first (:mod:`recon.depth.best`)
        channels = [(green, leak or Leak(0.0, 0.0)), *also]
        shape = _grid_shape(sharper, spacing_px)
        return bands.scored(sharper, channels, shape, window, spacing_px, alike=settings.alike, at=at), None
    grid, spectra = _spectra(sharper, green, settings, spacing_px)
    observed = filtered(spectra[1], grid.filters, grid) if settings.score == "ncc" else None
    score, ncc = np.empty((2, len(sharper.kernels), *grid.frame), np.float32)
    for level, (kernel, green_kernel) in enumerate(zip(sharper.kernels, green.kernels, strict=True)):
        infrared = fourier.transfer(kernel, grid.shape, spacing_px)
        visible = fourier.transfer(green_kernel, grid.shape, spacing_px)
        if settings.score == "colour-line":
            score[level], ncc[level] = colour_line(infrared, visible, window, settings.diagonals, spectra, grid)
            continue
        for weights, where in classes:
            if where.any():
                images = level_score(infrared, visible, weights, settings.score, window, spectra, grid, observed)
                score[level][where], ncc[level][where] = (image[where] for image in images)
    return score, np.take_along_axis(ncc, score.argmax(axis=0)[None], 0)[0]


def _spectra(
    sharper: Channel, green: Channel, settings: Settings, spacing_px: float
) -> tuple[Grid, tuple[Complex64Array, Complex64Array]]:
    """The padded grid of a frame or a tile, and the spectra of both channels on it, [h, w/2 + 1]."""
    height, width = sharper.variance.shape
    shape = _grid_shape(sharper, spacing_px)
    grid = make_grid(shape, (height, width), spacing_px, settings.cutoff_cycles_px, settings.gradient)
    first, second = (transform(channel.plane, channel.phase, shape, spacing_px) for channel in (sharper, green))
    return grid, (first, second)


def _grid_shape(channel: Channel, spacing_px: float) -> tuple[int, int]:
    """Size [h, w] of the grid: of a plane with its halo, or of a whole one after padding."""
    height, width = channel.plane.shape
    return padded_shape(channel, spacing_px) if (height, width) == channel.variance.shape else (height, width)


def padded_shape(channel: Channel, spacing_px: float = PLANE_SPACING_PX) -> tuple[int, int]:
    """Size [h, w] of the padded, periodic plane of a channel."""
    return fourier.fast_shape(channel.variance.shape, int(np.ceil(channel.kernels.shape[-1] / spacing_px)))


def window_of(settings: Settings) -> Window:
    """The patch of the settings."""
    return Window(settings.window_px, settings.window)


def _noise_ratio(
    sharper: Channel, green: Channel, brightest: tuple[float, float], window: Window, spacing_px: float
) -> Float32Array:
    """Relative noise variance (variance / signal^2) of green divided by the sharper channel's, [h, w].

    The signal is the mean over the patch, because a texture has about the same contrast in both channels.
    """
    relative = []
    for channel, maximum in ((green, brightest[1]), (sharper, brightest[0])):
        height, width = channel.variance.shape
        frame = np.ascontiguousarray(channel.plane[:height, :width])
        mean = np.maximum(window_mean(frame, window, spacing_px), SMALLEST_SIGNAL * max(maximum, 1e-6))
        relative.append(window_mean(channel.variance, window, spacing_px) / mean**2)
    return relative[0] / relative[1]


def _classes(signal: Signals, edges: NDArray, unit: float, *, by_strength: bool) -> list[tuple[Weights, NDArray]]:
    """Weights of eq. (9), and the mask [h, w] of the samples that use them.

    ``unit`` is the weight at a signal-to-noise ratio of 1. With ``by_strength`` there is one class for each of
    ``STRENGTHS``; otherwise, as in eq. (9), one weight for the frame, from the median over the ``edges`` [h, w].
    """
    snr = signal.snr

    def weights(strength: float, where: NDArray) -> Weights:
        ratio = float(np.median(signal.noise_ratio[where])) if where.any() else 1.0
        return Weights(unit / strength, unit / strength * ratio)

    if not by_strength:
        strength = float(np.median(snr[edges])) if edges.any() else 1.0
        return [(weights(strength, edges), np.ones(snr.shape, bool))]
    middle = np.sqrt(np.array(STRENGTHS[1:]) * np.array(STRENGTHS[:-1]))
    index = np.searchsorted(middle, snr)
    return [
        (weights(strength, edges & (index == number)), index == number)
        for number, strength in enumerate(STRENGTHS)
        if (index == number).any()
    ]
