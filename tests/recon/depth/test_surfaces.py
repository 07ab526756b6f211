"""Messages between neighbours: exact on a row, and steps where the picture has edges."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from recon.depth import surfaces
from recon.depth.evidence import level_grid

LEVELS = np.array([0.0, 0.5, 1.0, 2.0])


def test_the_posterior_of_a_row_is_the_sum_over_all_its_levels():
    """Expectation: on a row, which has no loops, belief propagation is exact: sums over all 4^5 combinations."""
    random = np.random.default_rng(3)
    score = random.normal(0, 20, (1, 5, 4)).astype(np.float32)
    step = random.uniform(0.05, 0.4, (1, 5)).astype(np.float32)
    found = surfaces.posterior(score, LEVELS, step, step)[0]
    width = np.gradient(LEVELS)
    law = np.exp(-np.abs(LEVELS[:, None] - LEVELS) / (surfaces.SCALE + surfaces.SCALE_SHARE * LEVELS[:, None]))
    law /= (law * width).sum(axis=1, keepdims=True)
    expected = np.zeros((5, 4))
    # A message goes from a sample to its neighbour, so that the law of the pair depends on the direction: the exact sum
    # for one sample takes each pair in the direction towards it. Each sample's levels are summed once, by their widths.
    for target in range(5):
        for state in itertools.product(range(4), repeat=5):
            weight = np.prod([np.exp(surfaces.TEMPER * score[0, place, level]) for place, level in enumerate(state)])
            weight *= np.prod(width[list(state)])
            for left in range(4):
                source, to = (left, left + 1) if left < target else (left + 1, left)
                e = step[0, left]
                weight *= (1 - e) * law[state[source], state[to]] + e / width.sum()
            expected[target, state[target]] += weight
    np.testing.assert_allclose(found, expected / expected.sum(axis=1, keepdims=True), atol=2e-4)


def test_a_gap_is_filled_from_its_neighbours_and_is_less_certain():
    """Set-up: level 1 is known around a square without information. Expectation: level 1 inside, spread wider."""
    score = np.full((21, 21, 4), -200.0, np.float32)
    score[..., 2] = 0
    score[7:14, 7:14] = 0
    even = np.full((21, 21), 0.02, np.float32)
    found = surfaces.posterior(score, LEVELS, even, even)
    mean = found @ LEVELS
    sd = np.sqrt(np.maximum(found @ LEVELS**2 - mean**2, 1e-6))
    assert mean[10, 10] == pytest.approx(1.0, abs=0.25)
    assert sd[10, 10] > 5 * sd[2, 2]


def test_a_step_is_likelier_at_an_edge_of_the_picture():
    guide = np.zeros((2, 4, 6), np.float32)
    guide[:, :, 3:] = 1.0
    across, down = surfaces.step_probability(guide)
    assert across[0, 2] == pytest.approx(surfaces.EDGE_STEP, rel=0.01)
    np.testing.assert_allclose(np.delete(across, 2, axis=1), surfaces.PLAIN_STEP, rtol=1e-5)
    np.testing.assert_allclose(down, surfaces.PLAIN_STEP, rtol=1e-5)


def test_it_does_not_matter_how_finely_levels_are_listed():
    """Set-up: no evidence but a slight preference for level 0, with levels at even distances, and with distances that
    grow with the level, as those of the evidence do. Expectation: the same mean level. Were the distances counted in
    every message, the second list would end near its last level.
    """
    even, growing = np.arange(0, 28.1, 0.5), level_grid(28)
    step = np.full((12, 16), surfaces.PLAIN_STEP, np.float32)
    means = []
    for levels in (even, growing):
        score = np.broadcast_to(-0.02 * levels, (12, 16, len(levels))).astype(np.float32)
        means.append((surfaces.posterior(score, levels, step, step) @ levels)[6, 8])
    assert means[0] < 3
    assert means[1] == pytest.approx(means[0], abs=0.5)
