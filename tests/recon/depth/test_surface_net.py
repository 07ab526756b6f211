"""The network of levels in numpy: evidence that it follows, and levels that it must not give."""

from __future__ import annotations

import numpy as np
import pytest

from recon.depth import evidence, surface_net

LEVELS = evidence.level_grid(28)
ROUNDING_LEVELS = 0.005  # of products in single precision through twenty layers
INPUTS = evidence.SCORES * len(LEVELS) + evidence.FITS + evidence.SIGNALS + 1


def inputs_at(level, shape=(12, 16)):
    """Evidence whose scores and posterior all stand for one level."""
    below = np.abs(LEVELS - level) * 30
    below -= below.min()  # scores are relative to the best of them, as those of the evidence
    score = -np.log1p(below / evidence.SCORE_UNIT)
    rest = np.tile(surface_net.networks()[0]["mean"][evidence.SCORES * len(LEVELS) :], (*shape, 1))
    scores = np.concatenate([*[score] * (evidence.SCORES - 1), np.maximum(-below, evidence.LEAST_LOG)])
    return np.concatenate([np.tile(scores, (*shape, 1)), rest], axis=-1).astype(np.float32)


def posterior(inputs, last=28):
    net, (height, width, _) = surface_net.networks()[0], inputs.shape
    picture = np.tile(net["picture_mean"], (evidence.NODE * height, evidence.NODE * width, 1))
    return surface_net.posterior(inputs, picture, LEVELS, last)


def test_the_weights_state_their_source():
    from importlib.resources import files

    for file, net in zip(surface_net.FILES, surface_net.networks(), strict=True):
        with np.load(files("recon.depth").joinpath(file), allow_pickle=False) as stored:
            assert "Own data of the project" in str(stored["about"])
        assert net["in"].shape[0] == INPUTS
        assert net["sample"].shape[1] == len(LEVELS)


def test_networks_have_one_vote_each(monkeypatch):
    """Set-up: two networks that are sure of the fifth and of the tenth level, one surer; and both exchanged.

    Expectation: log probabilities are added, so that the surer one decides, whatever the order.
    """
    first, second = (np.full((8, 8, len(LEVELS)), -9.0, np.float32) for _ in range(2))
    first[..., 4], second[..., 9] = 9.0, 0.0
    inputs, picture = inputs_at(0.0, (2, 2)), np.zeros((8, 8, 4), np.float32)
    monkeypatch.setattr(surface_net, "SURE_SD", 0.0)
    monkeypatch.setattr(surface_net, "networks", lambda: ("one", "other"))
    for given in ({"one": first, "other": second}, {"one": second, "other": first}):
        monkeypatch.setattr(surface_net, "log_probabilities", lambda net, *_, given=given: given[net].copy())
        found = surface_net.posterior(inputs, picture, LEVELS, 28).level
        np.testing.assert_allclose(found, LEVELS[4], atol=0.1)


def test_evidence_of_a_larger_level_gives_a_larger_level():
    """Set-up: all scores stand for one level, whatever the picture shows."""
    found = [float(np.median(posterior(inputs_at(level)).level)) for level in (0.5, 3.0, 10.0, 20.0)]
    assert (np.diff(found) > 0.5).all()


