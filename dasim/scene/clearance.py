"""Whether an object has a likely size and leaves the lens free, with what is wrong in words for people.

Tested in tests/dasim/scene/test_shapes.py and tests/dasim/scene/test_specification.py.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from dasim.scene import meshes
from dasim.scene.shapes import Mesh, Object, Sphere, half_extent_m, mesh_parts
from dasim.typing import FloatArray

LENS_CLEARANCE_M = 1e-3
PUPIL_POINTS = 24
SMALLEST_M, LARGEST_M = 1e-5, 100.0


def size_problems(item: Object, folder: Path) -> list[str]:
    """What a mistake of units would look like."""
    size_m = 2 * float(half_extent_m(item, folder)[1].max())
    if SMALLEST_M <= size_m <= LARGEST_M:
        return []
    unit = f"unit_cm is {item.unit_cm:g}" if isinstance(item, Mesh) else "lengths are in centimetres"
    return [
        f"object '{item.name}': is {size_m:.3g} m large; {SMALLEST_M * 1e6:g} um to {LARGEST_M:g} m are allowed "
        f"(a mistake of units? {unit})"
    ]


def placement_problems(item: Object, folder: Path, to_camera: FloatArray, pupil_radius_m: float = 0.0) -> list[str]:
    """What stands against an object's place: behind the lens, on it, or around it."""
    centre, half = half_extent_m(item, folder)
    nearest_corner = centre + np.array(np.meshgrid(*[(-1, 1)] * 3)).reshape(3, -1).T * half
    depths = nearest_corner @ to_camera[2, :3] + to_camera[2, 3]
    if depths.max() <= 0:
        return [f"object '{item.name}': lies behind the lens (z up to {depths.max() * 100:.3g} cm, must be above 0)"]
    # The pupil's centre and rim, seen from the object; its box is widened by the clearance.
    turns = np.linspace(0.0, 2 * np.pi, PUPIL_POINTS, endpoint=False)
    rim = np.stack([np.cos(turns), np.sin(turns), np.zeros(PUPIL_POINTS)], axis=-1) * pupil_radius_m
    pupil = np.vstack([np.zeros(3), rim / 2, rim])
    to_local = np.linalg.inv(to_camera)
    offset = pupil @ to_local[:3, :3].T + to_local[:3, 3] - centre
    if not (np.abs(offset) <= half + LENS_CLEARANCE_M).all(axis=-1).any():
        return []
    if isinstance(item, Sphere) and np.linalg.norm(offset, axis=-1).min() > half[0] + LENS_CLEARANCE_M:
        return []
    if isinstance(item, Mesh):
        return _mesh_clearance_problems(item, folder, to_camera, pupil_radius_m + LENS_CLEARANCE_M)
    return [f"object '{item.name}': lies on the lens or around it; move it to z above 0"]


def _mesh_clearance_problems(item: Mesh, folder: Path, to_camera: FloatArray, clearance_m: float) -> list[str]:
    """A camera may stand in a mesh's box (a room, a canyon), but not in its surface or within a solid body.

    A room is a mesh whose faces point inwards; one with openings as wide as half of all directions is no body.
    """
    mesh = meshes.joined(mesh_parts(item, folder))
    corners = (mesh.vertices @ to_camera[:3, :3].T + to_camera[:3, 3])[mesh.faces]
    if meshes.distance_from_origin(corners) <= clearance_m:
        return [f"object '{item.name}': lies on the lens or around it; move it to z above 0"]
    if meshes.turns_around_origin(corners) > 0.5:
        return [
            f"object '{item.name}': the camera is inside it; move one of them, or, where it is a room, "
            f"turn the faces of {item.file} inwards"
        ]
    return []
