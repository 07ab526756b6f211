"""Objects as Mitsuba's shapes, in camera axes.

Tested in tests/dasim/scene/test_shapes.py and tests/dasim/render/test_truth.py.
"""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np

from dasim.materials.photographs import mask
from dasim.render.plugin import transform
from dasim.scene import shapes
from dasim.scene import specification as scenes
from dasim.scene.meshes import Part
from dasim.scene.specification import Scene

_UP = np.diag([1.0, -1.0, -1.0, 1.0])  # Mitsuba's flat shapes face +z with v up; ours face -z with v down


def shape(item: shapes.Object, scene: Scene, bsdf: Any, key: str) -> Any:
    """Mitsuba's shape of an object, with a scattering function and a name."""
    to_camera = scenes.object_to_camera(item, scene)
    _, half = shapes.half_extent_m(item, scene.folder)
    if item.shape == "mesh":
        return mesh(scenes.triangles(item, scene.folder), to_camera, bsdf, key)
    if item.shape == "heightfield":
        return mesh(shapes.relief(item, _heights(mask(item.image, scene.folder))), to_camera, bsdf, key)
    if item.shape in ("plane", "disc"):
        local = _UP @ np.diag([half[0], half[1], 1.0, 1.0])
        plugin = {"plane": "rectangle", "disc": "disk"}[item.shape]
        return {"type": plugin, "to_world": transform(to_camera @ local), "bsdf": bsdf}
    if item.shape == "box":
        return mesh(_box(half), to_camera, bsdf, key)
    # Mitsuba's sphere has its poles, and its cylinder its axis, along z: turn z to up (-y).
    stand = np.array([[1.0, 0, 0, 0], [0, 0, -1, 0], [0, 1, 0, 0], [0, 0, 0, 1]])
    if item.shape == "sphere":
        return {"type": "sphere", "to_world": transform(to_camera @ stand @ np.diag([*half, 1.0])), "bsdf": bsdf}
    lower = np.eye(4)
    lower[2, 3] = -half[1]
    scale = np.diag([half[0], half[2], 2 * half[1], 1.0])
    return {"type": "cylinder", "to_world": transform(to_camera @ stand @ lower @ scale), "bsdf": bsdf}


MOST_HEIGHTS = 512  # of a height field along a side: half a million triangles


def _heights(picture: np.ndarray) -> np.ndarray:
    """A height field's picture, averaged down where it has more pixels than are worth a triangle each."""
    rows, columns = (min(side, MOST_HEIGHTS) for side in picture.shape)
    return cv2.resize(picture, (columns, rows), interpolation=cv2.INTER_AREA)


def _box(half: np.ndarray) -> Part:
    """A box whose every side shows the whole texture upright, seen from outside; the lids as seen with z up."""
    corners = np.array([[-1, 1], [1, 1], [1, -1], [-1, -1]])  # bottom left first, right, y down
    vertices: list[np.ndarray] = []
    faces: list[tuple[int, int, int]] = []
    # right and down of each side as seen from outside; the side itself lies at right x down, turned outward
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


def mesh(data: Part, to_camera: np.ndarray, bsdf: Any, key: str) -> Any:
    """Mitsuba's mesh of triangles; shaded flat, as it is, but where its file brought normals."""
    import mitsuba as mi

    props = mi.Properties()
    props["bsdf"] = bsdf
    props["face_normals"] = data.normals is None
    built = mi.Mesh(
        key,
        len(data.vertices),
        len(data.faces),
        has_vertex_normals=data.normals is not None,
        has_vertex_texcoords=data.uv is not None,
        props=props,
    )
    vertices = data.vertices @ to_camera[:3, :3].T + to_camera[:3, 3]
    params = mi.traverse(built)
    params["vertex_positions"] = np.ascontiguousarray(vertices, np.float32).ravel()
    params["faces"] = np.ascontiguousarray(data.faces, np.uint32).ravel()
    if data.uv is not None:
        params["vertex_texcoords"] = np.ascontiguousarray(data.uv, np.float32).ravel()
    if data.normals is not None:
        normals = data.normals @ to_camera[:3, :3].T  # an object is turned and moved, never stretched
        params["vertex_normals"] = np.ascontiguousarray(normals, np.float32).ravel()
    params.update()
    return built
