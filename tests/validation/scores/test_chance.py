"""The test of two sets of pictures: its probability is even where nothing differs, and small where something does."""

from __future__ import annotations

import numpy as np
import pytest

from validation.scores import chance
from validation.scores.chance import by_chance

TRIALS, BLOCKS = 30, 40


def pictures(random, count, common, noise=1.0, shift=0.0):
    """Pictures [seed, block] whose blocks share a part ``common`` of their variance."""
    shared, own = random.normal(size=(count, 1)), random.normal(size=(count, BLOCKS))
    return noise * (np.sqrt(common) * shared + np.sqrt(1 - common) * own) + shift


@pytest.mark.parametrize("common", [0.0, 0.8])
def test_equal_means_are_rarely_called_different(common, monkeypatch):
    """Set-up: two sets of the same mean, the noise of one twice as large; independent and dependent blocks.

    Expectation: about a tenth of the probabilities below 0.1, within three standard errors of 30 trials; combining the
    p-values of dependent blocks as if they were independent gives half of them.
    """
    monkeypatch.setattr(chance, "PERMUTATIONS", 199)
    random = np.random.default_rng(0)
    found = [by_chance(pictures(random, 12, common), pictures(random, 12, common, 2.0)) for _ in range(TRIALS)]
    assert np.mean(np.less(found, 0.1)) < 0.1 + 3 * np.sqrt(0.09 / TRIALS)
    assert 0.35 < np.mean(found) < 0.65


def test_different_means_are_found():
    random = np.random.default_rng(0)
    assert by_chance(pictures(random, 12, 0.0), pictures(random, 12, 0.0, shift=0.8)) < 1e-3
