"""The scene: objects, materials and lights as data, read from TOML.

Scene coordinates are x right, y down, z forward, in centimetres; angles in degrees. The camera stands at
the origin and looks along z unless ``view`` says otherwise.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, field_validator, model_validator

from dasim import illuminants, panorama
from dasim.camera import Camera, refocused
from dasim.errors import InputError
from dasim.lights import Light, Near, Positive, Vector
from dasim.materials import Texture, material_names, surface
from dasim.shapes import Box, Mesh, Object, Sphere, half_extent_m, load_mesh, placement
from dasim.specification import Specification, bundled_or_file, parse_toml

FloatArray = NDArray[np.float64]

_HERE = Path(__file__).parent
SCENE_DIR = _HERE / "scenes" if (_HERE / "scenes").is_dir() else _HERE.parent / "scenes"


class View(Specification):
    """Where the camera stands and what it looks at; the picture's down is as near to y as possible."""

    position_cm: Vector = (0.0, 0.0, 0.0)
    look_at_cm: Vector = (0.0, 0.0, 1.0)

    @model_validator(mode="after")
    def _looks_somewhere(self) -> View:
        forward = np.subtract(self.look_at_cm, self.position_cm)
        if np.linalg.norm(np.cross(forward, (0.0, 1.0, 0.0))) < 1e-9 * max(1.0, float(np.linalg.norm(forward))):
            raise ValueError("look_at_cm must differ from position_cm and not lie straight above or below it")
        return self


class Scene(Specification):
    """Objects and lights; ``folder`` is where its images and meshes lie."""

    name: str
    description: str = ""
    focus_cm: Positive | None = Field(default=None, description="proposed focus; the camera owns the focus")
    view: View = View()
    materials: dict[str, Texture] = Field(default_factory=dict)
    lights: tuple[Light, ...] = Field(min_length=1)
    objects: tuple[Object, ...] = Field(min_length=1)
    folder: Path = Path(".")

    @field_validator("objects")
    @classmethod
    def _unique_names(cls, objects: tuple[Object, ...]) -> tuple[Object, ...]:
        names = [item.name for item in objects]
        twice = sorted({name for name in names if names.count(name) > 1})
        if twice:
            raise ValueError(f"object names must be unique; used twice: {', '.join(twice)}")
        return objects


def scene_names() -> list[str]:
    """Names of the bundled scenes."""
    return sorted(path.stem for path in SCENE_DIR.glob("*.toml"))


def load_scene(name_or_path: str | Path) -> Scene:
    """The scene of a bundled name or a TOML file; InputError names everything that is wrong with it."""
    path = bundled_or_file(name_or_path, SCENE_DIR, "scene")
    scene = parse_toml(Scene, path).model_copy(update={"folder": path.parent.resolve()})
    _check(scene, str(path))
    return scene


def focused(camera: Camera, scene: Scene) -> Camera:
    """The camera focused where the scene proposes, or unchanged where it proposes nothing."""
    return camera if scene.focus_cm is None else refocused(camera, scene.focus_cm * 1e-2)


def main_illuminant(scene: Scene) -> str:
    """Name of the illuminant that gives the most lux."""
    return max(scene.lights, key=lambda light: light.lux).illuminant


def light_spectrum(scene: Scene) -> FloatArray:
    """Spectral power of all lights together, weighted by their lux, on the wavelength grid."""
    parts = [light.lux * illuminants.illuminant(light.illuminant) for light in scene.lights]
    return np.asarray(np.sum(parts, axis=0))


# --- geometry ------------------------------------------------------------------------------------


def object_to_camera(item: Object, scene: Scene) -> FloatArray:
    """Transform of an object's unscaled local axes into camera axes, metres, [4, 4].

    Local lengths are metres; a mesh's own units are scaled where it is read.
    """
    return world_to_camera(scene) @ placement(item)


def world_to_camera(scene: Scene) -> FloatArray:
    """Transform of scene coordinates (metres) into camera axes, [4, 4]."""
    position, target = np.multiply(scene.view.position_cm, 1e-2), np.multiply(scene.view.look_at_cm, 1e-2)
    forward = (target - position) / np.linalg.norm(target - position)
    right = np.cross((0.0, 1.0, 0.0), forward)
    right /= np.linalg.norm(right)
    matrix = np.eye(4)
    matrix[:3, :3] = np.stack([right, np.cross(forward, right), forward])
    matrix[:3, 3] = -matrix[:3, :3] @ position
    return matrix


