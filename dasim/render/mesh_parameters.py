"""Triangles into and out of Mitsuba's meshes: the only module that knows the names of their parameters.

Mitsuba 3.10 renames them (``vertex_positions`` and others), which is why pyproject.toml admits only 3.9; the step
to 3.10 is a change here.

Tested in tests/dasim/scene/test_shapes.py and tests/dasim/render/foreign/.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from dasim.render.plugin import aligned
from dasim.scene.meshes import Part
from dasim.typing import FloatArray


def mesh(part: Part, to_camera: FloatArray, bsdf: Any, name: str) -> Any:
    """Mitsuba's mesh of triangles in camera axes, in metres.

    ``to_camera`` [4, 4] is rigid: it rotates and translates. The mesh is shaded flat unless ``part`` has normals.
    """
    import mitsuba as mi

    props = mi.Properties()
    props["bsdf"] = bsdf
    props["face_normals"] = part.normals is None
    result = mi.Mesh(
        name,
        len(part.vertices),
        len(part.faces),
        has_vertex_normals=part.normals is not None,
        has_vertex_texcoords=part.uv is not None,
        props=props,
    )
    vertices = part.vertices @ to_camera[:3, :3].T + to_camera[:3, 3]
    parameters = mi.traverse(result)
    parameters["vertex_positions"] = aligned(vertices)
    parameters["faces"] = np.ascontiguousarray(part.faces, np.uint32).ravel()
    if part.uv is not None:
        parameters["vertex_texcoords"] = aligned(part.uv)
    if part.normals is not None:
        normals = part.normals @ to_camera[:3, :3].T
        parameters["vertex_normals"] = aligned(normals)
    parameters.update()
    return result


def corners(shape: Any) -> FloatArray:
    """Corners of the triangles of a mesh or of a rectangle, [triangle, 3, xyz], in metres."""
    import mitsuba as mi

    parameters = mi.traverse(shape)
    if "vertex_positions" in parameters:
        vertices = np.array(parameters["vertex_positions"], dtype=np.float64).reshape(-1, 3)
        return vertices[np.array(parameters["faces"]).reshape(-1, 3)]
    # A rectangle has no vertices, only the transform of a square from -1 to 1.
    matrix = np.array(parameters["to_world"].matrix, dtype=np.float64).reshape(4, 4)
    square = np.array([[-1, -1, 0, 1], [1, -1, 0, 1], [1, 1, 0, 1], [-1, 1, 0, 1]]) @ matrix.T
    return square[:, :3][np.array([[0, 1, 2], [0, 2, 3]])]
