"""Patterns of the training: periodic, physical, and not the same in infrared."""

from __future__ import annotations

import numpy as np

from validation.training import patterns


def drawn(count=24):
    return [patterns.pattern(np.random.default_rng(seed), patterns.PLAIN) for seed in range(count)]


def test_patterns_are_reflectances_of_four_channels():
    for tile in drawn():
        assert tile.shape == (4, patterns.SIDE, patterns.SIDE)
        assert tile.min() >= np.float32(patterns.LEAST_REFLECTANCE)
        assert tile.mean() < 2


def test_infrared_follows_green_in_some_patterns_and_not_in_others():
    correlation = [abs(np.corrcoef(tile[1].ravel(), tile[3].ravel())[0, 1]) for tile in drawn()]
    assert max(correlation) > 0.9
    assert min(correlation) < 0.3


def test_every_kind_has_a_share_and_unit_deviation():
    for look in (patterns.PLAIN, patterns.TEXTURED):
        assert all(np.isclose(sum(shares), 1) for shares in (look.shares, look.follows, look.strengths))
        assert len(look.shares) == len(patterns.KINDS)
    for kind in patterns.KINDS:
        image = kind(np.random.default_rng(5), patterns.TEXTURED)
        assert abs(float(image.mean())) < 1e-3
        assert float(image.std()) <= 1.001
