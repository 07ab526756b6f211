"""The network in numpy: its convolution against direct sums, its changes of resolution, and what it must not break."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import ndimage

from recon.depth import evidence, surface_net

LEVELS = evidence.level_grid(28)
INPUTS = evidence.SCORES * len(LEVELS) + evidence.SIGNALS


def inputs_at(level, shape=(12, 16)):
    """Evidence whose scores and posterior all stand for one level."""
    below = np.abs(LEVELS - level) * 30
    score = -np.log1p(below / evidence.SCORE_UNIT)
    rest = np.tile(surface_net.weights()["mean"][evidence.SCORES * len(LEVELS) :], (*shape, 1))
    scores = np.concatenate([*[score] * (evidence.SCORES - 1), np.maximum(-below, evidence.LEAST_LOG)])
    return np.concatenate([np.tile(scores, (*shape, 1)), rest], axis=-1).astype(np.float32)


def posterior(inputs, last=28):
    net, (height, width, _) = surface_net.weights(), inputs.shape
    picture = np.tile(net["picture_mean"], (evidence.NODE * height, evidence.NODE * width, 1))
    return surface_net.posterior(inputs, picture, LEVELS, last)


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


def test_strips_of_a_convolution_meet_without_a_seam(monkeypatch):
    """Expectation: strips of one row give the same as the whole image."""
    random = np.random.default_rng(1)
    image = random.normal(size=(7, 6, 2)).astype(np.float32)
    net = {"a": random.normal(size=(3, 3, 2, 3)).astype(np.float32), "a_bias": np.zeros(3, np.float32)}
    whole = surface_net._convolved(image, net, "a", 2)
    monkeypatch.setattr(surface_net, "STRIP", 1)
    np.testing.assert_allclose(surface_net._convolved(image, net, "a", 2), whole, atol=1e-6)


def test_spreading_undoes_gathering():
    image = np.random.default_rng(2).normal(size=(6, 4, 3)).astype(np.float32)
    gathered = surface_net._gathered(image)
    assert gathered.shape == (3, 2, 12)
    np.testing.assert_array_equal(np.sort(gathered[1, 1]), np.sort(image[2:4, 2:4].ravel()))
    np.testing.assert_array_equal(surface_net._spread(gathered), image)


def test_the_weights_state_their_source():
    from importlib.resources import files

    with np.load(files("recon.depth").joinpath(surface_net.FILE), allow_pickle=False) as stored:
        assert "Own data of the project" in str(stored["about"])
    assert surface_net.weights()["in"].shape[0] == INPUTS
    assert surface_net.weights()["sample"].shape[1] == len(LEVELS)


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
