"""The preset ``best``: a likelihood of all channels together in windows of two sizes, joined over smooth surfaces.

Small windows show where objects end, large ones read weak texture. The scores of both sizes are added with a weight
each, because they share samples, and so is the score of :mod:`recon.depth.bands`, which does not ask the texture's
spectrum to be natural and is better at large blur. Neighbours are joined before a level is chosen
(:mod:`recon.depth.surfaces`): the level is the mean of the posterior.

The side of the focus is not estimated: blur is taken to come from nearer than the focus.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from dasim.typing import BoolArray, Float32Array, FloatArray
from recon.depth import cross_spectra, surfaces
from recon.depth.channels import Channel, Leak
from recon.depth.cross_spectra import Window
from recon.depth.grid import PLANE_SPACING_PX
from recon.depth.joint_likelihood import log_likelihood

WINDOWS = (Window(10.0, 4), Window(28.0, 8))
WINDOW_WEIGHT, BANDS_WEIGHT = 0.6, 0.2
NODE = 4  # samples of the planes between the nodes at which levels are estimated
FINEST, RELATIVE = 0.25, 1 / 16  # spacing of levels: the larger of a number of levels and a share of the level
LEAST_RANGE = 10.0  # of a score over the levels: windows of noise alone stay below it
FAR = 0.5  # exponent of the prior (1 + level / 2)^-FAR: random rooms hold more at small blur
GUIDE_BLUR = 1.0  # standard deviation in samples
GUIDE_FLOOR = 2.0  # noise standard deviations that are added before the logarithm
# Of the posterior's standard deviation, and added to it: what the model leaves out, above all small objects that a
# smooth surface swallows. Measured on the set ``tune`` (validation/subjects/held_out.toml).
SD_FACTOR, SD_SHARE, SD_MOST = 1.5, 0.25, 2.0

Scores = Callable[[NDArray[np.intp], NDArray[np.intp]], Float32Array]
"""Log likelihood of each level of the bank at rows and columns of the planes, [row, column, level]."""


class Map(NamedTuple):
    """Levels and their standard deviations at the planes' samples, [h, w]."""

    level: Float32Array
    sd: Float32Array  # infinite in a frame without texture
    window_level: Float32Array  # from the windows alone, before neighbours are joined
    window_sd: Float32Array  # infinite without texture


def estimate(
    visible: Channel, infrared: Channel, leak: Leak, clipped: BoolArray, most_clipped: float, bands: Scores
) -> Map:
    """Levels of every sample of the planes, from green and infrared.

    Red and blue would add information in theory; on the captures of the set ``tune`` they made the estimate worse.

    Args:
        visible: the visible channel, green.
        infrared: the infrared channel.
        leak: infrared in the visible channel.
        clipped: samples that are clipped, [h, w].
        most_clipped: share of them in a window from which on the window says nothing.
        bands: score of :mod:`recon.depth.bands`.
    """
    channels = (visible, infrared)
    shape = infrared.variance.shape
    nodes = cross_spectra.nodes(shape, NODE)
    levels = level_grid(len(infrared.kernels) - 1)
    score = _resampled(bands(*nodes), np.arange(len(infrared.kernels)), levels, 2)
    score = BANDS_WEIGHT * (score - score.max(axis=-1, keepdims=True))
    shares = [_share(clipped, window.sigma_px) for window in WINDOWS]
    score[shares[0][np.ix_(*nodes)] >= most_clipped] = 0
    score += _window_scores(channels, leak, [share >= most_clipped for share in shares], nodes, levels)
    knows = np.ptp(score, axis=-1) >= LEAST_RANGE
    score = np.asarray(score - FAR * np.log(1 + levels / 2), np.float32)
    window_level, window_sd = _moments(_normalised(score, levels), levels)
    window_sd[~knows] = np.inf
    across, down = surfaces.step_probability(_guide(channels)[:, nodes[0][:, None], nodes[1]])
    level, sd = _moments(surfaces.posterior(score, levels, across, down), levels)
    sd = np.hypot(SD_FACTOR * sd, np.minimum(SD_SHARE * level, SD_MOST))
    if not knows.any():  # neighbours can tell only what some window knows
        sd[:] = np.inf
    return Map(*(_on_samples(image, nodes, shape) for image in (level, sd, window_level, window_sd)))


def level_grid(last: int) -> FloatArray:
    """Levels from 0 to the bank's ``last``; every second one is a grid of twice the spacing."""
    grid = [0.0]
    while grid[-1] < last or len(grid) % 2 == 0:
        grid.append(grid[-1] + max(FINEST, RELATIVE * grid[-1]))
    return np.asarray(np.array(grid) * (last / grid[-1]))


