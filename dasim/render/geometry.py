"""Translation of objects into Mitsuba's shapes, in camera axes and metres.

Tested in tests/dasim/scene/test_shapes.py and tests/dasim/render/test_truth.py.
"""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np

from dasim.materials.photographs import mask
from dasim.render.mesh_parameters import mesh
from dasim.render.plugin import transform
from dasim.scene import object_materials, shapes
from dasim.scene import specification as scenes
from dasim.scene.meshes import Part
from dasim.scene.specification import Scene

_UP = np.diag([1.0, -1.0, -1.0, 1.0])  # Mitsuba's flat shapes face +z with v up, ours -z with v down
MOST_HEIGHTS = 512  # most samples of a height field per side, which make half a million triangles


def shape(item: shapes.Object, scene: Scene, bsdf: Any, key: str) -> Any:
    """Mitsuba's shape, or its description, of an object with the BSDF ``bsdf`` and the name ``key``."""
    to_camera = scenes.object_to_camera(item, scene)
    _, half = shapes.half_extent_m(item, scene.folder)
    if item.shape == "mesh":
        return mesh(object_materials.triangles(item, scene.folder), to_camera, bsdf, key)
    if item.shape == "heightfield":
        return mesh(shapes.relief(item, _heights(mask(item.image, scene.folder))), to_camera, bsdf, key)
    if item.shape in ("plane", "disc"):
        local = _UP @ np.diag([half[0], half[1], 1.0, 1.0])
        plugin = {"plane": "rectangle", "disc": "disk"}[item.shape]
        return {"type": plugin, "to_world": transform(to_camera @ local), "bsdf": bsdf}
    if item.shape == "box":
        return mesh(_box(half), to_camera, bsdf, key)
    # The poles of Mitsuba's sphere and the axis of its cylinder lie along z: rotate z to -y, which is up.
    stand = np.array([[1.0, 0, 0, 0], [0, 0, -1, 0], [0, 1, 0, 0], [0, 0, 0, 1]])
    if item.shape == "sphere":
        return {"type": "sphere", "to_world": transform(to_camera @ stand @ np.diag([*half, 1.0])), "bsdf": bsdf}
    lower = np.eye(4)
    lower[2, 3] = -half[1]
    scale = np.diag([half[0], half[2], 2 * half[1], 1.0])
    return {"type": "cylinder", "to_world": transform(to_camera @ stand @ lower @ scale), "bsdf": bsdf}


def _heights(picture: np.ndarray) -> np.ndarray:
    """Heights [y, x] of a height field, averaged over areas to at most ``MOST_HEIGHTS`` samples per side."""
    rows, columns = (min(side, MOST_HEIGHTS) for side in picture.shape)
    return cv2.resize(picture, (columns, rows), interpolation=cv2.INTER_AREA)


def _box(half: np.ndarray) -> Part:
    """A box of half side lengths ``half`` [x, y, z] in metres.

    Each face shows the whole texture, upright as seen from outside; on the top and bottom faces, z is up.
    """
    corners = np.array([[-1, 1], [1, 1], [1, -1], [-1, -1]])  # x right, y down; bottom left first
    vertices: list[np.ndarray] = []
    faces: list[tuple[int, int, int]] = []
    # Directions right and down of each face, as seen from outside; the outward normal is -(right x down).
    for right, down in (
        ((1, 0, 0), (0, 1, 0)),
        ((-1, 0, 0), (0, 1, 0)),
        ((0, 0, 1), (0, 1, 0)),
        ((0, 0, -1), (0, 1, 0)),
        ((1, 0, 0), (0, 0, -1)),
        ((1, 0, 0), (0, 0, 1)),
    ):
        outward = -np.cross(right, down)
        first = len(vertices)
        vertices += [(x * np.array(right) + y * np.array(down) + outward) * half for x, y in corners]
        faces += [(first, first + 1, first + 2), (first, first + 2, first + 3)]
    uv = np.tile([[0, 0], [1, 0], [1, 1], [0, 1]], (6, 1)).astype(float)
    return Part(np.array(vertices), np.array(faces, np.uint32), uv)
