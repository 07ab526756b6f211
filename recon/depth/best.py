"""The preset ``best``: level scores of windows, combined over surfaces by small networks.

Small windows resolve object boundaries, large ones work with weak texture. The score of :mod:`recon.depth.bands` does
not assume a natural texture spectrum and is better at large blur (:mod:`recon.depth.evidence`). Neighbouring windows
are combined before a level is chosen (:mod:`recon.depth.surface_net`); the level is a central value of the posterior.
Depth discontinuities are blurred until :mod:`recon.depth.steps` moves them to edges of the all-in-focus picture.

The kernels are those of one side of the focus; :mod:`recon.depth.side` chooses between the two sides.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from dasim.typing import Float32Array, FloatArray
from recon.depth import surface_net
from recon.depth.evidence import Evidence, on_samples

# A window is informative if its score varies by at least LEAST_RANGE over RANGE_LEVELS levels or more; windows of pure
# noise reach 2 at most. Over fewer levels scores vary less: with RANGE_POWER the threshold stays above the range of
# noise (0.2, 0.4, 0.9, 1.7 over 1, 2, 5, 12 levels) and below that of dim texture.
LEAST_RANGE, RANGE_LEVELS, RANGE_POWER = 16.0, 16, 1.5


class Map(NamedTuple):
    """Levels and their standard deviations at the planes' samples, [h, w]."""

    level: Float32Array
    sd: Float32Array  # infinite in a frame without texture
    window_level: Float32Array  # from the windows alone, before neighbours are joined
    window_sd: Float32Array  # infinite without texture


def estimate(
    evidence: Evidence, last: int, shape: Sequence[int], network: bool = True, tile: int = surface_net.TILE
) -> Map:
    """Levels of every sample of planes of a ``shape`` from the evidence; ``last`` is the bank's largest level.

    Without the ``network``, only the posterior on smooth surfaces combines neighbours; ``tile`` is the side of the
    network's tiles, nodes.
    """
    levels = evidence.levels
    window_level, window_sd = _moments(_normalised(evidence.score, levels), levels)
    least = LEAST_RANGE * min(1.0, last / RANGE_LEVELS) ** RANGE_POWER
    knows = np.ptp(evidence.score[..., levels <= last + 1e-6], axis=-1) >= least
    window_sd[~knows] = np.inf
    if network:
        found = surface_net.posterior(evidence.inputs, evidence.picture, levels, last, tile)
    else:
        found = surface_net.smooth_posterior(evidence.inputs, levels, last)
    level, sd = (image[: shape[0], : shape[1]] for image in found)  # the last nodes may reach beyond the frame
    if not knows.any():  # neighbours add no information if no window is informative
        sd = np.full_like(sd, np.inf)
    return Map(level, sd, *(on_samples(image, evidence.nodes, shape) for image in (window_level, window_sd)))


def _normalised(score: Float32Array, levels: FloatArray) -> Float32Array:
    """Probability of each level from a window alone."""
    weight = np.exp(score - score.max(axis=-1, keepdims=True)) * np.gradient(levels).astype(np.float32)
    return np.asarray(weight / weight.sum(axis=-1, keepdims=True))


def _moments(probability: Float32Array, levels: FloatArray) -> tuple[Float32Array, Float32Array]:
    """Mean and standard deviation of the level, [h, w]."""
    mean = probability @ levels.astype(np.float32)
    square = probability @ (levels**2).astype(np.float32)
    return mean, np.sqrt(np.maximum(square - mean**2, 0))
