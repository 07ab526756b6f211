"""The scene as data, read from TOML: objects, materials, lights and the camera's position.

Scene coordinates are x right, y down, z forward, in centimetres; angles are in degrees. By default the camera stands at
the origin and looks along z; ``view`` changes that.
"""

from __future__ import annotations

import tomllib
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, field_validator, model_validator

from dasim.base.errors import InputError
from dasim.base.suggestions import did_you_mean
from dasim.base.toml import Specification, bundled_or_file, parse_toml
from dasim.camera.specification import Camera, refocused
from dasim.materials.library import Glass, Surface, Texture, is_textured, material_names, surface, unknown
from dasim.materials.photographs import NEAR_INFRARED_RULES, mask, photograph_surface
from dasim.materials.surfaces import Diffuse, Finished, Mixture
from dasim.scene import mesh_merging, meshes, panorama
from dasim.scene.classes import class_of
from dasim.scene.clearance import placement_problems, size_problems
from dasim.scene.lights import Light, Near
from dasim.scene.mitsuba_scene import MitsubaScene
from dasim.scene.shapes import (
    Box,
    HeightField,
    Length,
    Mesh,
    Object,
    Sphere,
    Vector,
    half_extent_m,
    mesh_parts,
    mesh_place,
    placement,
)
from dasim.spectra import illuminants
from dasim.typing import FloatArray

_HERE = Path(__file__).parents[1]
SCENE_DIR = _HERE / "scenes" if (_HERE / "scenes").is_dir() else _HERE.parent / "scenes"


class View(Specification):
    """Position of the camera, and a point on its optical axis; without roll, the picture's x axis is horizontal."""

    position_cm: Vector = (0.0, 0.0, 0.0)
    look_at_cm: Vector = (0.0, 0.0, 1.0)
    roll_deg: float = Field(
        default=0.0, ge=-360, le=360, description="turn about the optical axis, from the picture's x axis towards its y"
    )

    @model_validator(mode="after")
    def _has_direction(self) -> View:
        forward = np.subtract(self.look_at_cm, self.position_cm)
        if np.linalg.norm(np.cross(forward, (0.0, 1.0, 0.0))) < 1e-9 * max(1.0, float(np.linalg.norm(forward))):
            raise ValueError("look_at_cm must differ from position_cm and not lie straight above or below it")
        return self


class Scene(Specification):
    """A scene: its objects, lights and own materials; ``folder`` is where its images and meshes are looked up."""

    name: str
    description: str = ""
    focus_cm: Length | None = Field(default=None, description="proposed focus distance; the camera's own decides")
    view: View = View()
    materials: dict[str, Texture] = Field(default_factory=dict)
    lights: tuple[Light, ...] = Field(min_length=1)
    objects: tuple[Object, ...] = Field(min_length=1)
    folder: Path = Path(".")

    def __repr__(self) -> str:
        focus = "no focus proposed" if self.focus_cm is None else f"focus proposed at {self.focus_cm:g} cm"
        lights = ", ".join(dict.fromkeys(getattr(light, "illuminant", light.kind) for light in self.lights))
        return f"<Scene '{self.name}': {len(self.objects)} objects, {len(self.lights)} lights ({lights}), {focus}>"

    __str__ = __repr__

    @field_validator("objects")
    @classmethod
    def _unique_names(cls, objects: tuple[Object, ...]) -> tuple[Object, ...]:
        names = [item.name for item in objects]
        twice = sorted({name for name in names if names.count(name) > 1})
        if twice:
            raise ValueError(f"object names must be unique; used twice: {', '.join(twice)}")
        return objects


def scene_names() -> list[str]:
    """Sorted names of the bundled scenes; each is accepted wherever a scene is."""
    return sorted(path.stem for path in SCENE_DIR.glob("*.toml"))


def scene_descriptions() -> dict[str, str]:
    """Description of each bundled scene by name, read from its file without building the scene."""
    files = {name: SCENE_DIR / f"{name}.toml" for name in scene_names()}
    return {name: str(tomllib.loads(file.read_text(encoding="utf-8"))["description"]) for name, file in files.items()}


def load_scene(name_or_path: str | Path) -> Scene:
    """Load a bundled scene or a TOML file; InputError lists all problems of the scene."""
    path = bundled_or_file(name_or_path, SCENE_DIR, "scene")
    scene = parse_toml(Scene, path).model_copy(update={"folder": path.parent.resolve()})
    _check(scene, str(path))
    return scene


def focused(camera: Camera, scene: Scene) -> Camera:
    """The camera focused at the scene's ``focus_cm``, or unchanged where the scene has none."""
    return camera if scene.focus_cm is None else refocused(camera, scene.focus_cm * 1e-2)


def main_illuminant(scene: Scene | MitsubaScene) -> str:
    """Name of the illuminant of the light with the highest ``lux``; for a Mitsuba scene, that of its RGB lights."""
    if isinstance(scene, MitsubaScene):
        return scene.illuminant
    return max(scene.lights, key=lambda light: light.lux).illuminant