def test_smooth_surfaces_have_the_level_of_a_window_at_its_centre():
    """Set-up: windows on a ramp, each with the level of its centre, the sample in the middle of four."""
    levels = np.linspace(4, 16, 13)
    inputs = np.concatenate([inputs_at(level, (6, 1)) for level in levels], axis=1)
    found = surface_net.smooth_posterior(inputs, LEVELS, 28).level
    centres = np.arange(evidence.NODE // 2, found.shape[1], evidence.NODE)
    alone = [surface_net.smooth_posterior(inputs_at(level, (1, 1)), LEVELS, 28).level[0, 0] for level in levels]
    np.testing.assert_allclose(found[:, centres], np.broadcast_to(alone, (len(found), len(levels))), rtol=1e-5)
    between = (found[:, centres[:-1]] + found[:, centres[1:]]) / 2
    np.testing.assert_allclose(found[:, centres[:-1] + evidence.NODE // 2], between, rtol=1e-5)


def test_levels_beyond_the_bank_get_no_probability():
    found = posterior(inputs_at(20.0), last=8)
    assert found.level.max() <= 8


def test_evidence_on_smooth_surfaces_prevails_where_it_decides():
    """Set-up: levels 2 by the network and 6 on smooth surfaces, of which these are unsure, as sure, and sure.

    Expectation: by hand, of a mixture of two distributions.
    """
    sd = surface_net.SURE_SD * np.array([30.0, 1.0, 1 / 30])
    network, smooth = surface_net.Moments(np.full(3, 2.0), np.full(3, 0.5)), surface_net.Moments(np.full(3, 6.0), sd)
    found = surface_net._mixed(network, smooth)
    assert found.level == pytest.approx([2, 4, 6], abs=0.01)
    variance = (0.5**2 + (surface_net.MIXED_SD * sd[1]) ** 2) / 2 + 2**2
    assert found.sd[1] == pytest.approx(surface_net.STATED_SD * np.sqrt(variance))


def test_a_level_is_the_median_of_the_probability_between_listed_levels():
    """Expectation: the cumulative probability, linear between the middles of listed levels, is one half there; of two
    surfaces the likelier one's level, not one between them; levels beyond the bank have no part.
    """
    random, last = np.random.default_rng(1), 12.0
    logits = random.normal(0, 2, (3, 4, len(LEVELS))).astype(np.float32)
    logits[0, 0] = np.where(np.isin(np.arange(len(LEVELS)), (2, 12)), 20, 0) - 2 * (np.arange(len(LEVELS)) == 12)
    found = surface_net._median(logits, LEVELS, last)
    used = LEVELS <= last
    probability = np.exp(logits[..., used].astype(float))
    probability /= probability.sum(axis=-1, keepdims=True)
    kept = LEVELS[used]
    edges = np.concatenate([kept[:1], (kept[1:] + kept[:-1]) / 2, kept[-1:]])
    for place in np.ndindex(3, 4):
        cumulative = np.append(0.0, np.cumsum(probability[place]))
        median = np.interp(0.5, cumulative, edges)
        np.testing.assert_allclose(found.level[place], median, atol=1e-4)
        rms = np.sqrt((probability[place] * (kept - median) ** 2).sum())
        np.testing.assert_allclose(found.sd[place], rms, rtol=1e-3)
    assert abs(found.level[0, 0] - kept[2]) < 0.5


def test_large_frames_in_tiles_have_the_levels_of_the_whole():
    """Set-up: inputs at random, which change from node to node more than any evidence does.

    Expectation: the halo holds all that the network sees, so that single precision alone tells tiles from the whole.
    """
    random = np.random.default_rng(0)
    net, (height, width) = surface_net.networks()[0], (5, 131)
    inputs = (net["mean"] + net["sd"] * random.normal(size=(height, width, INPUTS))).astype(np.float32)
    shape = evidence.NODE * height, evidence.NODE * width, 4
    picture = (net["picture_mean"] + net["picture_sd"] * random.normal(size=shape)).astype(np.float32)
    whole = surface_net.posterior(inputs, picture, LEVELS, 28)
    parts = surface_net.posterior(inputs, picture, LEVELS, 28, 20)
    assert whole.level.std() > 0.5
    np.testing.assert_allclose(parts.level, whole.level, atol=ROUNDING_LEVELS)
    np.testing.assert_allclose(parts.sd, whole.sd, atol=ROUNDING_LEVELS)
    cut = surface_net.posterior(inputs, picture, LEVELS, 28, 20, surface_net.HALO // 2)
    assert np.abs(cut.level - whole.level).max() > 2 * np.abs(parts.level - whole.level).max()
