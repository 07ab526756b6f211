"""Posterior of the levels on piecewise smooth surfaces, by belief propagation (sum-product).

Neighbouring samples have nearly equal levels, or a depth discontinuity ("step") lies between them, which is more likely
at an edge of the picture. A sample with the belief h sends its neighbour the message

    m(l) = (1 - e) sum over l' of K(l' - l) h(l') w(l') + e / R,

with the Laplace density K over levels and the width w of a level, the spacing of its neighbours in the list. The
belief has sum 1 with these weights. A step has the probability e, and after it all levels in the range R are equally
likely. Messages run along rows and columns in both directions, twice (belief propagation, Pearl 1988; on a grid with
loops: Felzenszwalb and Huttenlocher, IJCV 70, 2006). The posterior of a sample is the product of its likelihood, the
width, and all messages. Messages are densities, so the width enters only once, in sums over levels; otherwise levels
listed with larger spacing would be preferred.
"""

from __future__ import annotations

import numpy as np
from numba import njit, prange

from dasim.typing import Float32Array, FloatArray

TEMPER = 0.07  # of the likelihood: the windows of neighbours overlap
SCALE, SCALE_SHARE = 0.4, 0.025  # of the Laplace law between neighbours: levels, and share of the level
PLAIN_STEP, EDGE_STEP = 0.03, 0.15  # probability of a step without and with an edge in the picture
EDGE = 0.25  # contrast of an edge, in the logarithm
ROUNDS = 2
FLOOR = 1e-6  # of a message, relative to its largest value
SMALLEST = 1e-30  # of a likelihood, relative to its largest value
LEAST_BELIEF = 1e-5  # that is passed on


def posterior(score: Float32Array, levels: FloatArray, across: Float32Array, down: Float32Array) -> Float32Array:
    """Probability of each level, [h, w, level].

    Args:
        score: log likelihood, [h, w, level].
        levels: their values, [level].
        across: probability of a step to the right neighbour, [h, w].
        down: to the one below.
    """
    width = np.gradient(levels)
    scale = SCALE + SCALE_SHARE * levels[:, None]
    kernel = np.exp(-np.abs(levels[:, None] - levels) / scale)
    kernel /= (kernel * width).sum(axis=1, keepdims=True)
    belief = np.exp(TEMPER * (score - score.max(axis=-1, keepdims=True))) + np.float32(SMALLEST)
    belief *= width.astype(np.float32)
    messages = np.ones((4, *score.shape), np.float32)
    anywhere = np.float32(1 / width.sum())
    for _ in range(ROUNDS):
        _exchange(belief, messages, kernel.astype(np.float32), anywhere, across, down)
    for message in messages:
        belief *= message
    return np.asarray(belief / belief.sum(axis=-1, keepdims=True), np.float32)


def step_probability(guide: Float32Array) -> tuple[Float32Array, Float32Array]:
    """Probability of a step in depth to the right neighbour and to the one below, [h, w] each.

    ``guide`` [channel, h, w] are logarithms of the picture's channels.
    """
    both = []
    for axis in (2, 1):
        contrast = np.sqrt((np.diff(guide, axis=axis, append=np.take(guide, [-1], axis=axis)) ** 2).sum(axis=0))
        edge = 1 - np.exp(-((contrast / EDGE) ** 2))
        both.append((PLAIN_STEP + (EDGE_STEP - PLAIN_STEP) * edge).astype(np.float32))
    return both[0], both[1]


@njit(fastmath=True, cache=True, parallel=True)
def _exchange(  # pragma: no cover - compiled
    likelihood: Float32Array,
    messages: Float32Array,
    kernel: Float32Array,
    anywhere: np.float32,
    across: Float32Array,
    down: Float32Array,
) -> None:
    """One round of messages [direction, h, w, level], to the right, to the left, down and up."""
    height, width, levels = likelihood.shape
    for y in prange(height):
        belief, out = np.empty(levels, np.float32), np.empty(levels, np.float32)
        for x in range(width - 1):
            belief[:] = likelihood[y, x] * messages[0, y, x] * messages[2, y, x] * messages[3, y, x]
            _send(belief, kernel, anywhere, across[y, x], out, messages[0, y, x + 1])
        for x in range(width - 1, 0, -1):
            belief[:] = likelihood[y, x] * messages[1, y, x] * messages[2, y, x] * messages[3, y, x]
            _send(belief, kernel, anywhere, across[y, x - 1], out, messages[1, y, x - 1])
    for x in prange(width):
        belief, out = np.empty(levels, np.float32), np.empty(levels, np.float32)
        for y in range(height - 1):
            belief[:] = likelihood[y, x] * messages[0, y, x] * messages[1, y, x] * messages[2, y, x]
            _send(belief, kernel, anywhere, down[y, x], out, messages[2, y + 1, x])
        for y in range(height - 1, 0, -1):
            belief[:] = likelihood[y, x] * messages[0, y, x] * messages[1, y, x] * messages[3, y, x]
            _send(belief, kernel, anywhere, down[y - 1, x], out, messages[3, y - 1, x])


@njit(fastmath=True, cache=True)
def _send(  # pragma: no cover - compiled
    belief: Float32Array,
    kernel: Float32Array,
    anywhere: np.float32,
    step: float,
    out: Float32Array,
    message: Float32Array,
) -> None:
    """Write the message of a belief to a neighbour; its largest value is 1, about."""
    total = belief.sum()
    out[:] = 0
    for level in range(len(belief)):
        share = belief[level] / total
        if share > LEAST_BELIEF:
            out += share * kernel[level]
    out[:] = (1 - step) * out + step * anywhere
    message[:] = out / out.max() + np.float32(FLOOR)
