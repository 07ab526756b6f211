"""The default depth estimate with one ingredient off, as methods: what does each of them add?

    dasim score CAPTURE --method examples/ablations.py:without_network best

docs/results/accuracy.md has figures of some of them, and of combinations.
"""

from __future__ import annotations

import dataclasses
from unittest import mock

import numpy as np

from dasim.typing import Float32Array, FloatArray
from dasim.values import Capture, DepthEstimate, PsfBank
from recon.depth import evidence, surface_net
from recon.depth.method import METHODS
from recon.depth.surface_net import Moments

SMALL, BANDS = 0, 2  # indices of scores in recon.depth.evidence
POSTERIOR = surface_net.posterior


def without_network(capture: Capture, bank: PsfBank) -> DepthEstimate:
    """Neighbours are joined on smooth surfaces alone."""

    def smooth(inputs: Float32Array, _picture: Float32Array, levels: FloatArray, last: float, _tile: int) -> Moments:
        return surface_net.smooth_posterior(inputs, levels, last)

    with mock.patch.object(surface_net, "posterior", smooth):
        return METHODS["best"](capture, bank)


def network_alone(capture: Capture, bank: PsfBank) -> DepthEstimate:
    """The network's posterior, not mixed with that of smooth surfaces, which it sees among its inputs."""
    with mock.patch.object(surface_net, "SURE_SD", 0.0):
        return METHODS["best"](capture, bank)


def one_network(capture: Capture, bank: PsfBank) -> DepthEstimate:
    """The first of the networks alone."""
    first = surface_net.networks()[:1]
    with mock.patch.object(surface_net, "networks", lambda: first):
        return METHODS["best"](capture, bank)


def without_row(capture: Capture, bank: PsfBank) -> DepthEstimate:
    """The network does not know how high in the picture a node is."""

    def anywhere(inputs: Float32Array, picture: Float32Array, levels: FloatArray, last: float, tile: int) -> Moments:
        inputs = inputs.copy()
        inputs[..., evidence.ROW] = 0
        return POSTERIOR(inputs, picture, levels, last, tile)

    with mock.patch.object(surface_net, "posterior", anywhere):
        return METHODS["best"](capture, bank)


def without_weighted_median(capture: Capture, bank: PsfBank) -> DepthEstimate:
    """The median of the posterior, whose steps are blurred."""
    return dataclasses.replace(METHODS["best"](capture, bank), align_steps=False)


def without_picture(capture: Capture, bank: PsfBank) -> DepthEstimate:
    """The network sees the scores of the windows alone."""

    def blind(inputs: Float32Array, picture: Float32Array, levels: FloatArray, last: float, tile: int) -> Moments:
        return POSTERIOR(inputs, np.zeros_like(picture), levels, last, tile)

    with mock.patch.object(surface_net, "posterior", blind):
        return METHODS["best"](capture, bank)


def without_small_windows(capture: Capture, bank: PsfBank) -> DepthEstimate:
    """No likelihood in windows of 10 px."""
    return _without(SMALL, capture, bank)


def without_bands(capture: Capture, bank: PsfBank) -> DepthEstimate:
    """No score of the preset ``bands``."""
    return _without(BANDS, capture, bank)


def _without(score: int, capture: Capture, bank: PsfBank) -> DepthEstimate:
    """The default without a score: neither in the sum that smooth surfaces join nor among the network's inputs."""

    def blind(inputs: Float32Array, picture: Float32Array, levels: FloatArray, last: float, tile: int) -> Moments:
        inputs = inputs.copy()
        inputs[..., score * len(levels) : (score + 1) * len(levels)] = 0
        return POSTERIOR(inputs, picture, levels, last, tile)

    weights = tuple(0.0 if index == score else weight for index, weight in enumerate(evidence.WEIGHTS))
    with mock.patch.object(evidence, "WEIGHTS", weights), mock.patch.object(surface_net, "posterior", blind):
        return METHODS["best"](capture, bank)
