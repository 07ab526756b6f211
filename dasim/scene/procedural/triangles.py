"""Triangles made by formula: sheets, tubes and balls, and how they are put together.

Axes are the scene's: x right, y down, z forward, away from the camera. Corners run counter-clockwise as seen from
outside. Lengths are in units of the whole thing.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from dasim.typing import FloatArray


class Triangles(NamedTuple):
    """``vertices`` [n, xyz], ``faces`` [m, 3], texture coordinates ``uv`` [n, 2] and unit ``normals`` [n, xyz]."""

    vertices: FloatArray
    faces: NDArray[np.uint32]
    uv: FloatArray
    normals: FloatArray


def sheet(points: FloatArray, *, round_about: bool = False) -> Triangles:
    """A surface through points [rows, columns, xyz]; u runs along the columns, v from the last row (0) to the first.

    ``round_about`` says that the last column is the first again, so that its normals are the same. The outside is
    where rows run down and columns to the right.
    """
    rows, columns = points.shape[:2]
    first = (np.arange(rows - 1)[:, None] * columns + np.arange(columns - 1)).ravel()
    right, below, across = first + 1, first + columns, first + columns + 1
    faces = np.concatenate([np.stack([first, across, right], -1), np.stack([first, below, across], -1)])
    vertices = points.reshape(-1, 3)
    sums = _face_sums(vertices, faces).reshape(rows, columns, 3)
    if round_about:
        sums[:, 0] = sums[:, -1] = sums[:, 0] + sums[:, -1]
    for row in (0, -1):  # a row that shrinks to a point is one corner
        if np.allclose(points[row], points[row, 0]):
            sums[row] = sums[row].sum(axis=0)
    u, down = np.meshgrid(np.linspace(0, 1, columns), np.linspace(0, 1, rows))
    uv = np.stack([u, 1 - down], axis=-1).reshape(-1, 2)
    return Triangles(vertices, faces.astype(np.uint32), uv, _unit(sums.reshape(-1, 3)))


def smooth(vertices: FloatArray, faces: NDArray[np.uint32], uv: FloatArray) -> Triangles:
    """Triangles with normals that are the mean of the faces around each corner, by area."""
    return Triangles(vertices, faces, uv, _unit(_face_sums(vertices, faces)))


def _face_sums(vertices: FloatArray, faces: NDArray[np.integer]) -> FloatArray:
    a, b, c = (vertices[faces[:, corner]] for corner in range(3))
    across = np.cross(b - a, c - a)
    return np.stack(
        [np.bincount(faces.ravel(), np.repeat(across[:, axis], 3), len(vertices)) for axis in range(3)], axis=-1
    )


def _unit(vectors: FloatArray) -> FloatArray:
    return vectors / np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), 1e-30)


def tube(path: FloatArray, radius: FloatArray | float, sides: int = 12, *, closed: bool = False) -> Triangles:
    """A tube of ``radius`` (one or [n]) along a path [n, xyz]; u runs around it, v along it.

    The cross-section turns with the path as little as it can (parallel transport); of a ``closed`` path, whose last
    point is its first, what is left of the turn is spread over its length.
    """
    along = np.gradient(path, axis=0)
    if closed:
        along[0] = along[-1] = path[1] - path[-2]
    along = _unit(along)
    side = np.empty_like(path)
    side[0] = _unit(np.cross(along[0], np.eye(3)[np.argmin(np.abs(along[0]))]))
    for i in range(1, len(path)):
        kept = side[i - 1] - along[i] * (side[i - 1] @ along[i])
        side[i] = kept / np.linalg.norm(kept)
    other = np.cross(along, side)
    twist = np.arctan2(side[-1] @ other[0], side[-1] @ side[0]) if closed else 0.0
    angle = np.linspace(0, 2 * np.pi, sides + 1) + twist * np.linspace(0, 1, len(path))[:, None]
    rim = np.cos(angle)[..., None] * side[:, None] - np.sin(angle)[..., None] * other[:, None]
    wide = np.broadcast_to(np.asarray(radius, float), (len(path),))[:, None, None]
    return sheet(path[:, None] + wide * rim, round_about=True)


def ball(rows: int = 24, columns: int = 48) -> FloatArray:
    """Unit vectors [rows + 1, columns + 1, xyz] from the top pole to the bottom, the seam behind."""
    down = np.linspace(0, np.pi, rows + 1)[:, None]
    turn = np.linspace(-np.pi, np.pi, columns + 1)
    return np.stack(
        np.broadcast_arrays(np.sin(down) * np.sin(turn), -np.cos(down), -np.sin(down) * np.cos(turn)), axis=-1
    )


def turned(x_deg: float = 0.0, y_deg: float = 0.0, z_deg: float = 0.0) -> FloatArray:
    """Rotation [3, 3] about x, then y, then z."""
    result = np.eye(3)
    for axis, degrees in enumerate((x_deg, y_deg, z_deg)):
        a, b = (axis + 1) % 3, (axis + 2) % 3
        step = np.eye(3)
        step[a, a] = step[b, b] = np.cos(np.radians(degrees))
        step[b, a] = np.sin(np.radians(degrees))
        step[a, b] = -step[b, a]
        result = step @ result
    return result


def placed(
    part: Triangles, turn: FloatArray | None = None, at: Sequence[float] | FloatArray = (0.0, 0.0, 0.0), size: float = 1
) -> Triangles:
    """A part scaled, turned by a rotation [3, 3], and moved."""
    rotation = np.eye(3) if turn is None else turn
    return part._replace(vertices=part.vertices * size @ rotation.T + np.asarray(at), normals=part.normals @ rotation.T)


def together(parts: Sequence[Triangles]) -> Triangles:
    """Several parts as one."""
    first = np.cumsum([0, *(len(part.vertices) for part in parts)])
    return Triangles(
        np.concatenate([part.vertices for part in parts]),
        np.concatenate([part.faces + np.uint32(start) for part, start in zip(parts, first, strict=False)]),
        np.concatenate([part.uv for part in parts]),
        np.concatenate([part.normals for part in parts]),
    )


def fitted(part: Triangles) -> Triangles:
    """The part centred and scaled so that the longest side of its box is 1."""
    low, high = part.vertices.min(axis=0), part.vertices.max(axis=0)
    return part._replace(vertices=(part.vertices - (low + high) / 2) * (1.0 / float((high - low).max())))
