"""Lights as Mitsuba's emitters, in camera axes.

Tested in tests/dasim/render/test_lights.py.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from dasim.render.plugin import spectrum_dict, transform
from dasim.render.surrounding import Layer, surrounding_dict
from dasim.scene import lights as lighting
from dasim.scene import panorama
from dasim.scene import specification as scenes
from dasim.scene.lights import SUN_DIAMETER_DEG, Bulb, Dome, Environment, Near, Panel, Sky, Sun, Surrounding
from dasim.scene.specification import Scene
from dasim.spectra import illuminants
from dasim.typing import FloatArray

SUN_DISTANCE_M = 1e4  # across 10 m of scene its direction changes by a tenth of its diameter


def emitters(scene: Scene) -> dict[str, Any]:
    """Mitsuba's emitters of a scene's lights by name; those from all around are one, which is all Mitsuba takes."""
    found: dict[str, Any] = {}
    parts = [(index, part) for index, light in enumerate(scene.lights) for part in lighting.parts(light)]
    around = [(index, part) for index, part in parts if isinstance(part, Surrounding)]
    aimed = [(index, part) for index, part in parts if not isinstance(part, Surrounding)]
    for index, part in aimed:
        found[f"light_{index:04d}"] = _sun(part, scene) if isinstance(part, Sun) else _near(part, scene)
    if around:
        sun = any(isinstance(part, Sun) for _, part in aimed)
        uneven = sum(part.lux for _, part in around if _is_uneven(part, sun))
        # Mitsuba needs one light to aim at. Beside others, what is uneven is aimed at as often as it matters.
        weight = {"sampling_weight": float(uneven / np.mean([part.lux for _, part in aimed]))} if aimed else {}
        name = f"light_{around[0][0]:04d}"
        found[f"{name}_sky" if name in found else name] = _surrounding([part for _, part in around], scene) | weight
    return found


def _is_uneven(light: Surrounding, sun: bool) -> bool:
    """Whether a light from all around has bright places that reflected rays would seldom find.

    Those find a dome or an even sky everywhere: aiming at it as well would only add noise (tenfold). A clear sky
    beside the sun is a small part of the light, and choosing between both would add more noise than it saves.
    """
    if isinstance(light, Sky):
        return light.distribution == "clear" and not sun
    return isinstance(light, Environment)


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
