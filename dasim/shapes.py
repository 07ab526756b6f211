"""The objects of a scene as data, where they stand, and the triangles of mesh files.

Lengths of a specification are centimetres and angles degrees; everything computed from it is in metres.
"""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from dasim.errors import InputError
from dasim.specification import Specification

FloatArray = NDArray[np.float64]
Vector = tuple[float, float, float]
Positive = Annotated[float, Field(gt=0)]


class _Placed(Specification):
    name: str = Field(min_length=1)
    material: str
    position_cm: Vector = (0.0, 0.0, 0.0)
    rotation_deg: Vector = Field(default=(0.0, 0.0, 0.0), description="about x, then y, then z")


class Plane(_Placed):
    """A rectangle that faces the camera (-z) when not rotated."""

    shape: Literal["plane"]
    size_cm: tuple[Positive, Positive]


class Disc(_Placed):
    """A disc that faces the camera (-z) when not rotated."""

    shape: Literal["disc"]
    radius_cm: Positive


class Box(_Placed):
    """A box, ``size_cm`` along x, y, z."""

    shape: Literal["box"]
    size_cm: tuple[Positive, Positive, Positive]


class Sphere(_Placed):
    """A sphere; its texture's poles are above and below."""

    shape: Literal["sphere"]
    radius_cm: Positive


class Cylinder(_Placed):
    """An open cylinder standing along y."""

    shape: Literal["cylinder"]
    radius_cm: Positive
    height_cm: Positive


class Mesh(_Placed):
    """A mesh file (OBJ, PLY, GLB, STL, OFF), ``unit_cm`` the length of its unit."""

    shape: Literal["mesh"]
    file: str
    unit_cm: Positive = 1.0


Object = Annotated[Plane | Disc | Box | Sphere | Cylinder | Mesh, Field(discriminator="shape")]


# --- geometry ------------------------------------------------------------------------------------


def placement(item: Object) -> FloatArray:
    """Transform of an object's unscaled local axes into scene coordinates, metres, [4, 4]."""
    placed = np.eye(4)
    placed[:3, :3] = _rotation(item.rotation_deg)
    placed[:3, 3] = np.multiply(item.position_cm, 1e-2)
    return placed


def _rotation(degrees: Vector) -> FloatArray:
    x, y, z = np.radians(degrees)
    about_x = np.array([[1, 0, 0], [0, np.cos(x), -np.sin(x)], [0, np.sin(x), np.cos(x)]])
    about_y = np.array([[np.cos(y), 0, np.sin(y)], [0, 1, 0], [-np.sin(y), 0, np.cos(y)]])
    about_z = np.array([[np.cos(z), -np.sin(z), 0], [np.sin(z), np.cos(z), 0], [0, 0, 1]])
    return about_z @ about_y @ about_x


def half_extent_m(item: Object, folder: Path) -> tuple[FloatArray, FloatArray]:
    """Centre and half size of an object's box in its local axes, metres."""
    if isinstance(item, Mesh):
        vertices = load_mesh(item, folder).vertices
        low, high = vertices.min(axis=0), vertices.max(axis=0)
        return (low + high) / 2, (high - low) / 2
    if isinstance(item, Plane):
        half = (item.size_cm[0] / 2, item.size_cm[1] / 2, 0.0)
    elif isinstance(item, Box):
        half = (item.size_cm[0] / 2, item.size_cm[1] / 2, item.size_cm[2] / 2)
    elif isinstance(item, Cylinder):
        half = (item.radius_cm, item.height_cm / 2, item.radius_cm)
    else:
        half = (item.radius_cm, item.radius_cm, item.radius_cm if isinstance(item, Sphere) else 0.0)
    return np.zeros(3), np.multiply(half, 1e-2)


# --- meshes --------------------------------------------------------------------------------------


class MeshData:
    """Triangles of a mesh file: ``vertices`` [n, 3] metres, ``faces`` [m, 3], ``uv`` [n, 2] or None."""

    def __init__(self, vertices: FloatArray, faces: NDArray[np.uint32], uv: FloatArray | None) -> None:
        self.vertices, self.faces, self.uv = vertices, faces, uv


def load_mesh(item: Mesh, folder: Path) -> MeshData:
    """Read a mesh file through trimesh; InputError where it is missing, broken or has no faces."""
    path = folder / item.file
    if not path.is_file():
        raise InputError(f"object '{item.name}': mesh {path}: no such file")
    stamp = path.stat()
    return _load_mesh_file(path, item.unit_cm * 1e-2, item.name, (stamp.st_mtime_ns, stamp.st_size))


@lru_cache(maxsize=16)
def _load_mesh_file(path: Path, unit_m: float, name: str, stamp: tuple[int, int]) -> MeshData:
    import trimesh

    where = f"object '{name}': mesh {path}"
    try:
        mesh = trimesh.load(path, force="mesh", process=False)
        vertices = np.array(mesh.vertices, dtype=np.float64) * unit_m
        faces = np.array(mesh.faces, dtype=np.uint32)
    except Exception as error:  # trimesh raises whatever its parsers stumble over
        raise InputError(f"{where}: does not load ({error}); allowed are OBJ, PLY, GLB, STL, OFF") from None
    if len(faces) == 0 or len(vertices) == 0:
        raise InputError(f"{where}: has no faces")
    if not np.isfinite(vertices).all() or faces.max() >= len(vertices):
        raise InputError(f"{where}: has vertices that are not finite, or faces without their vertices")
    uv = getattr(mesh.visual, "uv", None)
    return MeshData(vertices, faces, None if uv is None else np.array(uv, dtype=np.float64))
