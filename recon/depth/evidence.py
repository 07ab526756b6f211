"""Evidence of the windows around each node about its level: the inputs of :mod:`recon.depth.surface_net`.

Per node:

- the scores of the joint likelihood in windows of two sizes, and the score of :mod:`recon.depth.bands`, each relative
  to its largest value and compressed;
- the logarithm of their posterior on smooth surfaces (:mod:`recon.depth.surfaces`);
- how well the best level explains each window; it explains a window with two depths badly;
- signal-to-noise ratio and coherence of green and infrared in frequency bands;
- the row of the node, because floors come nearer towards the bottom of a picture.

The networks also see the picture at every sample, so that edges between nodes can be found.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from dasim.typing import BoolArray, Float32Array, FloatArray
from recon.depth import cross_spectra, surfaces
from recon.depth.channels import Channel, Leak, kernels_without_infrared
from recon.depth.cross_spectra import Spectra, Window
from recon.depth.grid import PLANE_SPACING_PX
from recon.depth.joint_likelihood import log_likelihood

WINDOWS = (Window(10.0, 4), Window(28.0, 8, even=True))
SHARE_ROUNDING = 1e-6  # of shares of clipped samples
NODE = 4  # samples of the planes between nodes
FINEST, RELATIVE, LAST = 0.5, 1 / 8, 28.0  # spacing of levels: the larger of FINEST and RELATIVE * level
SCORE_UNIT = 10.0  # score difference beyond which the compression is logarithmic
# Weights in the sum of the scores of both windows and of ``bands``, which share samples. WEIGHTS applies when
# neighbours are combined, ALONE to single windows. Chosen on ``tune``, with regard to the scene ``flowers``.
WEIGHTS, ALONE = (0.6, 0.6, 0.2), (1.0, 1.0, 0.2)
FAR = 0.5  # exponent of the prior (1 + level / 2)^-FAR: random rooms hold more at small blur
EXCLUDED = 1e4  # distance below the lowest score, for levels beyond the bank's last
FALL = 10.0  # of a score per level beyond the bank, as a network input
GUIDE_BLUR = 0.6  # standard deviation in samples
GUIDE_FLOOR = 2.0  # noise standard deviations that are added before the logarithm
SURROUNDINGS_PX = 40.0  # window of the mean that the picture is relative to
LEAST_LOG = -14.0  # of the posterior, relative to its largest value
# Inputs: SCORES scores of every level, of which the last is the posterior, FITS, SIGNALS, and the row from -1 to 1.
SCORES = len(WINDOWS) + 2
FITS = len(WINDOWS)
SIGNALS = 3 * (len(cross_spectra.EDGES) - 1)
ROW = -1  # index among the inputs

Scores = Callable[[NDArray[np.intp], NDArray[np.intp]], Float32Array]
"""Log likelihood of each level of the bank at rows and columns of the planes, [row, column, level]."""
Nodes = tuple[NDArray[np.intp], NDArray[np.intp]]


class Evidence(NamedTuple):
    """Inputs per node, [h, w, input], and the levels that the scores are about."""

    inputs: Float32Array
    picture: Float32Array  # [NODE h, NODE w, channel] logarithms of green, infrared, red and blue
    levels: FloatArray
    score: Float32Array  # [h, w, level] of the windows alone: weighted sum of their scores, and a prior
    nodes: Nodes  # rows and columns of the nodes, samples of the planes


def level_grid(last: int) -> FloatArray:
    """Levels from 0 to ``LAST``, or to the bank's ``last`` where that is more; always as many, ``last`` among them."""
    steps = [0.0]
    while steps[-1] < LAST:
        steps.append(steps[-1] + max(FINEST, RELATIVE * steps[-1]))
    grid = np.array(steps) * (max(LAST, last) / steps[-1])
    grid[np.abs(grid - last).argmin()] = last
    return grid


