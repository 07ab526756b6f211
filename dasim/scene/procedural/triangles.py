"""Triangle meshes from formulas: sheets, tubes and balls, and the operations that combine them.

Axes are those of the scene: x right, y down, z forward (away from the camera). The corners of a triangle run
counter-clockwise as seen from outside. Lengths are in a unit of the mesh's own; a scene sets it with ``unit_cm``.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from dasim.typing import FloatArray


class Triangles(NamedTuple):
    """A mesh: ``vertices`` [n, xyz], ``faces`` [m, 3], texture coordinates ``uv`` [n, 2], unit ``normals`` [n, xyz]."""

    vertices: FloatArray
    faces: NDArray[np.uint32]
    uv: FloatArray
    normals: FloatArray


def sheet(points: FloatArray, *, periodic: bool = False) -> Triangles:
    """A sheet joins the neighbours of a grid of points [rows, columns, xyz] with two triangles per cell.

    Texture coordinate u runs from 0 to 1 along the columns, v from 0 at the last row to 1 at the first. Seen from
    outside, rows run downwards and columns to the right. ``periodic`` means that the last column repeats the first:
    both then get the same normals.
    """
    rows, columns = points.shape[:2]
    first = (np.arange(rows - 1)[:, None] * columns + np.arange(columns - 1)).ravel()
    right, below, across = first + 1, first + columns, first + columns + 1
    faces = np.concatenate([np.stack([first, across, right], -1), np.stack([first, below, across], -1)])
    vertices = points.reshape(-1, 3)
    sums = _normal_sums(vertices, faces).reshape(rows, columns, 3)
    if periodic:
        sums[:, 0] = sums[:, -1] = sums[:, 0] + sums[:, -1]
    for row in (0, -1):  # all points of a row that shrinks to a pole share one normal
        if np.allclose(points[row], points[row, 0]):
            sums[row] = sums[row].sum(axis=0)
    u, down = np.meshgrid(np.linspace(0, 1, columns), np.linspace(0, 1, rows))
    uv = np.stack([u, 1 - down], axis=-1).reshape(-1, 2)
    return Triangles(vertices, faces.astype(np.uint32), uv, _unit(sums.reshape(-1, 3)))


def smooth(vertices: FloatArray, faces: NDArray[np.uint32], uv: FloatArray) -> Triangles:
    """A mesh whose vertex normals are the area-weighted mean of the normals of the adjacent faces."""
    return Triangles(vertices, faces, uv, _unit(_normal_sums(vertices, faces)))


def _normal_sums(vertices: FloatArray, faces: NDArray[np.integer]) -> FloatArray:
    """Sum of the normals of the faces at each vertex, weighted by twice their area, [n, xyz]."""
    a, b, c = (vertices[faces[:, corner]] for corner in range(3))
    across = np.cross(b - a, c - a)
    return np.stack(
        [np.bincount(faces.ravel(), np.repeat(across[:, axis], 3), len(vertices)) for axis in range(3)], axis=-1
    )


def _unit(vectors: FloatArray) -> FloatArray:
    return vectors / np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), 1e-30)


def tube(path: FloatArray, radius: FloatArray | float, sides: int = 12, *, closed: bool = False) -> Triangles:
    """A tube follows a path [n, xyz] with a radius that is one number or [n]; u runs around it, v along it.

    Parallel transport carries the cross-section along the path without twist. A ``closed`` path ends at its first
    point; the angle by which transport misses the first cross-section is then distributed evenly along the path.
    """
    along = np.gradient(path, axis=0)
    if closed:
        along[0] = along[-1] = path[1] - path[-2]
    along = _unit(along)
    side = np.empty_like(path)
    side[0] = _unit(np.cross(along[0], np.eye(3)[np.argmin(np.abs(along[0]))]))
    for i in range(1, len(path)):
        perpendicular = side[i - 1] - along[i] * (side[i - 1] @ along[i])
        side[i] = perpendicular / np.linalg.norm(perpendicular)
    other = np.cross(along, side)
    twist = np.arctan2(side[-1] @ other[0], side[-1] @ side[0]) if closed else 0.0
    angle = np.linspace(0, 2 * np.pi, sides + 1) + twist * np.linspace(0, 1, len(path))[:, None]
    rim = np.cos(angle)[..., None] * side[:, None] - np.sin(angle)[..., None] * other[:, None]
    wide = np.broadcast_to(np.asarray(radius, float), (len(path),))[:, None, None]
    return sheet(path[:, None] + wide * rim, periodic=True)


def ball(rows: int = 24, columns: int = 48) -> FloatArray:
    """Unit vectors [rows + 1, columns + 1, xyz] of a latitude-longitude grid.

    Rows run from the upper pole (-y) to the lower one. The first and the last column coincide on the far side (+z).
    """
    down = np.linspace(0, np.pi, rows + 1)[:, None]
    turn = np.linspace(-np.pi, np.pi, columns + 1)
    return np.stack(
        np.broadcast_arrays(np.sin(down) * np.sin(turn), -np.cos(down), -np.sin(down) * np.cos(turn)), axis=-1
    )


def rotation_matrix(x_deg: float = 0.0, y_deg: float = 0.0, z_deg: float = 0.0) -> FloatArray:
    """Rotation matrix [3, 3] about x, then y, then z, right-handed."""
    result = np.eye(3)
    for axis, degrees in enumerate((x_deg, y_deg, z_deg)):
        a, b = (axis + 1) % 3, (axis + 2) % 3
        step = np.eye(3)
        step[a, a] = step[b, b] = np.cos(np.radians(degrees))
        step[b, a] = np.sin(np.radians(degrees))
        step[a, b] = -step[b, a]
        result = step @ result
    return result


def transform(
    mesh: Triangles,
    rotation: FloatArray | None = None,
    position: Sequence[float] | FloatArray = (0.0, 0.0, 0.0),
    scale: float = 1,
) -> Triangles:
    """Scale a mesh about its origin, rotate it by a matrix [3, 3] (default: identity), then move it to ``position``."""
    matrix = np.eye(3) if rotation is None else rotation
    vertices = mesh.vertices * scale @ matrix.T + np.asarray(position)
    return mesh._replace(vertices=vertices, normals=mesh.normals @ matrix.T)


def merge(parts: Sequence[Triangles]) -> Triangles:
    """Merge several meshes into one."""
    first = np.cumsum([0, *(len(part.vertices) for part in parts)])
    return Triangles(
        np.concatenate([part.vertices for part in parts]),
        np.concatenate([part.faces + np.uint32(start) for part, start in zip(parts, first, strict=False)]),
        np.concatenate([part.uv for part in parts]),
        np.concatenate([part.normals for part in parts]),
    )


def fit_unit_cube(mesh: Triangles) -> Triangles:
    """Centre a mesh on the origin and scale it so that the longest side of its bounding box is 1."""
    low, high = mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)
    return mesh._replace(vertices=(mesh.vertices - (low + high) / 2) * (1.0 / float((high - low).max())))
