"""The objects of a scene as data, and where they stand.

Lengths of a specification are centimetres and angles degrees; everything computed from it is in metres.
"""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from dasim.base.errors import InputError
from dasim.base.toml import Specification
from dasim.scene import meshes
from dasim.scene.procedural.library import PREFIX, procedural
from dasim.typing import FloatArray

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


class HeightField(_Placed):
    """A relief that faces the camera (-z) when not rotated, seen and textured as a plane.

    ``image`` is a grey picture; where it is white (its largest value, as written in the file) the surface lies
    ``height_cm`` nearer than where it is black.
    """

    shape: Literal["heightfield"]
    image: str = Field(description="a file beside the scene, or skimage:NAME")
    size_cm: tuple[Positive, Positive]
    height_cm: Positive


class Mesh(_Placed):
    """A mesh file (OBJ, PLY, GLB, STL, OFF) or ``procedural:NAME``, ``unit_cm`` the length of its unit.

    Without a material the file's own RGB colours are used, and ``near_infrared`` says what they are in the
    near-infrared (``dasim.materials.photographs.NEAR_INFRARED_RULES``), which RGB leaves open.
    """

    shape: Literal["mesh"]
    file: str = Field(description="a file beside the scene, procedural:NAME or procedural:NAME:SEED")
    unit_cm: Positive = 1.0
    material: str | None = None  # type: ignore[assignment]  # the only object that may have colours of its own
    near_infrared: str | None = None

    @model_validator(mode="after")
    def _one_surface(self) -> Mesh:
        if self.material is not None and self.near_infrared is not None:
            raise ValueError("near_infrared is for a mesh with colours of its own; this one has a material")
        return self


Object = Annotated[Plane | Disc | Box | Sphere | Cylinder | HeightField | Mesh, Field(discriminator="shape")]


# --- geometry ------------------------------------------------------------------------------------


def placement(item: Object) -> FloatArray:
    """Transform of an object's unscaled local axes into scene coordinates, metres, [4, 4]."""
    placed = np.eye(4)
    placed[:3, :3] = rotation(item.rotation_deg)
    placed[:3, 3] = np.multiply(item.position_cm, 1e-2)
    return placed


def rotation(degrees: Vector) -> FloatArray:
    """Rotation about x, then y, then z, [3, 3]."""
    x, y, z = np.radians(degrees)
    about_x = np.array([[1, 0, 0], [0, np.cos(x), -np.sin(x)], [0, np.sin(x), np.cos(x)]])
    about_y = np.array([[np.cos(y), 0, np.sin(y)], [0, 1, 0], [-np.sin(y), 0, np.cos(y)]])
    about_z = np.array([[np.cos(z), -np.sin(z), 0], [np.sin(z), np.cos(z), 0], [0, 0, 1]])
    return about_z @ about_y @ about_x


def half_extent_m(item: Object, folder: Path) -> tuple[FloatArray, FloatArray]:
    """Centre and half size of an object's box in its local axes, metres."""
    if isinstance(item, Mesh):
        parts = mesh_parts(item, folder)
        low = np.min([part.vertices.min(axis=0) for part in parts], axis=0)
        high = np.max([part.vertices.max(axis=0) for part in parts], axis=0)
        return (low + high) / 2, (high - low) / 2
    if isinstance(item, HeightField):
        half = np.multiply((*item.size_cm, item.height_cm), 0.5e-2)
        return np.array([0.0, 0.0, -half[2]]), half
    if isinstance(item, Plane):
        half = np.array([item.size_cm[0] / 2, item.size_cm[1] / 2, 0.0])
    elif isinstance(item, Box):
        half = np.array(item.size_cm) / 2
    elif isinstance(item, Cylinder):
        half = np.array([item.radius_cm, item.height_cm / 2, item.radius_cm])
    else:
        half = np.array([item.radius_cm, item.radius_cm, item.radius_cm if isinstance(item, Sphere) else 0.0])
    return np.zeros(3), half * 1e-2


# --- triangles -----------------------------------------------------------------------------------


def mesh_parts(item: Mesh, folder: Path) -> tuple[meshes.Part, ...]:
    """What a mesh's file holds; InputError where it is missing, broken or has no faces."""
    if item.file.startswith(PREFIX):
        return _procedural_parts(item.file, item.unit_cm, item.name)
    return meshes.read(folder / item.file, item.unit_cm * 1e-2, mesh_place(item, folder))


@lru_cache(maxsize=32)
def _procedural_parts(file: str, unit_cm: float, name: str) -> tuple[meshes.Part, ...]:
    try:
        made = procedural(file.removeprefix(PREFIX))
    except InputError as error:
        raise InputError(f"object '{name}': {error}") from None
    return (meshes.Part(made.vertices * (unit_cm * 1e-2), made.faces, made.uv, made.normals),)


def mesh_place(item: Mesh, folder: Path) -> str:
    """How an error names a mesh and its file."""
    where = item.file if item.file.startswith(PREFIX) else folder / item.file
    return f"object '{item.name}': mesh {where}"


def relief(item: HeightField, heights: NDArray[np.float32]) -> meshes.Part:
    """Triangles of a height field, from the values [rows, columns] 0..1 of its picture's pixels, top row first.

    A value stands at its pixel's centre; between, the surface is that of two triangles per cell, and beyond the
    outermost centres it goes on level. Texture coordinates are a plane's.
    """
    u, down = np.meshgrid(*(np.array([0, *(np.arange(n) + 0.5) / n, 1]) for n in heights.shape[::-1]))
    rows, columns = u.shape
    width, height, depth = np.multiply((*item.size_cm, item.height_cm), 1e-2)
    z = -depth * np.pad(heights.astype(np.float64), 1, mode="edge")
    vertices = np.stack([(u - 0.5) * width, (down - 0.5) * height, z], axis=-1)
    first = (np.arange(rows - 1)[:, None] * columns + np.arange(columns - 1)).ravel()
    # Corners run counter-clockwise as seen from the camera: normals towards -z.
    right, below, across = first + 1, first + columns, first + columns + 1
    faces = np.concatenate([np.stack([first, across, right], -1), np.stack([first, below, across], -1)])
    uv = np.stack([u, 1 - down], axis=-1)
    return meshes.Part(vertices.reshape(-1, 3), faces.astype(np.uint32), uv.reshape(-1, 2))
