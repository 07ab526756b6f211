"""Levels of surfaces from the evidence of windows and the picture, by small convolutional networks.

A single window has little information near the focus and mixes surfaces at depth discontinuities. Across the picture,
surfaces are smooth and end at edges of the picture, and floors come nearer towards the bottom. The networks learned
this from random rooms and from random scenes of the simulator (:mod:`validation.training`); no test uses their seeds,
pictures or generated textures. They assume an upright camera and need no library for networks.

Each is a U-Net (Ronneberger, Fischer, Brox, MICCAI 2015) with three resolutions: samples of the planes, pairs of
samples, and nodes. The picture is convolved at the first two. At the nodes its features are added to a linear map of
the evidence, and block i updates the hidden image h:

    h <- h + B_i relu(A_i * relu(h) + a_i) + b_i

with a 3 x 3 convolution A_i of dilation ``DILATIONS[i]``. On the way back to the samples, the picture's features are
added again. Blocks of the same form at pairs of samples, before and after the nodes (``MIDDLE_DILATIONS``,
``BACK_DILATIONS``), relate outlines of the picture to those of surfaces. The log probabilities of a sample's levels are
those of the nodes, interpolated, plus a linear map of the sample's own features.

Networks trained from different initial weights make different errors where the evidence is weak, so the log
probabilities of ``FILES`` are averaged (an ensemble; Lakshminarayanan, Pritzel, Blundell, NeurIPS 2017, average
probabilities, which works equally well here). The median is mixed with the posterior that assumes smooth surfaces and
needs no training.
"""

from __future__ import annotations

from functools import cache
from typing import NamedTuple

import cv2
import numpy as np
from numba import njit, prange

from dasim.typing import Float32Array, FloatArray
from recon.convolution import Net, convolved, gathered, linear, load, refined, relu, residual, spread
from recon.depth.evidence import NODE, SCORES, resampled
from recon.depth.tiles import tiles

FILES = "surface_net_0.npz", "surface_net_1.npz"  # by the seed of the training
DILATIONS = (1, 2, 4, 8, 16, 1, 2, 4, 8, 1)  # of the blocks at nodes
MIDDLE_DILATIONS, BACK_DILATIONS = (1, 2), (2, 4)  # of those at pairs of samples, before and after the nodes
# Factor on the standard deviation of the posterior on smooth surfaces alone, which underestimates the correlation of
# neighbouring windows; chosen on ``tune``.
SMOOTH_SD = 2.5
# On smooth surfaces, levels, at which both posteriors have equal weight. On ``tune``, 0.55, 0.4, 0.3 and 0.2 give RMSE
# ratios of 0.386, 0.376, 0.372 and 0.370, but biases of 0.373, 0.376, 0.383 and 0.392 levels near the focus.
SURE_SD = 0.3
MIXED_SD = 0.6  # factor on the standard deviation on smooth surfaces in the mixture; chosen on ``tune``
STATED_SD = 0.9  # on that of the mixture, because probabilities count as spread between levels; chosen on ``tune``
TILE = 512  # nodes per side: frames of up to 4096 pixels per side are one tile
HALO = 55  # nodes around a tile: the sum of ``DILATIONS``, half that of the others, and what single layers see


class Moments(NamedTuple):
    """Mean or median of the posterior of each sample, and the standard deviation, [h, w] levels."""

    level: Float32Array
    sd: Float32Array


@cache
def networks() -> tuple[Net, ...]:
    """Arrays of each network by name; ``about`` of its file says what they were trained with."""
    return tuple(load("recon.depth", file) for file in FILES)


def posterior(
    inputs: Float32Array, picture: Float32Array, levels: FloatArray, last: float, tile: int = TILE, halo: int = HALO
) -> Moments:
    """Posterior of each sample of the planes; the last rows and columns of samples may lie outside of the frame.

    Large frames are processed in tiles, whose halo holds all that the network sees.

    Args:
        inputs: evidence per node, [h, w, input].
        picture: logarithms of the channels, [NODE h, NODE w, channel].
        levels: values of the levels.
        last: largest level of the bank; larger ones get no probability.
        tile: largest side of a tile, nodes.
        halo: around it, nodes.
    """
    result = Moments(*np.empty((2, *picture.shape[:2]), np.float32))
    for nodes in tiles(inputs.shape, tile, halo):
        samples = nodes.finer(NODE)
        found = _of_tile(inputs[nodes.box], picture[samples.box], levels, last)
        for image, of_tile in zip(result, found, strict=True):
            image[samples.core] = of_tile[samples.inner]
    return result


def _of_tile(inputs: Float32Array, picture: Float32Array, levels: FloatArray, last: float) -> Moments:
    """:func:`posterior` of a single tile."""
    first, *others = networks()
    logits = log_probabilities(first, inputs, picture, len(levels))
    for net in others:
        logits += log_probabilities(net, inputs, picture, len(levels))
    logits /= 1 + len(others)
    return _mixed(_median(logits, levels, last), smooth_posterior(inputs, levels, last))


