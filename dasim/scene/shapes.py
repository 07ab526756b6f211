"""The objects of a scene as data, and their geometry.

Specifications are in centimetres and degrees; everything computed from them is in metres.
"""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import ConfigDict, Field, model_validator

from dasim.base.errors import InputError
from dasim.base.toml import Specification
from dasim.scene import meshes
from dasim.scene.classes import ClassName
from dasim.scene.procedural.library import PREFIX, procedural
from dasim.typing import FloatArray

FARTHEST_CM = 1e7  # 100 km, of a place or a length
Coordinate = Annotated[float, Field(ge=-FARTHEST_CM, le=FARTHEST_CM)]
Vector = tuple[Coordinate, Coordinate, Coordinate]
Angle = Annotated[float, Field(ge=-360, le=360)]
Length = Annotated[float, Field(gt=0, le=FARTHEST_CM)]


class _Body(Specification):
    model_config = ConfigDict(serialize_by_alias=True)

    name: str = Field(min_length=1)
    material: str
    class_name: ClassName | None = Field(
        default=None, alias="class", description="class in labels; by default that of the shape, or print for a print"
    )
    position_cm: Vector = (0.0, 0.0, 0.0)
    rotation_deg: tuple[Angle, Angle, Angle] = Field(
        default=(0.0, 0.0, 0.0), description="degrees about x, then y, then z"
    )


class Plane(_Body):
    """A rectangle, ``size_cm`` along x and y, that faces the camera (-z) when not rotated."""

    shape: Literal["plane"]
    size_cm: tuple[Length, Length]


class Disc(_Body):
    """A disc that faces the camera (-z) when not rotated."""

    shape: Literal["disc"]
    radius_cm: Length


class Box(_Body):
    """A box, ``size_cm`` along x, y, z."""

    shape: Literal["box"]
    size_cm: tuple[Length, Length, Length]


class Sphere(_Body):
    """A sphere; the poles of its texture lie at the top and the bottom."""

    shape: Literal["sphere"]
    radius_cm: Length


class Cylinder(_Body):
    """A cylinder without caps; its axis is y and its origin the middle of the axis."""

    shape: Literal["cylinder"]
    radius_cm: Length
    height_cm: Length


class HeightField(_Body):
    """A relief that faces the camera (-z) when not rotated, with the texture coordinates of a plane.

    ``image`` is a grey picture whose values are heights without decoding: white (the largest value of its data type)
    lies ``height_cm`` nearer to the camera than black.
    """

    shape: Literal["heightfield"]
    image: str = Field(description="a file beside the scene, or skimage:NAME")
    size_cm: tuple[Length, Length]
    height_cm: Length


class Mesh(_Body):
    """A mesh file (OBJ, PLY, GLB, STL, OFF) or ``procedural:NAME``; ``unit_cm`` is the length of its unit.

    Without a material it has the RGB colours of its file, and ``near_infrared`` names the rule that extends them beyond
    the visible (one of ``dasim.materials.photographs.NEAR_INFRARED_RULES``).
    """

    shape: Literal["mesh"]
    file: str = Field(description="a file beside the scene, procedural:NAME or procedural:NAME:SEED")
    unit_cm: Length = 1.0
    material: str | None = None  # type: ignore[assignment]  # only meshes may have colours of their own
    near_infrared: str | None = None

    @model_validator(mode="after")
    def _one_surface(self) -> Mesh:
        if self.material is not None and self.near_infrared is not None:
            raise ValueError("near_infrared is for a mesh with colours of its own; this one has a material")
        return self


Object = Annotated[Plane | Disc | Box | Sphere | Cylinder | HeightField | Mesh, Field(discriminator="shape")]


# --- geometry ------------------------------------------------------------------------------------


def placement(item: Object) -> FloatArray:
    """Rigid transform [4, 4] of an object's local axes into scene coordinates, both in metres."""
    matrix = np.eye(4)
    matrix[:3, :3] = rotation(item.rotation_deg)
    matrix[:3, 3] = np.multiply(item.position_cm, 1e-2)
    return matrix


def rotation(degrees: tuple[float, float, float]) -> FloatArray:
    """Rotation matrix [3, 3] about x, then y, then z, right-handed, of angles in degrees."""
    x, y, z = np.radians(degrees)
    about_x = np.array([[1, 0, 0], [0, np.cos(x), -np.sin(x)], [0, np.sin(x), np.cos(x)]])
    about_y = np.array([[np.cos(y), 0, np.sin(y)], [0, 1, 0], [-np.sin(y), 0, np.cos(y)]])
    about_z = np.array([[np.cos(z), -np.sin(z), 0], [np.sin(z), np.cos(z), 0], [0, 0, 1]])
    return about_z @ about_y @ about_x


def half_extent_m(item: Object, folder: Path) -> tuple[FloatArray, FloatArray]:
    """Centre [3] and half size [3] of an object's bounding box in its local axes, metres."""
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
    """Parts of a mesh object in its local axes, metres; raises InputError if its file is missing, broken or empty."""
    if item.file.startswith(PREFIX):
        return _procedural_mesh(item.file, item.unit_cm, item.name)
    return meshes.read(folder / item.file, item.unit_cm * 1e-2, mesh_place(item, folder))


@lru_cache(maxsize=16)
def _procedural_mesh(file: str, unit_cm: float, name: str) -> tuple[meshes.Part, ...]:
    try:
        mesh = procedural(file.removeprefix(PREFIX))
    except InputError as error:
        raise InputError(f"object '{name}': {error}") from None
    return (meshes.Part(mesh.vertices * (unit_cm * 1e-2), mesh.faces, mesh.uv, mesh.normals),)


def mesh_place(item: Mesh, folder: Path) -> str:
    """Name of a mesh object and its file for error messages."""
    where = item.file if item.file.startswith(PREFIX) else folder / item.file
    return f"object '{item.name}': mesh {where}"


def relief(item: HeightField, heights: NDArray[np.float32]) -> meshes.Part:
    """Triangles of a height field from the pixel values [rows, columns] 0..1 of its picture, top row first.

    Values stand at pixel centres, joined by two triangles per cell; from the outermost centres to the rim the surface
    continues at constant height. Texture coordinates are those of a plane.
    """
    u, down = np.meshgrid(*(np.array([0, *(np.arange(n) + 0.5) / n, 1]) for n in heights.shape[::-1]))
    rows, columns = u.shape
    width, height, depth = np.multiply((*item.size_cm, item.height_cm), 1e-2)
    z = -depth * np.pad(heights.astype(np.float64), 1, mode="edge")
    vertices = np.stack([(u - 0.5) * width, (down - 0.5) * height, z], axis=-1)
    first = (np.arange(rows - 1)[:, None] * columns + np.arange(columns - 1)).ravel()
    # Corners run counter-clockwise as seen from the camera, so that normals point towards -z.
    right, below, across = first + 1, first + columns, first + columns + 1
    faces = np.concatenate([np.stack([first, across, right], -1), np.stack([first, below, across], -1)])
    uv = np.stack([u, 1 - down], axis=-1)
    return meshes.Part(vertices.reshape(-1, 3), faces.astype(np.uint32), uv.reshape(-1, 2))