def light_spectrum(scene: Scene) -> FloatArray:
    """Relative spectral power of the sum of all lights, weighted by their ``lux``, [wavelength]."""
    parts = [light.lux * illuminants.illuminant(light.illuminant) for light in scene.lights]
    return np.asarray(np.sum(parts, axis=0))


# --- surfaces ------------------------------------------------------------------------------------


def material_of(item: Object) -> str:
    """Name of an object's material; a mesh with its file's colours counts as a material ``colours of NAME``."""
    return item.material or f"colours of {item.name}"


def surface_of(item: Object, scene: Scene) -> Surface:
    """Surface of an object: that of its material, or its mesh's own colours extended by its near-infrared rule."""
    if item.material is not None:
        return surface(scene.materials.get(item.material, item.material), scene.folder)
    assert isinstance(item, Mesh) and item.near_infrared is not None  # checked when the scene is loaded
    part = triangles(item, scene.folder)
    assert part.paint is not None
    base = photograph_surface(part.paint, item.near_infrared)
    if part.finish is None:
        return base
    assert isinstance(base, Diffuse | Mixture)  # as the rules give it
    metallic, roughness = (np.ascontiguousarray(part.finish[..., channel]) for channel in (0, 1))
    normal = np.ascontiguousarray(part.finish[..., 2:])
    return Finished(base, metallic, roughness, normal if np.any(normal != (0.5, 0.5, 1.0)) else None)


def triangles(item: Mesh, folder: Path) -> meshes.Part:
    """Triangles of a mesh object; without a material they carry a picture of its colours and the matching ``uv``."""
    parts = mesh_parts(item, folder)
    if item.material is not None:
        return mesh_merging.merge(parts)
    return mesh_merging.merge_with_colours(parts, mesh_place(item, folder))


def material_names_of(scene: Scene) -> list[str]:
    """Names of the materials of a scene's objects in order of first use; material number 1 is the first."""
    return list(dict.fromkeys(material_of(item) for item in scene.objects))


def material_number_of_object(scene: Scene) -> NDArray[np.uint32]:
    """Material number by ``object_id``, [1 + objects]: from 1 in the order of ``material_names_of``; 0 is no object."""
    names = material_names_of(scene)
    return np.array([0, *(names.index(material_of(item)) + 1 for item in scene.objects)], np.uint32)


def class_names_of(scene: Scene) -> list[str]:
    """Class of each of a scene's objects, in their order."""
    return [class_of(item, scene.materials) for item in scene.objects]


def colour_notes(scene: Scene) -> list[str]:
    """One line per mesh with RGB colours of its own: the kinds of colours, the finish and the near-infrared rule."""
    return [_colour_note(item, scene) for item in scene.objects if isinstance(item, Mesh) and item.material is None]


def _colour_note(item: Mesh, scene: Scene) -> str:
    parts = mesh_parts(item, scene.folder)
    metallic = [float(part.finish[..., 0].mean()) for part in parts if part.finish is not None]
    finish = f"a finish of the file (metallic {np.mean(metallic):.2g})" if metallic else "a matt material"
    return (
        f"object '{item.name}': RGB of {item.file} ({', '.join(mesh_merging.colour_kinds(parts))}) rendered as "
        f"{finish} by the near-infrared rule '{item.near_infrared}'"
    )


# --- geometry ------------------------------------------------------------------------------------


def object_to_camera(item: Object, scene: Scene) -> FloatArray:
    """Rigid transform [4, 4] of an object's local axes into camera axes, both in metres.

    A mesh's own unit is converted to metres where its file is read.
    """
    return world_to_camera(scene) @ placement(item)


def axes(view: View) -> FloatArray:
    """The camera's axes x (right), y (down) and z (forward) in scene coordinates, [3, 3], one per row."""
    forward = np.multiply(view.look_at_cm, 1e-2) - np.multiply(view.position_cm, 1e-2)
    forward /= np.linalg.norm(forward)
    right = np.cross((0.0, 1.0, 0.0), forward)
    right /= np.linalg.norm(right)
    down = np.cross(forward, right)
    if view.roll_deg:
        cosine, sine = np.cos(np.radians(view.roll_deg)), np.sin(np.radians(view.roll_deg))
        right, down = cosine * right + sine * down, cosine * down - sine * right
    return np.stack([right, down, forward])


def world_to_camera(scene: Scene) -> FloatArray:
    """Rigid transform [4, 4] of scene coordinates into camera axes, both in metres: OpenCV's extrinsic matrix."""
    matrix = np.eye(4)
    matrix[:3, :3] = axes(scene.view)
    matrix[:3, 3] = -matrix[:3, :3] @ np.multiply(scene.view.position_cm, 1e-2)
    return matrix


# --- checks across several keys ------------------------------------------------------------------


