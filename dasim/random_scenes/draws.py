"""Random numbers of random scenes: one generator per stage of sampling, and draws by weight.

Tested in tests/dasim/random_scenes/test_scene.py.
"""

from __future__ import annotations

from typing import Any

import numpy as np

Random = np.random.Generator

STAGES = {
    "room": 1,
    "palette": 2,
    "background": 3,
    "count": 4,
    "object": 5,
    "light": 6,
    "focus": 7,
    "exposure": 8,
    "surface": 9,
}


def generator(seed: int, index: int, stage: str, number: int = 0) -> Random:
    """Generator of a stage of a scene; ``number`` distinguishes the objects or lamps of a stage."""
    return np.random.Generator(np.random.Philox(np.random.SeedSequence((seed, index, STAGES[stage], number))))


def weighted(random: Random, weights: dict[Any, float]) -> Any:
    """A key of ``weights``, drawn with a probability in proportion to its weight."""
    share = np.cumsum(list(weights.values()))
    return list(weights)[int(np.searchsorted(share, random.random() * share[-1], side="right"))]


def rounded(values: Any) -> list[float]:
    """Numbers to four decimals, as the scene's file would have them."""
    return [round(float(value), 4) for value in values]