def evidence(
    visible: Channel,
    infrared: Channel,
    guides: Sequence[Channel],
    leak: Leak,
    clipped: BoolArray,
    most_clipped: float,
    bands: Scores | None,
) -> Evidence:
    """Evidence of green and infrared.

    Red and blue would add information in theory; on the captures of the set ``tune`` they made the estimate worse.

    Args:
        visible: the visible channel, green.
        infrared: the infrared channel.
        guides: red and blue, for the picture alone.
        leak: infrared in the visible channel.
        clipped: samples that are clipped, [h, w].
        most_clipped: largest share of clipped samples in a window that counts.
        bands: score of :mod:`recon.depth.bands`; None for the large windows alone, which is three times as fast. The
            inputs are then the scores alone.
    """
    channels = (visible, infrared)
    shape = infrared.variance.shape
    nodes = cross_spectra.nodes(shape, NODE)
    last = len(infrared.kernels) - 1
    levels = level_grid(last)
    shares = [share_in_window(clipped, window.sigma_px) for window in WINDOWS]
    unusable = [share > most_clipped + SHARE_ROUNDING for share in shares]
    found = _spectra(channels, leak, WINDOWS if bands else WINDOWS[1:])
    scores = _window_scores(channels, leak, found, unusable, nodes, levels)
    of_bands = np.zeros_like(scores[0]) if bands is None else resampled(bands(*nodes), np.arange(last + 1), levels, 2)
    fits = _fits(scores, levels, last)
    of_bands[unusable[0][np.ix_(*nodes)]] = 0
    scores.append(of_bands)
    parts = []
    for score in scores:
        parts.append(-np.log1p(_below_best(score, levels, last) / SCORE_UNIT))
    total, alone = (_weighted(scores, weights, levels, last) for weights in (WEIGHTS, ALONE))
    picture = _picture([*channels, *guides])
    across, down = surfaces.step_probability(picture[:2, nodes[0][:, None], nodes[1]])
    joined = np.log(_joined(total, levels, across, down))
    parts.append(np.maximum(joined - joined.max(axis=-1, keepdims=True), LEAST_LOG))
    if bands:
        parts += [fits, _signal(found[WINDOWS[0]]), row_of_nodes(total.shape[:2])]
    inputs = np.concatenate(parts, axis=-1).astype(np.float32, copy=False)
    return Evidence(inputs, _whole(picture, nodes), levels, alone, nodes)


def _spectra(channels: tuple[Channel, Channel], leak: Leak, windows: Sequence[Window]) -> dict[Window, Spectra]:
    planes, variances = [channel.plane for channel in channels], [channel.variance for channel in channels]
    phases = [channel.phase for channel in channels]
    found = cross_spectra.measured(planes, phases, variances, [leak.alpha], windows)
    return dict(zip(windows, found, strict=True))


def _window_scores(
    channels: tuple[Channel, Channel],
    leak: Leak,
    found: Mapping[Window, Spectra],
    unusable: Sequence[BoolArray],
    nodes: Nodes,
    levels: FloatArray,
) -> list[Float32Array]:
    """Scores of each window size at the nodes, [row, column, level]; 0 for ``unusable`` windows and for window sizes
    without spectra.
    """
    visible, infrared = channels
    kernels = np.stack([kernels_without_infrared(visible, leak, infrared), infrared.kernels], axis=1).astype(np.float32)
    table = _between(cross_spectra.expected(kernels, [channel.phase for channel in channels]), levels)
    result = []
    for window, without in zip(WINDOWS, unusable, strict=True):
        if window not in found:
            result.append(np.zeros((len(nodes[0]), len(nodes[1]), len(levels)), np.float32))
            continue
        rows, columns = cross_spectra.nodes(infrared.variance.shape, window.step)
        score = log_likelihood(found[window], table)
        score[without[np.ix_(rows, columns)]] = 0
        result.append(resampled(resampled(score, rows, nodes[0], 0), columns, nodes[1], 1))
    return result


def _below_best(score: Float32Array, levels: FloatArray, last: float) -> Float32Array:
    """Difference between the largest score and each score, [h, w, level].

    Beyond the bank's ``last`` level, the score falls by ``FALL`` per level of the list, as in the network's training.
    """
    inside = int((levels <= last + 1e-6).sum())
    below = score[..., :inside].max(axis=-1, keepdims=True) - score
    steps = np.arange(1, len(levels) - inside + 1, dtype=np.float32)
    below[..., inside:] = below[..., inside - 1 : inside] + FALL * steps
    return below


def _fits(scores: Sequence[Float32Array], levels: FloatArray, last: float) -> Float32Array:
    """Largest of each score up to the bank's ``last`` level, compressed, [h, w, score]."""
    best = np.stack([score[..., levels <= last + 1e-6].max(axis=-1) for score in scores], axis=-1)
    return np.asarray(-np.log1p(np.maximum(-best, 0) / SCORE_UNIT), np.float32)


def _weighted(
    scores: Sequence[Float32Array], weights: Sequence[float], levels: FloatArray, last: float
) -> Float32Array:
    """Weighted sum of scores and of the logarithm of the prior, [h, w, level]."""
    total = sum(np.float32(weight) * score for weight, score in zip(weights, scores, strict=True))
    total = np.asarray(total - FAR * np.log(1 + levels / 2), np.float32)
    total[..., levels > last + 1e-6] = total.min(axis=-1, keepdims=True) - EXCLUDED
    return total


