"""Kernels of a visible channel without the infrared that it also collects."""

from __future__ import annotations

import numpy as np

from recon.depth.channels import Channel, Leak, kernels_without_infrared


def channel(kernels):
    return Channel(np.zeros((2, 2)), (0, 0), np.ones((2, 2), np.float32), kernels)


def test_infrared_is_taken_out_of_a_visible_channel():
    """Set-up: alpha 0.4 and white with half as much infrared as green, so that a fifth of green's light is infrared.
    Expectation: the kernels of the remaining light, of sum 1.
    """
    visible, infrared = np.random.default_rng(0).random((2, 3, 5, 5))
    visible, infrared = (each / each.sum(axis=(1, 2), keepdims=True) for each in (visible, infrared))
    green = 0.8 * visible + 0.2 * infrared
    found = kernels_without_infrared(channel(green), Leak(alpha=0.4, white=0.5), channel(infrared))
    np.testing.assert_allclose(found, visible)
    np.testing.assert_allclose(found.sum(axis=(1, 2)), 1)
