"""Interpolation of the peak between the levels of the bank."""

import numpy as np

from recon.depth import peak
from recon.settings import PAPER


def test_parabola_finds_a_fractional_level():
    k = np.arange(29, dtype=np.float32)[:, None, None]
    score = np.broadcast_to(0.9 - 0.002 * (k - 11.3) ** 2, (29, 3, 3)).astype(np.float32)
    level, _ = peak.best_level(score, score.max(axis=0), np.zeros(29), PAPER.window_px)
    np.testing.assert_allclose(level, 11.3, atol=1e-2)


def test_of_two_levels_the_better_one_is_taken():
    score = np.array([[[0.2, 0.9]], [[0.7, 0.1]]], np.float32)
    level, confidence = peak.best_level(score, score.max(axis=0), np.zeros(2), PAPER.window_px)
    np.testing.assert_array_equal(level, [[1, 0]])
    assert np.isfinite(confidence).all()


def test_the_ends_of_a_bank_have_the_confidence_of_their_drop():
    """Set-up: scores that fall from the first level as from the last, of banks with two, three and five levels.

    Expectation: the end is taken with a confidence above 0, the same at both ends.
    """
    for levels in (2, 3, 5):
        fall = 0.95 * 0.5 ** np.arange(levels, dtype=np.float32)
        score = np.stack([fall, fall[::-1]], axis=-1)[:, None]
        level, confidence = peak.best_level(score, score.max(axis=0), np.zeros(levels), PAPER.window_px)
        np.testing.assert_array_equal(level, [[0, levels - 1]])
        assert confidence[0, 0] == confidence[0, 1] > 0.5, levels
