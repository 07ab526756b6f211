"""Lights as Mitsuba's emitters, in camera axes."""

from __future__ import annotations

from typing import Any

import numpy as np

from dasim import illuminants
from dasim import scene as scenes
from dasim.lights import Dome, Lamp
from dasim.render.plugin import spectrum_dict, transform
from dasim.scene import Scene


def emitter(light: Dome | Lamp, scene: Scene, lamps: bool) -> dict[str, Any]:
    """Mitsuba's emitter of a light; ``lamps`` says whether the scene has any light that can be aimed at."""
    power = light.lux * illuminants.illuminant(light.illuminant)
    if isinstance(light, Dome):
        # Reflected rays find a dome that is everywhere; aiming at it as well would only add noise (tenfold).
        # Mitsuba needs one light to aim at, though.
        weight = {"sampling_weight": 0.0} if lamps else {}
        return {"type": "constant", "radiance": spectrum_dict(power / np.pi), **weight}
    position, target = (np.multiply(p, 1e-2) for p in (light.position_cm, light.target_cm))
    radius, distance = light.radius_cm * 1e-2, float(np.linalg.norm(target - position))
    # On its axis a disc of radiance L gives E = pi L r^2 / (r^2 + d^2).
    radiance = power * (radius**2 + distance**2) / (np.pi * radius**2)
    facing = _facing(position, target) @ np.diag([radius, radius, 1.0, 1.0])
    return {
        "type": "disk",
        "to_world": transform(scenes.world_to_camera(scene) @ facing),
        "emitter": {"type": "area", "radiance": spectrum_dict(radiance)},
    }


def _facing(position: np.ndarray, target: np.ndarray) -> np.ndarray:
    """Transform that puts the origin at ``position`` with +z towards ``target``."""
    forward = (target - position) / np.linalg.norm(target - position)
    helper = np.array([0.0, 1.0, 0.0]) if abs(forward[1]) < 0.9 else np.array([1.0, 0.0, 0.0])
    right = np.cross(helper, forward)
    right /= np.linalg.norm(right)
    matrix = np.eye(4)
    matrix[:3, :3] = np.stack([right, np.cross(forward, right), forward], axis=1)
    matrix[:3, 3] = position
    return matrix
