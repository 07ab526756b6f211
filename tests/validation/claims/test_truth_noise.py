"""The gates of the claim truth-noise fail for a wrong variance, a percentile that is not heeded, and shared samples."""

from __future__ import annotations

import numpy as np
import pytest

from dasim.simulation import adaptive_sampling, rendering, rendering_noise
from validation.claims.light import truth_noise
from validation.claims.table import CLAIMS
from validation.gates.limits import GATES, judged_all, load_gates


def failed(figures) -> set[str]:
    entries = judged_all("truth-noise", figures, load_gates(GATES, CLAIMS))
    verdicts = {entry.id.removeprefix("truth-noise."): entry.passed for entry in entries}
    assert all(verdicts[figure.id] is not None for figure in figures)
    return {figure.id for figure in figures if not verdicts[figure.id]}


@pytest.fixture
def small(renderer, monkeypatch):
    """Desk at the size and with the seeds that a test affords."""
    monkeypatch.setattr(truth_noise, "SIZE_PX", (32, 24))
    return truth_noise._desk()


def scatter(stated: float, shares: float = 1.0) -> truth_noise.Scatter:
    """Noise of known variance in twelve pictures, and maps of 25 degrees of freedom that state ``stated`` times it."""
    random = np.random.default_rng(8)
    variance = np.exp(random.normal(size=(48, 64, 1))) * np.ones(4)
    measured = variance * random.chisquare(11, (48, 64, 4)) / 11
    maps = stated * variance * random.chisquare(25, (12, 48, 64, 4)) / 25
    boundary = np.arange(64) < 10
    found = truth_noise.Scatter(measured, maps, np.ones_like(measured), np.tile(boundary, (48, 1)), np.zeros((1, 3, 4)))
    return found._replace(shares=shares * truth_noise.measured_shares(found)[None])


@pytest.mark.parametrize(("stated", "shares"), [(1.0, 1.0), (0.8, 1.0), (1.25, 1.0), (1.0, 0.75)])
def test_a_wrong_variance_or_share_fails(stated, shares):
    """Expectation: a variance that is off by a quarter fails in all pixels and at boundaries; so does a share."""
    found = failed(truth_noise.map_figures("desk", scatter(stated, shares)))
    kinds = {name.rpartition(".")[2] for name in found}
    wrong = ({"all", "boundary"} if stated != 1 else set()) | (
        {"share-median", "share-p95", "share-p995"} if shares != 1 else set()
    )
    assert kinds == wrong and (not wrong or len(found) == 4 * len(wrong))


@pytest.mark.slow
@pytest.mark.parametrize("heeded", [True, False])
def test_auto_that_aims_at_the_median_fails_at_the_percentile(small, monkeypatch, heeded):
    """Set-up: a share that the pilot alone does not reach."""
    monkeypatch.setattr(truth_noise, "AUTO_SHARE", 0.25)
    if not heeded:
        true, wanted = rendering_noise.shares_at, adaptive_sampling.wanted_spp
        monkeypatch.setattr(adaptive_sampling, "shares_at", lambda ratio, percentiles: true(ratio, [30.0]))
        monkeypatch.setattr(adaptive_sampling, "wanted_spp", lambda *others: wanted(*others[:-1], 30.0))
    options = {"spp": "auto", "noise_share": truth_noise.AUTO_SHARE, "noise_at": 95.0}
    shots = [truth_noise._shot(*small, seed, **options) for seed in range(4)]
    assert bool(failed([truth_noise.auto_figure(95.0, truth_noise.scatter(shots))])) is not heeded


@pytest.mark.slow
@pytest.mark.parametrize("own", [True, False])
def test_an_independent_mean_of_the_same_samples_fails(small, monkeypatch, own):
    """Set-up: few samples, so that rendering noise is a multiple of the sensor's, and 24 pictures, with which the slope
    has a standard deviation of about 0.035 (0.06 with 8), a third of its limit.
    """
    monkeypatch.setattr(truth_noise, "SPP", 32)
    if not own:
        monkeypatch.setattr(rendering, "OWN_MEAN", rendering.LENS)
    means = np.stack([truth_noise._shot(*small, seed).truth.mean_e.astype(float) for seed in range(8)])
    few = {"spp": truth_noise.OWN_SPP, "independent_mean": True}
    shots = [truth_noise._shot(*small, seed, **few) for seed in range(8, 32)]
    figure = truth_noise.slope_figure("independent", shots, (means[:4].mean(axis=0), means[4:].mean(axis=0)))
    assert bool(failed([figure])) is not own
