"""Pictures like photographs for the surfaces of training scenes: soft, each with a depth of field of its own.

Photographs are softer at their finest scale than drawn patterns. On a poster in focus they look like a pattern out of
focus, and only near-infrared, which is then as soft, tells the two apart.

Tested in tests/validation/training/test_photographs.py.
"""

from __future__ import annotations

import numpy as np

from dasim.typing import Float32Array
from validation.training.patterns import softened
from validation.training.rooms import Family, room

SIGMA_PX = (0.4, 2.5)  # of the lens and the demosaicing of a photograph, everywhere
DEFOCUS_PX = (0.5, 12.0)  # largest standard deviation of the blur out of focus
MOST_LEVEL = 10.0
STEPS = 6  # of standard deviation that are computed; those between are interpolated


def photograph(random: np.random.Generator, size_px: int, family: Family) -> Float32Array:
    """A photograph of a random room, [3, 2 size_px, 2 size_px] of reflectance times shading, by a Gaussian blur that
    grows with the distance in levels from what it is focused on.
    """
    seen = room(random, size_px, size_px, MOST_LEVEL, family)
    focus = float(seen.level[tuple(random.integers(0, seen.level.shape))])
    most = float(np.exp(random.uniform(*np.log(DEFOCUS_PX))))
    away = np.abs(seen.level - focus)
    sharp = softened(seen.radiance[:3], float(np.exp(random.uniform(*np.log(SIGMA_PX)))), periodic=False)
    sigmas = np.linspace(0, most, STEPS)
    place = away / max(float(away.max()), 1e-6) * (STEPS - 1)
    weights = [np.clip(1 - np.abs(place - step), 0, 1) for step in range(STEPS)]
    blurred = (softened(sharp, float(sigma), periodic=False) for sigma in sigmas)
    return np.asarray(sum(weight * part for weight, part in zip(weights, blurred, strict=True)), np.float32)