def _joined(score: Float32Array, levels: FloatArray, across: Float32Array, down: Float32Array) -> Float32Array:
    """Posterior on smooth surfaces, [h, w, level], computed on a finer grid, which is then merged."""
    count = len(levels)
    between = np.interp(np.arange(0, count - 0.5, 0.5), np.arange(count), levels)
    fine = surfaces.posterior(resampled(score, levels, between, 2), between, across, down)
    posterior = fine[..., ::2].copy()
    posterior[..., :-1] += fine[..., 1::2] / 2
    posterior[..., 1:] += fine[..., 1::2] / 2
    return posterior


def row_of_nodes(shape: Sequence[int]) -> Float32Array:
    """The input ``ROW`` of a picture of ``shape`` [h, w] nodes, [h, w, 1]."""
    height, width = shape
    return np.tile(np.linspace(-1, 1, height, dtype=np.float32)[:, None, None], (1, width, 1))


def _signal(spectra: Spectra) -> Float32Array:
    """Signal over noise of both channels (logarithm) and their coherence in each band, [h, w, 3 band]."""
    energy, noise = spectra.energy, np.maximum(spectra.noise, 1e-9)
    ratio = np.log1p(np.maximum(energy[..., [0, 2]] / noise[..., [0, 2]] - 1, 0))
    coherence = energy[..., 1] / np.sqrt(np.maximum(energy[..., 0] * energy[..., 2], 1e-12))
    return np.concatenate([ratio[..., 0], ratio[..., 1], coherence], axis=-1)


def log_channels(channels: Sequence[Channel], blur: float) -> Float32Array:
    """Logarithms of the channels, lifted above their noise, [channel, h, w]; ``blur`` is a sigma in samples."""
    parts = []
    for channel in channels:
        plane, variance = (
            cv2.GaussianBlur(np.ascontiguousarray(image, np.float32), (0, 0), blur)
            for image in (channel.plane, channel.variance)
        )
        noise = np.sqrt(variance)
        parts.append(np.log(np.maximum(plane, noise) + GUIDE_FLOOR * noise + np.float32(1e-6)))
    return np.stack(parts)


def _picture(channels: Sequence[Channel]) -> Float32Array:
    """:func:`log_channels`, relative to their surroundings."""
    sigma = SURROUNDINGS_PX / PLANE_SPACING_PX
    logs = log_channels(channels, GUIDE_BLUR)
    around = [cv2.GaussianBlur(log, (0, 0), sigma, borderType=cv2.BORDER_REFLECT) for log in logs]
    return np.asarray(logs - np.stack(around), np.float32)


def _whole(image: Float32Array, nodes: Nodes) -> Float32Array:
    """Samples around all nodes, [NODE row, NODE column, channel]; beyond the frame, its border is repeated."""
    _, height, width = image.shape
    rows, columns = len(nodes[0]), len(nodes[1])
    padded = np.pad(image, ((0, 0), (0, rows * NODE - height), (0, columns * NODE - width)), mode="edge")
    return np.ascontiguousarray(padded.transpose(1, 2, 0))


def share_in_window(mask: BoolArray, sigma_px: float) -> Float32Array:
    """Share of a mask of samples in the window around each of them, [h, w]."""
    sigma = sigma_px / PLANE_SPACING_PX
    return np.asarray(cv2.GaussianBlur(mask.astype(np.float32), (0, 0), sigma, borderType=cv2.BORDER_REFLECT))


def _between(table: FloatArray, levels: FloatArray) -> FloatArray:
    """Tables of fractional levels, linear between those of the bank, constant beyond its last."""
    low = np.clip(levels.astype(int), 0, len(table) - 2)
    share = np.clip(levels - low, 0, 1)[:, None, None, None]
    return np.asarray(table[low] * (1 - share) + table[low + 1] * share)


def on_samples(image: Float32Array, nodes: Nodes, shape: Sequence[int]) -> Float32Array:
    """An image of the nodes at all samples of the planes, [h, w]; samples beside an infinite one are infinite."""
    for axis in (0, 1):
        with np.errstate(invalid="ignore"):  # 0 times infinity
            image = resampled(image, nodes[axis], np.arange(shape[axis]), axis)
    return np.where(np.isnan(image), np.float32(np.inf), image)


def resampled(image: Float32Array, old: NDArray, new: NDArray, axis: int) -> Float32Array:
    """Linear interpolation along an axis from places ``old`` to ``new``; constant beyond the ends."""
    place = np.interp(new, old, np.arange(len(old)))
    low = np.minimum(place.astype(int), len(old) - 1)
    high = np.minimum(low + 1, len(old) - 1)
    share = (place - low).astype(np.float32).reshape([-1 if a == axis else 1 for a in range(image.ndim)])
    return np.asarray(np.take(image, low, axis) * (1 - share) + np.take(image, high, axis) * share, np.float32)