def _window_scores(
    channels: tuple[Channel, Channel],
    leak: Leak,
    unusable: Sequence[BoolArray],
    nodes: tuple[NDArray[np.intp], NDArray[np.intp]],
    levels: FloatArray,
) -> Float32Array:
    """Weighted sum of the scores of all windows at the nodes, [row, column, level]; ``unusable`` says nothing."""
    visible, infrared = channels
    share = leak.alpha * leak.white
    clean = (visible.kernels - share * infrared.kernels) / (1 - share)
    kernels = np.stack([clean, infrared.kernels], axis=1).astype(np.float32)
    phases = [channel.phase for channel in channels]
    knots = levels[::2]
    table = _between(cross_spectra.expected(kernels, phases), knots)
    total = np.zeros((len(nodes[0]), len(nodes[1]), len(knots)), np.float32)
    planes, variances = [channel.plane for channel in channels], [channel.variance for channel in channels]
    found = cross_spectra.measured(planes, phases, variances, [leak.alpha], WINDOWS)
    for spectra, window, without in zip(found, WINDOWS, unusable, strict=True):
        rows, columns = cross_spectra.nodes(infrared.variance.shape, window.step)
        score = log_likelihood(spectra, table)
        score[without[np.ix_(rows, columns)]] = 0
        score = _resampled(_resampled(score, rows, nodes[0], 0), columns, nodes[1], 1)
        total += np.float32(WINDOW_WEIGHT) * score
    return _resampled(total, knots, levels, 2)


def _share(mask: BoolArray, sigma_px: float) -> Float32Array:
    """Share of a mask of samples in the window around each of them, [h, w]."""
    sigma = sigma_px / PLANE_SPACING_PX
    return np.asarray(cv2.GaussianBlur(mask.astype(np.float32), (0, 0), sigma, borderType=cv2.BORDER_REFLECT))


def _between(table: FloatArray, levels: FloatArray) -> FloatArray:
    """Tables of fractional levels, linear between those of the bank."""
    low = np.minimum(levels.astype(int), len(table) - 2)
    share = (levels - low)[:, None, None, None]
    return np.asarray(table[low] * (1 - share) + table[low + 1] * share)


def _resampled(image: Float32Array, old: NDArray, new: NDArray, axis: int) -> Float32Array:
    """Linear interpolation along an axis from places ``old`` to ``new``; constant beyond the ends."""
    place = np.interp(new, old, np.arange(len(old)))
    low = np.minimum(place.astype(int), len(old) - 1)
    high = np.minimum(low + 1, len(old) - 1)
    share = (place - low).astype(np.float32).reshape([-1 if a == axis else 1 for a in range(image.ndim)])
    return np.asarray(np.take(image, low, axis) * (1 - share) + np.take(image, high, axis) * share, np.float32)


def _normalised(score: Float32Array, levels: FloatArray) -> Float32Array:
    """Probability of each level from a window alone."""
    weight = np.exp(score - score.max(axis=-1, keepdims=True)) * np.gradient(levels).astype(np.float32)
    return np.asarray(weight / weight.sum(axis=-1, keepdims=True))


def _moments(probability: Float32Array, levels: FloatArray) -> tuple[Float32Array, Float32Array]:
    """Mean and standard deviation of the level, [h, w]."""
    mean = probability @ levels.astype(np.float32)
    square = probability @ (levels**2).astype(np.float32)
    return mean, np.sqrt(np.maximum(square - mean**2, 0))


def _guide(channels: Sequence[Channel]) -> Float32Array:
    """Logarithms of the channels, lifted above their noise, [channel, h, w]."""
    parts = []
    for channel in channels:
        plane, variance = (
            cv2.GaussianBlur(np.ascontiguousarray(image, np.float32), (0, 0), GUIDE_BLUR)
            for image in (channel.plane, channel.variance)
        )
        noise = np.sqrt(variance)
        parts.append(np.log(np.maximum(plane, noise) + GUIDE_FLOOR * noise + np.float32(1e-6)))
    return np.stack(parts)


def _on_samples(
    image: Float32Array, nodes: tuple[NDArray[np.intp], NDArray[np.intp]], shape: Sequence[int]
) -> Float32Array:
    """An image of the nodes at all samples of the planes."""
    for axis in (0, 1):
        with np.errstate(invalid="ignore"):  # 0 times infinity beside a sample that is unknown: unknown too
            image = _resampled(image, nodes[axis], np.arange(shape[axis]), axis)
    return np.where(np.isnan(image), np.float32(np.inf), image)
