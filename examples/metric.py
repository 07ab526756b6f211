"""Metrics of one's own, for ``dasim score`` and ``validation.score``.

A metric is a function of the estimated depth and the truth. It returns a number, or a dictionary of named numbers.

    dasim score RECON CAPTURE --metric examples/metric.py:ordinal --metric examples/metric.py:within_a_centimetre
"""

import numpy as np

from dasim.values import Truth

PAIRS = 20_000
FARTHER = 1.1  # ratio of depths from which on a pair has an order


def within_a_centimetre(depth_m: np.ndarray, truth: Truth) -> float:
    """Share of the pixels whose depth is within 1 cm of the truth; a pixel without an estimate is not."""
    return float(np.mean(np.abs(depth_m - truth.depth_m)[truth.valid] < 0.01))


def ordinal(depth_m: np.ndarray, truth: Truth) -> dict[str, float]:
    """Share of random pairs of pixels in the right order, and the share of pairs that have an order to be judged."""
    places = np.flatnonzero(truth.valid & np.isfinite(depth_m))
    first, second = np.random.default_rng(0).choice(places, (2, PAIRS))
    true, estimated = (np.log(image.ravel()[second] / image.ravel()[first]) for image in (truth.depth_m, depth_m))
    ordered = np.abs(true) > np.log(FARTHER)
    right = float(np.mean((true * estimated)[ordered] > 0)) if ordered.any() else float("nan")
    return {"right": right, "judged": float(ordered.mean())}
