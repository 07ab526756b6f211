"""Probability that two sets of noisy pictures with the same mean differ as much as they do.

Tested in tests/validation/scores/test_chance.py.
"""

from __future__ import annotations

import numpy as np
from scipy.stats import permutation_test

from dasim.typing import FloatArray

PERMUTATIONS = 9999  # so that the least probability is 1e-4


def by_chance(one: FloatArray, other: FloatArray) -> float:
    """Probability that exchanging pictures [seed, block] between two sets makes them differ as much.

    The blocks of a picture need not be independent: pictures are exchanged whole. Each set needs two pictures or more,
    and their noise may differ, because a block's difference counts relative to its noise.
    """
    both = np.concatenate([one, other])

    def distance(first: FloatArray, second: FloatArray, axis: int) -> FloatArray:
        """Mean square difference of the blocks' means relative to their noise; the arguments are numbers of seeds."""
        parts = [both[numbers.astype(int)] for numbers in (first, second)]  # [..., seed, block]
        variance = np.sum([part.var(axis=-2, ddof=1) / part.shape[-2] for part in parts], axis=0)
        return np.asarray(np.mean((parts[0].mean(axis=-2) - parts[1].mean(axis=-2)) ** 2 / variance, axis=-1))

    numbers = np.arange(len(one)), np.arange(len(one), len(both))
    test = permutation_test(
        numbers, distance, n_resamples=PERMUTATIONS, batch=500, alternative="greater", vectorized=True, rng=0
    )
    return float(test.pvalue)
