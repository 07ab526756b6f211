"""Procedural solids with sharp edges: cans, stars and strings of beads, with one normal per triangle (flat shading).

Each solid is a grid of points [rows, columns, xyz]: rows run from the foot to the top, columns around the upright axis,
and the last column repeats the first.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from dasim.scene.procedural.triangles import Triangles, fit_unit_cube, sheet
from dasim.typing import FloatArray

AROUND, ALONG = 96, 40  # cells of a grid around and along the axis


def _flat_shaded(points: FloatArray) -> Triangles:
    """A flat-shaded mesh of a grid [rows, columns, xyz], scaled to the unit cube; its triangles share no vertices."""
    whole = fit_unit_cube(sheet(points[::-1], periodic=True))
    corners = whole.vertices[whole.faces]
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    area = np.linalg.norm(across, axis=-1)
    valid = area > 1e-12  # at the poles and in the caps some triangles are degenerate
    normals = np.repeat(across[valid] / area[valid, None], 3, axis=0)
    order = whole.faces[valid].ravel()
    faces = np.arange(len(order), dtype=np.uint32).reshape(-1, 3)
    return Triangles(whole.vertices[order], faces, whole.uv[order], normals)


def _angles() -> FloatArray:
    """Angles of the columns around the axis, radians, [AROUND + 1]."""
    return np.linspace(0.0, 2 * np.pi, AROUND + 1)


def _revolution(radius: FloatArray, height: FloatArray) -> FloatArray:
    """Grid of a body of revolution about the upright axis; ``radius`` and ``height`` [rows] describe its profile."""
    angle = _angles()
    x, z = radius[:, None] * np.cos(angle), radius[:, None] * np.sin(angle)
    return np.stack([x, np.broadcast_to(-height[:, None], x.shape), z], axis=-1)


def _can(seed: int) -> Triangles:
    """A closed cylinder or truncated cone with a small chamfer at both ends."""
    random = np.random.default_rng((seed, 6))
    foot, top, height = random.uniform(0.3, 0.5), random.uniform(0.2, 0.5), random.uniform(0.4, 1.2)
    edge = 0.03
    side = np.linspace(edge, 1 - edge, ALONG - 3)
    radius = np.concatenate([[0.0, foot - edge], foot + (top - foot) * side, [top - edge, 0.0]])
    return _flat_shaded(_revolution(radius, np.concatenate([[0.0, 0.0], side * height, [height, height]])))


def _extrusion(outline: FloatArray, height: float, twist: float, taper: float) -> FloatArray:
    """Grid of an outline [AROUND + 1, xz] extruded upwards by ``height``, with flat caps.

    From the foot to the top, the outline turns by ``twist`` radians and its scale runs from 1 to ``taper``.
    """
    share = np.concatenate([[0.0], np.linspace(0.0, 1.0, ALONG - 1), [1.0]])
    scale = 1.0 + (taper - 1.0) * share
    scale[[0, -1]] = 0.0
    angle = twist * share
    x = scale[:, None] * (np.cos(angle)[:, None] * outline[:, 0] - np.sin(angle)[:, None] * outline[:, 1])
    z = scale[:, None] * (np.sin(angle)[:, None] * outline[:, 0] + np.cos(angle)[:, None] * outline[:, 1])
    return np.stack([x, np.broadcast_to(-height * share[:, None], x.shape), z], axis=-1)


def _polygon_points(corners: FloatArray) -> FloatArray:
    """Points [AROUND + 1, 2] at equal shares of the sides of a polygon with corners [n, 2]; the last repeats the first.

    Every corner is one of the points where AROUND is a multiple of n.
    """
    closed = np.vstack([corners, corners[:1]])
    places = np.linspace(0.0, len(corners), AROUND + 1)
    return np.stack([np.interp(places, np.arange(len(closed)), closed[:, i]) for i in range(2)], axis=-1)


def _star(seed: int) -> Triangles:
    """An extruded star or gear of 4, 6, 8 or 12 points."""
    random = np.random.default_rng((seed, 7))
    points = int(random.choice([4, 6, 8, 12]))
    inner = random.uniform(0.5, 0.8)
    angle = np.arange(2 * points) * np.pi / points
    radius = 0.5 * np.where(np.arange(2 * points) % 2, inner, 1.0)
    corners = np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=-1)
    height, twist, taper = random.uniform((0.2, -0.8, 0.6), (1.0, 0.8, 1.0))
    return _flat_shaded(_extrusion(_polygon_points(corners), height, twist, taper))


def _beads(seed: int) -> Triangles:
    """Two to four beads stacked along the axis, as one body of revolution like a chess piece."""
    random = np.random.default_rng((seed, 8))
    count = int(random.integers(2, 5))
    share = np.linspace(0.0, 1.0, ALONG + 1)
    place = np.clip(share * count, 0, count - 1e-9)
    size = random.uniform(0.25, 0.5, count)[np.floor(place).astype(int)]
    radius = 0.04 + size * np.sqrt(np.maximum(1 - (2 * (place % 1) - 1) ** 2, 0.0))
    radius[[0, -1]] = 0.0
    return _flat_shaded(_revolution(radius, share * random.uniform(1.0, 1.6)))


MESHES: dict[str, Callable[[int], Triangles]] = {"can": _can, "star": _star, "beads": _beads}
