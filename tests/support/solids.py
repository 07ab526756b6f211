"""Area and volume of triangle meshes."""

from __future__ import annotations

import numpy as np


def area_vectors(part) -> np.ndarray:
    """Area times unit normal of each face, [face, 3]; the sum over a closed surface is zero."""
    a, b, c = (part.vertices[part.faces[:, corner]] for corner in range(3))
    return np.cross(b - a, c - a) / 2


def volume(part) -> float:
    """Volume of a closed surface by the divergence theorem; positive where faces point outwards."""
    return float(np.sum(part.vertices[part.faces[:, 0]] * area_vectors(part)) / 3)
