"""Interpolation of the peak between the levels of the bank."""

import numpy as np

from recon.depth import peak
from recon.settings import PAPER


def test_parabola_finds_a_fractional_level():
    k = np.arange(29, dtype=np.float32)[:, None, None]
    score = np.broadcast_to(0.9 - 0.002 * (k - 11.3) ** 2, (29, 3, 3)).astype(np.float32)
    level, _ = peak.best_level(score, score.max(axis=0), np.zeros(29), PAPER.window_px)
    np.testing.assert_allclose(level, 11.3, atol=1e-2)
