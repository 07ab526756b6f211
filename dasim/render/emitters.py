"""Lights as Mitsuba's emitters, in camera axes."""

from __future__ import annotations

from typing import Any

import numpy as np

from dasim import illuminants, panorama
from dasim import lights as lighting
from dasim import scene as scenes
from dasim.lights import SUN_DIAMETER_DEG, Bulb, Dome, Light, Near, Panel, Sky, Sun, Surrounding
from dasim.render.plugin import spectrum_dict, transform
from dasim.render.surrounding import Layer, surrounding_dict
from dasim.scene import Scene
from dasim.spectra import FloatArray

SUN_DISTANCE_M = 1e4  # across 10 m of scene its direction changes by a tenth of its diameter


def emitters(scene: Scene) -> dict[str, Any]:
    """Mitsuba's emitters of a scene's lights by name; those from all around are one, which is all Mitsuba takes."""
    found: dict[str, Any] = {}
    around: list[Surrounding] = []
    for index, light in enumerate(scene.lights):
        for part in lighting.parts(light):
            if isinstance(part, Surrounding):
                around.append(part)
            elif isinstance(part, Sun):
                found[f"light_{index:04d}"] = _sun(part, scene)
            else:
                found[f"light_{index:04d}"] = _near(part, scene)
    if around:
        aimed = any(_worth_aiming_at(light) for light in around)
        # Reflected rays find a dome that is everywhere; aiming at it as well would only add noise (tenfold).
        # Mitsuba needs one light to aim at, though.
        weight = {} if aimed or not found else {"sampling_weight": 0.0}
        found["light_around"] = _surrounding(around, scene) | weight
    return found


def _worth_aiming_at(light: Light) -> bool:
    """Whether a light from all around has bright places that reflected rays would seldom find."""
    return not (isinstance(light, Dome) or (isinstance(light, Sky) and light.distribution != "clear"))


def _surrounding(around: list[Surrounding], scene: Scene) -> dict[str, Any]:
    powers = [light.lux * illuminants.illuminant(light.illuminant) for light in around]
    if all(isinstance(light, Dome) for light in around):
        return {"type": "constant", "radiance": spectrum_dict(np.sum(powers, axis=0) / np.pi)}
    layers = []
    for light, power in zip(around, powers, strict=True):
        to_world = np.eye(4)
        to_world[:3, :3] = scenes.world_to_camera(scene)[:3, :3] @ panorama.rotation(light)
        layers.append(Layer(panorama.radiance_per_lux(light, scene.folder), power, to_world))
    return surrounding_dict(tuple(layers))


def _sun(light: Sun, scene: Scene) -> dict[str, Any]:
    """A far disc that faces the scene's origin."""
    towards = lighting.direction(light.elevation_deg, light.azimuth_deg)
    sine = float(np.sin(np.radians(SUN_DIAMETER_DEG / 2)))
    radius = SUN_DISTANCE_M * sine / np.sqrt(1 - sine**2)
    facing = _facing(SUN_DISTANCE_M * towards, np.zeros(3)) @ np.diag([radius, radius, 1.0, 1.0])
    power = light.lux * illuminants.illuminant(light.illuminant)
    return _glowing("disk", facing, power / (np.pi * sine**2), scene)


def _near(light: Near, scene: Scene) -> dict[str, Any]:
    position, target = (np.multiply(p, 1e-2) for p in (light.position_cm, light.target_cm))
    radiance = light.lux * illuminants.illuminant(light.illuminant) * lighting.radiance_per_lux(light)
    if isinstance(light, Panel):
        width, height = (side * 1e-2 for side in light.size_cm)
        return _glowing(
            "rectangle", _facing(position, target) @ np.diag([width / 2, height / 2, 1.0, 1.0]), radiance, scene
        )
    radius = light.radius_cm * 1e-2
    if isinstance(light, Bulb):
        return _glowing("sphere", _facing(position, target) @ np.diag([radius, radius, radius, 1.0]), radiance, scene)
    return _glowing("disk", _facing(position, target) @ np.diag([radius, radius, 1.0, 1.0]), radiance, scene)


def _glowing(shape: str, to_scene: FloatArray, radiance: FloatArray, scene: Scene) -> dict[str, Any]:
    """A shape that emits on its +z side, placed in scene coordinates."""
    return {
        "type": shape,
        "to_world": transform(scenes.world_to_camera(scene) @ to_scene),
        "emitter": {"type": "area", "radiance": spectrum_dict(radiance)},
    }


def _facing(position: np.ndarray, target: np.ndarray) -> np.ndarray:
    """Transform that puts the origin at ``position`` with +z towards ``target`` and +x level where that can be."""
    forward = (target - position) / np.linalg.norm(target - position)
    helper = np.array([0.0, 1.0, 0.0]) if abs(forward[1]) < 0.9 else np.array([1.0, 0.0, 0.0])
    right = np.cross(helper, forward)
    right /= np.linalg.norm(right)
    matrix = np.eye(4)
    matrix[:3, :3] = np.stack([right, np.cross(forward, right), forward], axis=1)
    matrix[:3, 3] = position
    return matrix
