"""Checks of an object's size and of its clearance from the lens; each returns its problems as sentences for the user.

Tested in tests/dasim/scene/test_shapes.py and tests/dasim/scene/test_specification.py.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from dasim.scene import mesh_merging, meshes
from dasim.scene.lights import Bulb, Near, Panel
from dasim.scene.shapes import Mesh, Object, Sphere, half_extent_m, mesh_parts
from dasim.typing import FloatArray

LENS_CLEARANCE_M = 1e-3
PUPIL_POINTS = 24
SMALLEST_M, LARGEST_M = 1e-5, 100.0


def size_problems(item: Object, folder: Path) -> list[str]:
    """Problems with the size of an object: outside ``SMALLEST_M`` to ``LARGEST_M``, most likely a mistake of units."""
    size_m = 2 * float(half_extent_m(item, folder)[1].max())
    if SMALLEST_M <= size_m <= LARGEST_M:
        return []
    unit = f"unit_cm is {item.unit_cm:g}" if isinstance(item, Mesh) else "lengths are in centimetres"
    return [
        f"object '{item.name}': is {size_m:.3g} m large; {SMALLEST_M * 1e6:g} um to {LARGEST_M:g} m are allowed "
        f"(wrong unit? {unit})"
    ]


def distance_m(light: Near, to_camera: FloatArray) -> float:
    """Distance of a light from the middle of the lens, in metres; a panel counts as the disc that fits into it.

    ``to_camera`` transforms axes of the scene, in metres, into those of the camera, [4, 4].
    """
    place, target = (
        to_camera[:3, :3] @ np.multiply(at, 1e-2) + to_camera[:3, 3] for at in (light.position_cm, light.target_cm)
    )
    radius = 1e-2 * (min(light.size_cm) / 2 if isinstance(light, Panel) else light.radius_cm)
    if isinstance(light, Bulb):
        return max(float(np.linalg.norm(place)) - radius, 0.0)
    forward = (target - place) / np.linalg.norm(target - place)
    off_plane = float(place @ forward)
    in_plane = float(np.linalg.norm(place - off_plane * forward))
    return float(np.hypot(off_plane, max(in_plane - radius, 0.0)))


def placement_problems(
    item: Object, folder: Path, to_camera: FloatArray, pupil_radius_m: float = 0.0, *, moved: bool = False
) -> list[str]:
    """Problems with the position of an object: behind the lens, in contact with it, or enclosing it.

    Args:
        item: the object
        folder: where its mesh file lies
        to_camera: transform of its local axes into camera axes, metres, [4, 4]
        pupil_radius_m: radius of the lens opening around the origin, metres
        moved: whether the scene has a view of its own, from which objects may lie behind the lens
    """
    centre, half = half_extent_m(item, folder)
    corners = centre + np.array(np.meshgrid(*[(-1, 1)] * 3)).reshape(3, -1).T * half
    depths = corners @ to_camera[2, :3] + to_camera[2, 3]
    if depths.max() <= 0 and not moved:
        return [f"object '{item.name}': lies behind the lens (z up to {depths.max() * 100:.3g} cm, must be above 0)"]
    # Points of the pupil (centre, half radius, rim) in the object's axes, against its box enlarged by the clearance.
    angles = np.linspace(0.0, 2 * np.pi, PUPIL_POINTS, endpoint=False)
    rim = np.stack([np.cos(angles), np.sin(angles), np.zeros(PUPIL_POINTS)], axis=-1) * pupil_radius_m
    pupil = np.vstack([np.zeros(3), rim / 2, rim])
    to_local = np.linalg.inv(to_camera)
    offset = pupil @ to_local[:3, :3].T + to_local[:3, 3] - centre
    if not (np.abs(offset) <= half + LENS_CLEARANCE_M).all(axis=-1).any():
        return []
    if isinstance(item, Sphere) and np.linalg.norm(offset, axis=-1).min() > half[0] + LENS_CLEARANCE_M:
        return []
    if isinstance(item, Mesh):
        return _mesh_clearance_problems(item, folder, to_camera, pupil_radius_m + LENS_CLEARANCE_M)
    return [f"object '{item.name}': lies on the lens or encloses it; move it to z above 0"]


def _mesh_clearance_problems(item: Mesh, folder: Path, to_camera: FloatArray, clearance_m: float) -> list[str]:
    """Problems of a camera that stands within the bounding box of a mesh: on its surface, or inside a solid body.

    A room (faces that point inwards) or an open shape such as a canyon may surround the camera. A mesh counts as a
    solid body where its winding number around the camera exceeds 0.5: its outward faces then cover more than half of
    all directions.
    """
    mesh = mesh_merging.merge(mesh_parts(item, folder))
    corners = (mesh.vertices @ to_camera[:3, :3].T + to_camera[:3, 3])[mesh.faces]
    if meshes.distance_from_origin(corners) <= clearance_m:
        return [f"object '{item.name}': lies on the lens or encloses it; move it to z above 0"]
    if meshes.winding_number(corners) > 0.5:
        return [
            f"object '{item.name}': the camera is inside it; move one of them or, if it is a room, "
            f"reverse the faces of {item.file} so that they point inwards"
        ]
    return []
