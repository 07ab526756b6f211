"""Levels of surfaces from the evidence of windows, by a small convolutional network.

A window knows little near the focus and mixes surfaces at steps. Across the picture, surfaces are smooth and end where
the picture has edges. The network has learned this from random rooms (:mod:`validation.training`), which no bundled and
no random scene of the simulator is part of. It needs numpy alone.

The hidden image h of C channels starts as a linear map of the inputs; block i adds

    h <- h + B_i relu(A_i * relu(h) + a_i) + b_i

with a 3 x 3 convolution A_i of dilation ``DILATIONS[i]``. Of relu(h), linear maps give the log probabilities of each
node's levels, to which a linear map of the scores is added, and 9 weights for each of the node's samples: a sample's
posterior is the mean of those of the 3 x 3 nodes around it by the softmax of these weights (convex upsampling, Teed and
Deng, ECCV 2020).
"""

from __future__ import annotations

from functools import cache
from importlib.resources import files
from typing import NamedTuple

import numpy as np

from dasim.typing import Float32Array, FloatArray
from recon.depth.evidence import NODE, SCORES

FILE = "surface_net.npz"
DILATIONS = (1, 2, 4, 8, 16, 1, 2, 4)
AROUND = 9  # nodes that a sample's posterior is a mean of
SHARE = 0.3  # of the network in the posterior of a node; the rest is that of smooth surfaces. Chosen on ``tune``


class Moments(NamedTuple):
    """Mean and standard deviation of the posterior of each sample, [h, w] levels."""

    level: Float32Array
    sd: Float32Array


@cache
def weights() -> dict[str, Float32Array]:
    """Arrays of the network by name; ``about`` of the file says what they were trained with."""
    with files("recon.depth").joinpath(FILE).open("rb") as file, np.load(file, allow_pickle=False) as stored:
        return {name: stored[name].astype(np.float32) for name in stored.files if name != "about"}


def posterior(inputs: Float32Array, levels: FloatArray, last: float) -> Moments:
    """Posterior of each sample of the planes; the last rows and columns of samples may lie outside of the frame.

    Args:
        inputs: evidence per node, [h, w, input].
        levels: values of the levels.
        last: largest level of the bank; larger ones get no probability.
    """
    scores = SCORES * len(levels)
    net = weights()
    hidden = _linear((inputs - net["mean"]) / net["sd"], net, "in")
    for index, dilation in enumerate(DILATIONS):
        inner = np.maximum(_convolved(np.maximum(hidden, 0), net, f"a{index}", dilation), 0)
        hidden += _linear(inner, net, f"b{index}")
    hidden = np.maximum(hidden, 0)
    logits = _linear(hidden, net, "level") + inputs[..., :scores] @ net["skip"]
    smooth = inputs[..., scores - len(levels) : scores].copy()
    for log in (logits, smooth):
        log[..., levels > last + 1e-6] = -np.inf
    probability = SHARE * _softmax(logits) + (1 - SHARE) * _softmax(smooth)
    grid = levels.astype(np.float32)
    moments = np.stack([probability @ grid, probability @ grid**2], axis=-1)
    level, square = np.moveaxis(_upsampled(moments, _linear(hidden, net, "mix")), -1, 0)
    return Moments(level, np.sqrt(np.maximum(square - level**2, 0)))


def _linear(image: Float32Array, net: dict[str, Float32Array], name: str) -> Float32Array:
    return np.asarray(image @ net[name] + net[f"{name}_bias"], np.float32)


def _convolved(image: Float32Array, net: dict[str, Float32Array], name: str, dilation: int) -> Float32Array:
    """A 3 x 3 convolution, [h, w, channel]; beyond the frame, its border is repeated."""
    height, width, _ = image.shape
    padded = np.pad(image, ((dilation, dilation), (dilation, dilation), (0, 0)), mode="edge")
    result = np.empty((height, width, net[name].shape[-1]), np.float32)
    result[:] = net[f"{name}_bias"]
    for row in range(3):
        for column in range(3):
            part = padded[row * dilation : row * dilation + height, column * dilation : column * dilation + width]
            result += part @ net[name][row, column]
    return result


def _softmax(logits: Float32Array) -> Float32Array:
    weight = np.exp(logits - logits.max(axis=-1, keepdims=True))
    return np.asarray(weight / weight.sum(axis=-1, keepdims=True))


def _upsampled(moments: Float32Array, mix: Float32Array) -> Float32Array:
    """Means over the 3 x 3 nodes around each sample by the weights ``mix`` [h, w, 9 NODE NODE]; [NODE h, NODE w, 2]."""
    height, width, _ = moments.shape
    share = mix.reshape(height, width, AROUND, NODE * NODE)
    share = np.exp(share - share.max(axis=2, keepdims=True))
    share /= share.sum(axis=2, keepdims=True)
    padded = np.pad(moments, ((1, 1), (1, 1), (0, 0)), mode="edge")
    total = np.zeros((height, width, NODE * NODE, moments.shape[-1]), np.float32)
    for index in range(AROUND):
        row, column = divmod(index, 3)
        part = padded[row : row + height, column : column + width]
        total += share[:, :, index, :, None] * part[:, :, None, :]
    blocks = total.reshape(height, width, NODE, NODE, -1).transpose(0, 2, 1, 3, 4)
    return blocks.reshape(height * NODE, width * NODE, -1)