def _check(scene: Scene, where: str) -> None:
    """Raise InputError with all problems of a scene: missing materials, illuminants, images, meshes; bad positions."""
    problems: list[str] = []
    for index, light in enumerate(scene.lights):
        problems += [f"lights.{index} ({light.kind}): {problem}" for problem in _light_problems(light, scene)]
    surfaces: dict[str, Surface] = {}
    for name, texture in scene.materials.items():
        try:
            surfaces[name] = surface(texture, scene.folder)
        except InputError as error:
            problems.append(f"material '{name}': {error}")
    for item in scene.objects:
        for check in (_material_problems, _place_problems):
            try:
                problems += check(item, scene)
            except InputError as error:
                if str(error) not in problems:
                    problems.append(str(error))
        problems += _glass_problems(item, scene, surfaces)
        if isinstance(item, Mesh) and item.material in surfaces and is_textured(surfaces[item.material]):
            problems += _texture_problems(item, scene)
    if problems:
        raise InputError(f"{where}: " + "; ".join(problems))


def _material_problems(item: Object, scene: Scene) -> list[str]:
    if isinstance(item, HeightField):
        try:
            mask(item.image, scene.folder)
        except InputError as error:
            return [f"object '{item.name}': {error}"]
    if item.material is None:
        return _colour_problems(item, scene) if isinstance(item, Mesh) else []
    if item.material not in set(material_names()) | set(scene.materials):
        return [f"object '{item.name}': {unknown(item.material, scene.materials)}"]
    return []


def _glass_problems(item: Object, scene: Scene, surfaces: dict[str, Surface]) -> list[str]:
    """Problems of an object of solid glass, which must be closed: out of an open shape, refracted light would never
    exit.
    """
    material = surfaces.get(item.material or "")
    solid = isinstance(material, Glass) and not material.thin if material else item.material == "glass"
    if not solid or item.shape not in ("plane", "disc", "cylinder", "heightfield"):
        return []
    return [
        f"object '{item.name}': a {item.shape} is open and cannot be of solid glass (material '{item.material}'); "
        "use 'glass-pane' (or thin = true), or a box, sphere or closed mesh"
    ]


def _light_problems(light: Light, scene: Scene) -> list[str]:
    """Problems of a light: an unknown illuminant, an unusable image, or a position inside a box or sphere."""
    problems = []
    for check in (lambda: illuminants.illuminant(light.illuminant), lambda: panorama.check(light, scene.folder)):
        try:
            check()
        except InputError as error:
            problems.append(str(error))
    if not isinstance(light, Near):
        return problems
    for item in scene.objects:
        if isinstance(item, (Box, Sphere)):
            _, half = half_extent_m(item, scene.folder)
            place = np.linalg.inv(placement(item)) @ [*np.multiply(light.position_cm, 1e-2), 1.0]
            share = np.abs(place[:3]) / half
            if (np.linalg.norm(share) if isinstance(item, Sphere) else share.max()) < 1:
                problems.append(f"position_cm lies inside object '{item.name}'; move one of them")
    return problems


def _texture_problems(item: Mesh, scene: Scene) -> list[str]:
    try:
        if any(part.uv is None for part in mesh_parts(item, scene.folder)):
            return [
                f"object '{item.name}': mesh {item.file} has no texture coordinates "
                f"for the material '{item.material}'; add them to the file, or use a material without a texture"
            ]
    except InputError:
        pass  # reported with the placement
    return []


def _colour_problems(item: Mesh, scene: Scene) -> list[str]:
    """Problems of a mesh without a material: no colours, too many of them, or no valid near-infrared rule."""
    kinds = mesh_merging.colour_kinds(mesh_parts(item, scene.folder))
    rules = ", ".join(NEAR_INFRARED_RULES)
    if not kinds:
        return [f"object '{item.name}': mesh {item.file} has no colours of its own; give the object a material"]
    if item.near_infrared is None:
        return [
            f"object '{item.name}': mesh {item.file} has RGB colours ({', '.join(kinds)}), which do not determine the "
            f"near-infrared; choose a rule, near_infrared = {rules}, or give the object a material"
        ]
    if item.near_infrared not in NEAR_INFRARED_RULES:
        hint = did_you_mean(item.near_infrared, NEAR_INFRARED_RULES)
        return [f"object '{item.name}': near_infrared '{item.near_infrared}' is unknown; allowed are {rules}{hint}"]
    triangles(item, scene.folder)  # raises where the colours are too many
    return []


def _place_problems(item: Object, scene: Scene) -> list[str]:
    to_camera = object_to_camera(item, scene)
    return size_problems(item, scene.folder) + placement_problems(item, scene.folder, to_camera)


def check_clear(scene: Scene, pupil_radius_m: float) -> None:
    """Raise InputError if an object reaches into a lens opening of ``pupil_radius_m``, metres, or encloses it."""
    problems = [
        problem
        for item in scene.objects
        for problem in placement_problems(item, scene.folder, object_to_camera(item, scene), pupil_radius_m)
    ]
    if problems:
        raise InputError(f"scene '{scene.name}': " + "; ".join(problems))
