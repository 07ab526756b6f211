"""The network in numpy: its convolution and mean over nodes against direct sums, and what it must not break."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import ndimage

from recon.depth import evidence, surface_net

LEVELS = evidence.level_grid(28)
INPUTS = evidence.SCORES * len(LEVELS) + evidence.SIGNALS + evidence.BLOCK


def inputs_at(level, shape=(12, 16)):
    """Evidence whose scores and posterior all stand for one level."""
    below = np.abs(LEVELS - level) * 30
    score = -np.log1p(below / evidence.SCORE_UNIT)
    rest = np.tile(surface_net.weights()["mean"][evidence.SCORES * len(LEVELS) :], (*shape, 1))
    scores = np.concatenate([*[score] * (evidence.SCORES - 1), np.maximum(-below, evidence.LEAST_LOG)])
    return np.concatenate([np.tile(scores, (*shape, 1)), rest], axis=-1).astype(np.float32)


def posterior(inputs, last=28):
    return surface_net.posterior(inputs, LEVELS, last)


@pytest.mark.parametrize("dilation", [1, 3])
def test_a_dilated_convolution_repeats_the_border(dilation):
    random = np.random.default_rng(0)
    image, kernel = random.normal(size=(9, 11, 2)), random.normal(size=(3, 3, 2, 4))
    net = {"a": kernel.astype(np.float32), "a_bias": np.arange(4, dtype=np.float32)}
    found = surface_net._convolved(image.astype(np.float32), net, "a", dilation)
    spread = np.zeros((2 * dilation + 1, 2 * dilation + 1, 2, 4))
    spread[::dilation, ::dilation] = kernel
    for out in range(4):
        expected = out + sum(
            ndimage.correlate(image[..., part], spread[..., part, out], mode="nearest") for part in range(2)
        )
        np.testing.assert_allclose(found[..., out], expected, atol=1e-4)


def test_a_sample_is_a_mean_of_the_nodes_around_it():
    """Set-up: all weight on one of the nine nodes. Expectation: the image of the nodes, shifted by one, in blocks."""
    moments = np.random.default_rng(1).normal(size=(5, 6, 2)).astype(np.float32)
    mix = np.full((5, 6, surface_net.AROUND, evidence.NODE**2), -50.0, np.float32)
    mix[:, :, 5] = 50  # row in the middle, column to the right
    found = surface_net._upsampled(moments, mix.reshape(5, 6, -1))
    shifted = moments[:, [1, 2, 3, 4, 5, 5]]
    np.testing.assert_allclose(found, shifted.repeat(evidence.NODE, 0).repeat(evidence.NODE, 1), atol=1e-5)


def test_the_weights_state_their_source():
    from importlib.resources import files

    with np.load(files("recon.depth").joinpath(surface_net.FILE), allow_pickle=False) as stored:
        assert "Own data of the project" in str(stored["about"])
    assert surface_net.weights()["in"].shape[0] == INPUTS
    assert surface_net.weights()["level"].shape[1] == len(LEVELS)


def test_evidence_of_a_larger_level_gives_a_larger_level():
    """Set-up: all scores stand for one level, whatever the picture shows."""
    found = [float(np.median(posterior(inputs_at(level)).level)) for level in (0.5, 3.0, 10.0, 20.0)]
    assert (np.diff(found) > 0.5).all()


def test_levels_beyond_the_bank_get_no_probability():
    found = posterior(inputs_at(20.0), last=8)
    assert found.level.max() <= 8


def test_evidence_that_says_nothing_is_uncertain():
    nothing = inputs_at(5.0)
    nothing[..., : evidence.SCORES * len(LEVELS)] = 0
    assert posterior(nothing).sd.min() > 2 * posterior(inputs_at(5.0)).sd.max()
