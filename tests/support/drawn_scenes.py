"""Random scenes, and where their objects are by their own points."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

import dasim
from dasim.base.toml import parse
from dasim.camera import specification as cameras
from dasim.camera.specification import Camera
from dasim.random_scenes.scene import PICTURE_PX
from dasim.scene import object_materials, shapes
from dasim.scene import specification as scenes
from dasim.scene.procedural import library

SEED = 11


DRAWS = 200


BACKGROUND = ("floor", "wall 1", "wall 2")


class Measured(NamedTuple):
    """An object by its own points, metres: depths, middle (camera axes), lowest level, distance from the lamps."""

    name: str
    item: shapes.Object
    depth: tuple[float, float]
    middle: np.ndarray
    lowest: float
    from_lamps: float


def measure(item, scene: dasim.Scene) -> Measured:
    points = points_m(item, scene)
    to_camera = scenes.world_to_camera(scene)
    level = points @ to_camera[:3, 1]  # the second row of the inverse
    lowest = item.position_cm[1] * 1e-2 + item.radius_cm * 1e-2 if isinstance(item, shapes.Sphere) else level.max()
    lamps = [to_camera[:3, :3] @ np.multiply(light.position_cm, 1e-2) for light in near_lights(scene)]
    # An eighth of a mesh's vertices: they lie closer than a millimetre, and the limit is a matter of decimetres.
    distance = min((float(np.sqrt(((points[::8] - lamp) ** 2).sum(axis=-1).min())) for lamp in lamps), default=np.inf)
    depth = points[:, 2]
    middle = (points.min(axis=0) + points.max(axis=0)) / 2
    return Measured(item.name, item, (depth.min(), depth.max()), middle, float(lowest), distance)


def near_lights(scene: dasim.Scene) -> list:
    return [light for light in scene.lights if light.kind in ("lamp", "panel")]


def small_camera(width: int = 64, height: int = 48) -> Camera:
    """A camera with the field of view of the default picture, in few and large pixels."""
    data = cameras.load_camera("da-mobile").model_dump()
    pitch_um = data["sensor"]["pixel_pitch_um"] * PICTURE_PX[0] / width
    data["sensor"] |= {"width_px": width, "height_px": height, "pixel_pitch_um": pitch_um}
    return parse(Camera, data, "small camera")


def things(scene: dasim.Scene) -> list:
    return [item for item in scene.objects if item.name not in BACKGROUND]


def corners_m(item, scene: dasim.Scene) -> np.ndarray:
    """Corners of an object's box in camera axes, [8, 3]."""
    centre, half = shapes.half_extent_m(item, scene.folder)
    matrix = scenes.object_to_camera(item, scene)
    corners = centre + np.array(np.meshgrid(*[(-1, 1)] * 3)).reshape(3, -1).T * half
    return corners @ matrix[:3, :3].T + matrix[:3, 3]


def points_m(item, scene: dasim.Scene) -> np.ndarray:
    """Points whose hull contains an object, in camera axes: the vertices of a mesh, the ends of a ball along z."""
    matrix = scenes.object_to_camera(item, scene)
    if isinstance(item, shapes.Sphere):
        return matrix[:3, 3] + np.array([[0, 0, -1], [0, 0, 1]]) * item.radius_cm * 1e-2
    if isinstance(item, shapes.Mesh):
        if item.file.startswith(library.PREFIX):
            vertices = library.procedural(item.file.removeprefix(library.PREFIX)).vertices * item.unit_cm * 1e-2
            return vertices @ matrix[:3, :3].T + matrix[:3, 3]
        return object_materials.triangles(item, scene.folder).vertices @ matrix[:3, :3].T + matrix[:3, 3]
    if isinstance(item, (shapes.Cylinder, shapes.Disc)):
        turn = np.linspace(0, 2 * np.pi, 48)
        height = item.height_cm / 2 if isinstance(item, shapes.Cylinder) else 0.0
        flat = [np.cos(turn), np.sin(turn), 0 * turn] if height == 0 else [np.cos(turn), 0 * turn, np.sin(turn)]
        ring = np.stack(flat, axis=-1) * item.radius_cm
        local = np.concatenate([ring + np.array((0, side * height, 0)) for side in (-1, 1)]) * 1e-2
        return local @ matrix[:3, :3].T + matrix[:3, 3]
    return corners_m(item, scene)
