"""The scene as data, read from TOML: objects, materials, lights and the camera's position.

Scene coordinates are x right, y down, z forward, in centimetres; angles are in degrees. By default the camera stands at
the origin and looks along z; ``view`` changes that.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from pydantic import Field, field_validator, model_validator

from dasim.base.toml import Specification
from dasim.camera.specification import Camera, refocused
from dasim.materials.library import Texture
from dasim.scene.lights import Light
from dasim.scene.mitsuba_scene import MitsubaScene
from dasim.scene.shapes import Length, Object, Vector, placement
from dasim.spectra import illuminants
from dasim.typing import FloatArray


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


def light_level(scene: Scene | MitsubaScene) -> float:
    """Sum of the ``lux`` of all lights; 1 for a Mitsuba scene, whose lights have none."""
    return sum(light.lux for light in scene.lights) if isinstance(scene, Scene) else 1.0


def at_light_level(scene: Scene, lux: float) -> Scene:
    """The scene with every light scaled by one factor, so that their ``lux`` have this sum."""
    factor = lux / light_level(scene)
    lights = tuple(light.model_copy(update={"lux": light.lux * factor}) for light in scene.lights)
    return scene.model_copy(update={"lights": lights})


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