def log_probabilities(net: Net, inputs: Float32Array, picture: Float32Array, levels: int) -> Float32Array:
    """Log probabilities of the levels by one network, [NODE h, NODE w, level], up to a constant per sample."""
    fine = convolved((picture - net["picture_mean"]) / net["picture_sd"], net, "fine")
    fine = convolved(relu(fine), net, "fine_in")
    middle = linear(gathered(relu(fine)), net, "middle")
    middle = convolved(relu(middle), net, "middle_in")
    for index, dilation in enumerate(MIDDLE_DILATIONS):
        middle = residual(middle, net, f"middle_a{index}", f"middle_b{index}", dilation)
    middle = relu(middle)
    hidden = linear((inputs - net["mean"]) / net["sd"], net, "in") + linear(gathered(middle), net, "picture_in")
    for index, dilation in enumerate(DILATIONS):
        hidden = residual(hidden, net, f"a{index}", f"b{index}", dilation)
    hidden = relu(hidden)
    nodes = linear(hidden, net, "level") + inputs[..., : SCORES * levels] @ net["skip"]
    middle += spread(linear(hidden, net, "middle_back"))
    middle = relu(middle)
    for index, dilation in enumerate(BACK_DILATIONS):
        middle = residual(middle, net, f"back_a{index}", f"back_b{index}", dilation)
    middle = refined(relu(middle), net, "middle_out")
    fine += spread(linear(middle, net, "fine_back"))
    fine = refined(relu(fine), net, "fine_out")
    logits = linear(fine, net, "sample")
    logits += cv2.resize(nodes, logits.shape[1::-1], interpolation=cv2.INTER_LINEAR)
    return logits


def _mixed(network: Moments, smooth: Moments) -> Moments:
    """Mixture of both posteriors: smooth surfaces where evidence decides, elsewhere what the network has learned.

    The network's share is s^2 / (s^2 + SURE_SD^2), with the standard deviation s on smooth surfaces.
    """
    share = smooth.sd**2 / (smooth.sd**2 + SURE_SD**2)
    level = share * network.level + (1 - share) * smooth.level
    squares = [sd**2 + of.level**2 for of, sd in ((network, network.sd), (smooth, MIXED_SD * smooth.sd))]
    square = share * squares[0] + (1 - share) * squares[1]
    sd = STATED_SD * np.sqrt(np.maximum(square - level**2, 0))
    return Moments(*(np.asarray(image, np.float32) for image in (level, sd)))


def smooth_posterior(inputs: Float32Array, levels: FloatArray, last: float) -> Moments:
    """Posterior of each sample on smooth surfaces alone, as :func:`posterior` without the network."""
    logits = inputs[..., (SCORES - 1) * len(levels) : SCORES * len(levels)].copy()
    powers = _powers(logits, levels, last)
    for axis in (0, 1):  # a window's centre is a sample, see cross_spectra.nodes
        samples = np.arange(NODE * inputs.shape[axis])
        powers = resampled(powers, samples[NODE // 2 :: NODE], samples, axis)
    level, sd = _moments(powers)
    return Moments(level, SMOOTH_SD * sd)


def _moments(powers: Float32Array) -> Moments:
    level, square = np.moveaxis(powers, -1, 0)
    return Moments(*(np.asarray(image, np.float32) for image in (level, np.sqrt(np.maximum(square - level**2, 0)))))


def _median(logits: Float32Array, levels: FloatArray, last: float) -> Moments:
    """Median of the level and rms distance from it, [h, w] each, from log probabilities [h, w, level].

    Where a sample may belong to either of two surfaces, the mean would lie between them.
    """
    used = int(np.searchsorted(levels, last + 1e-6, side="right"))
    edges = np.concatenate([levels[:1], (levels[1:used] + levels[: used - 1]) / 2, levels[used - 1 : used]])
    level, sd = np.empty((2, *logits.shape[:2]), np.float32)
    _medians(logits, levels.astype(np.float32), edges.astype(np.float32), level, sd)
    return Moments(level, sd)


@njit(cache=True, parallel=True)
def _medians(  # pragma: no cover - compiled
    logits: Float32Array, levels: Float32Array, edges: Float32Array, median: Float32Array, sd: Float32Array
) -> None:
    """:func:`_median`; a level's probability is spread evenly between its two ``edges``."""
    height, width, _ = logits.shape
    used = len(edges) - 1
    for y in prange(height):
        probability = np.empty(used, np.float32)
        for x in range(width):
            top = logits[y, x, :used].max()
            total = np.float32(0)
            for k in range(used):
                probability[k] = np.exp(logits[y, x, k] - top)
                total += probability[k]
            below, k = np.float32(0), 0
            while k < used - 1 and below + probability[k] < total / 2:
                below += probability[k]
                k += 1
            share = min(max((total / 2 - below) / probability[k], np.float32(0)), np.float32(1))
            middle = edges[k] + share * (edges[k + 1] - edges[k])
            square = np.float32(0)
            for k in range(used):
                square += probability[k] * (levels[k] - middle) ** 2
            median[y, x], sd[y, x] = middle, np.sqrt(square / total)


def _powers(logits: Float32Array, levels: FloatArray, last: float) -> Float32Array:
    """Mean level and mean square of it, [h, w, 2], from log probabilities [h, w, level], which are overwritten."""
    logits[..., levels > last + 1e-6] = -np.inf
    logits -= logits.max(axis=-1, keepdims=True)
    probability = np.exp(logits, out=logits).reshape(-1, len(levels))
    powers = np.stack([levels**0, levels, levels**2], axis=-1).astype(np.float32)
    found = (probability @ powers).reshape(*logits.shape[:2], 3)
    return found[..., 1:] / found[..., :1]
