"""Solids with edges, by formula: cans, stars and stacked rounds, shaded flat, as their surface is.

Grids run around, the last column upon the first, from the foot (below) to the top.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from dasim.scene.procedural.triangles import Triangles, fitted, sheet
from dasim.typing import FloatArray

AROUND, ALONG = 96, 40  # cells of a grid


def _flat(points: FloatArray) -> Triangles:
    """A grid [rows, columns, xyz] as triangles that share no corners, each with its own normal; fitted to a cube."""
    whole = fitted(sheet(points[::-1], round_about=True))
    corners = whole.vertices[whole.faces]
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    area = np.linalg.norm(across, axis=-1)
    kept = area > 1e-12  # at poles and in caps some have none
    normals = np.repeat(across[kept] / area[kept, None], 3, axis=0)
    order = whole.faces[kept].ravel()
    faces = np.arange(len(order), dtype=np.uint32).reshape(-1, 3)
    return Triangles(whole.vertices[order], faces, whole.uv[order], normals)


def _around() -> FloatArray:
    return np.linspace(0.0, 2 * np.pi, AROUND + 1)


def _turned(radius: FloatArray, height: FloatArray) -> FloatArray:
    """A body of revolution from the profile's ``radius`` and ``height``, each [rows]."""
    angle = _around()
    x, z = radius[:, None] * np.cos(angle), radius[:, None] * np.sin(angle)
    return np.stack([x, np.broadcast_to(-height[:, None], x.shape), z], axis=-1)


def _can(seed: int) -> Triangles:
    """A closed cylinder or cone frustum with a small chamfer."""
    random = np.random.default_rng((seed, 6))
    foot, top, height = random.uniform(0.3, 0.5), random.uniform(0.2, 0.5), random.uniform(0.4, 1.2)
    edge = 0.03
    side = np.linspace(edge, 1 - edge, ALONG - 3)
    radius = np.concatenate([[0.0, foot - edge], foot + (top - foot) * side, [top - edge, 0.0]])
    return _flat(_turned(radius, np.concatenate([[0.0, 0.0], side * height, [height, height]])))


def _pillar(outline: FloatArray, height: float, twist: float, taper: float) -> FloatArray:
    """An outline [AROUND + 1, xz] drawn upwards, turned by ``twist`` radians and tapered, with flat caps."""
    share = np.concatenate([[0.0], np.linspace(0.0, 1.0, ALONG - 1), [1.0]])
    scale = 1.0 + (taper - 1.0) * share
    scale[[0, -1]] = 0.0
    angle = twist * share
    x = scale[:, None] * (np.cos(angle)[:, None] * outline[:, 0] - np.sin(angle)[:, None] * outline[:, 1])
    z = scale[:, None] * (np.sin(angle)[:, None] * outline[:, 0] + np.cos(angle)[:, None] * outline[:, 1])
    return np.stack([x, np.broadcast_to(-height * share[:, None], x.shape), z], axis=-1)


def _polygon(corners: FloatArray) -> FloatArray:
    """Points along the sides of a polygon [n, 2], corners among them, the last upon the first; [AROUND + 1, 2]."""
    closed = np.vstack([corners, corners[:1]])
    places = np.linspace(0.0, len(corners), AROUND + 1)  # AROUND is a multiple of most numbers of corners
    return np.stack([np.interp(places, np.arange(len(closed)), closed[:, i]) for i in range(2)], axis=-1)


def _star(seed: int) -> Triangles:
    """A star or gear of 4 to 12 points, drawn upwards."""
    random = np.random.default_rng((seed, 7))
    points = int(random.choice([4, 6, 8, 12]))
    inner = random.uniform(0.5, 0.8)
    angle = np.arange(2 * points) * np.pi / points
    radius = 0.5 * np.where(np.arange(2 * points) % 2, inner, 1.0)
    corners = np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=-1)
    height, twist, taper = random.uniform((0.2, -0.8, 0.6), (1.0, 0.8, 1.0))
    return _flat(_pillar(_polygon(corners), height, twist, taper))


def _pebbles(seed: int) -> Triangles:
    """Rounds stacked upon each other as one turned body: a bead chain, a chess man."""
    random = np.random.default_rng((seed, 8))
    count = int(random.integers(2, 5))
    share = np.linspace(0.0, 1.0, ALONG + 1)
    place = np.clip(share * count, 0, count - 1e-9)
    size = random.uniform(0.25, 0.5, count)[np.floor(place).astype(int)]
    radius = 0.04 + size * np.sqrt(np.maximum(1 - (2 * (place % 1) - 1) ** 2, 0.0))
    radius[[0, -1]] = 0.0
    return _flat(_turned(radius, share * random.uniform(1.0, 1.6)))


MESHES: dict[str, Callable[[int], Triangles]] = {"can": _can, "star": _star, "beads": _pebbles}