# --- checks that need more than one key ----------------------------------------------------------

LENS_CLEARANCE_M = 1e-3
PUPIL_POINTS = 24


def _check(scene: Scene, where: str) -> None:
    """Materials, illuminants, images and meshes exist, and no object is behind or on the lens."""
    problems: list[str] = []
    for index, light in enumerate(scene.lights):
        problems += [f"lights.{index} ({light.kind}): {problem}" for problem in _light_problems(light, scene)]
    for name, texture in scene.materials.items():
        try:
            surface(texture, scene.folder)
        except InputError as error:
            problems.append(f"material '{name}': {error}")
    known = set(material_names()) | set(scene.materials)
    for item in scene.objects:
        if item.material not in known:
            names = ", ".join(sorted(known))
            problems.append(f"object '{item.name}': material '{item.material}' is unknown ({names})")
        if isinstance(item, Mesh) and item.material in scene.materials:
            problems += _texture_problems(item, scene)
        try:
            problems += _placement_problems(item, scene)
        except InputError as error:
            problems.append(str(error))
    if problems:
        raise InputError(f"{where}: " + "; ".join(problems))


def _light_problems(light: Light, scene: Scene) -> list[str]:
    """An unknown illuminant, a bad image, or a lamp inside a solid object, where nobody sees its light."""
    found = []
    for check in (lambda: illuminants.illuminant(light.illuminant), lambda: panorama.check(light, scene.folder)):
        try:
            check()
        except InputError as error:
            found.append(str(error))
    if not isinstance(light, Near):
        return found
    for item in scene.objects:
        if isinstance(item, (Box, Sphere)):
            _, half = half_extent_m(item, scene.folder)
            place = np.linalg.inv(placement(item)) @ [*np.multiply(light.position_cm, 1e-2), 1.0]
            share = np.abs(place[:3]) / half
            if (np.linalg.norm(share) if isinstance(item, Sphere) else share.max()) < 1:
                found.append(f"position_cm lies inside object '{item.name}'; move one of them")
    return found


def _texture_problems(item: Mesh, scene: Scene) -> list[str]:
    try:
        if load_mesh(item, scene.folder).uv is None:
            return [
                f"object '{item.name}': mesh {item.file} has no texture coordinates "
                f"for the material '{item.material}'; give it some, or one of the plain materials"
            ]
    except InputError:
        pass  # reported with the placement
    return []


def check_clear(scene: Scene, pupil_radius_m: float) -> None:
    """InputError where an object reaches into the lens of the camera that is going to be used."""
    problems = [p for item in scene.objects for p in _placement_problems(item, scene, pupil_radius_m)]
    if problems:
        raise InputError(f"scene '{scene.name}': " + "; ".join(problems))


def _placement_problems(item: Object, scene: Scene, pupil_radius_m: float = 0.0) -> list[str]:
    centre, half = half_extent_m(item, scene.folder)
    to_camera = object_to_camera(item, scene)
    nearest_corner = centre + np.array(np.meshgrid(*[(-1, 1)] * 3)).reshape(3, -1).T * half
    depths = nearest_corner @ to_camera[2, :3] + to_camera[2, 3]
    if depths.max() <= 0:
        return [f"object '{item.name}': lies behind the lens (z up to {depths.max() * 100:.3g} cm, must be above 0)"]
    # The pupil's centre and rim, seen from the object; its box is widened by the clearance.
    turns = np.linspace(0.0, 2 * np.pi, PUPIL_POINTS, endpoint=False)
    rim = np.stack([np.cos(turns), np.sin(turns), np.zeros(PUPIL_POINTS)], axis=-1) * pupil_radius_m
    pupil = np.vstack([np.zeros(3), rim / 2, rim])
    to_local = np.linalg.inv(to_camera)
    inside = np.abs(pupil @ to_local[:3, :3].T + to_local[:3, 3] - centre) <= half + LENS_CLEARANCE_M
    if inside.all(axis=-1).any():
        return [f"object '{item.name}': lies on the lens or around it; move it to z above 0"]
    return []
