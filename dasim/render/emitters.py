"""Translation of a scene's lights into Mitsuba's emitters, in camera axes (x right, y down, z forward, metres).

Tested in tests/dasim/render/test_lights.py.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from dasim.render.plugin import instance, spectrum_dict, transform
from dasim.render.surrounding import Layer, surrounding_dict
from dasim.scene import lights as lighting
from dasim.scene import panorama
from dasim.scene import specification as scenes
from dasim.scene.lights import SUN_DIAMETER_DEG, Bulb, Dome, Environment, Near, Panel, Sky, Sun, Surrounding
from dasim.scene.specification import Scene
from dasim.spectra import illuminants
from dasim.spectra.grid import WAVELENGTH_NM
from dasim.typing import FloatArray

SUN_DISTANCE_M = 1e4  # over 10 m of scene the sun's direction changes by a tenth of its angular diameter


def emitters(scene: Scene) -> dict[str, Any]:
    """Mitsuba's emitters of a scene's lights, by name.

    All lights that surround the scene become one emitter, because Mitsuba allows a single environment. It is created
    first, so that it gets the lowest free number: the number is compiled into kernels.
    """
    parts = [(index, part) for index, light in enumerate(scene.lights) for part in lighting.parts(light)]
    distant = [(index, part) for index, part in parts if isinstance(part, Surrounding)]
    local = [(index, part) for index, part in parts if not isinstance(part, Surrounding)]
    around = _around([part for _, part in distant], [part for _, part in local], scene) if distant else None
    result: dict[str, Any] = {}
    for index, part in local:
        result[f"light_{index:04d}"] = _sun(part, scene) if isinstance(part, Sun) else _near_light(part, scene)
    if around is not None:
        name = f"light_{distant[0][0]:04d}"
        result[f"{name}_sky" if name in result else name] = around
    return result if len(result) > 1 else result | {"dark": dark_emitter()}


def _around(distant: list[Surrounding], local: list[Any], scene: Scene) -> Any:
    """The emitter of all surrounding lights of a scene whose other lights are ``local``."""
    sun = any(isinstance(part, Sun) for part in local)
    uneven = sum(part.lux for part in distant if _is_uneven(part, sun))
    # Where a surface samples a single emitter, the emitter is chosen in proportion to illuminance. Of the surroundings,
    # only the uneven part counts. Without other lights the weight stays 1, because Mitsuba needs an emitter to sample.
    weight = {"sampling_weight": uneven} if local else {}
    return instance(_environment(distant, scene) | weight)


def dark_emitter() -> dict[str, Any]:
    """An emitter without light that is never sampled; with it, a single light uses the code for several lights."""
    return {"type": "point", "intensity": spectrum_dict(np.zeros_like(WAVELENGTH_NM)), "sampling_weight": 0.0}


def _is_uneven(light: Surrounding, sun: bool) -> bool:
    """Whether a surrounding light has small bright parts, so that sampling its directions reduces the noise.

    BSDF sampling alone suffices for a dome or an even sky; emitter sampling in addition would increase the noise
    tenfold. Beside the sun a clear sky is a small part of the light, and sampling both would cost more noise than it
    saves.
    """
    if isinstance(light, Sky):
        return light.distribution == "clear" and not sun
    return isinstance(light, Environment)


def _environment(around: list[Surrounding], scene: Scene) -> dict[str, Any]:
    """One emitter of all surrounding lights: constant where all are domes, otherwise a sum of panoramas."""
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
    """A distant disc that faces the scene's origin, of radiance E / (pi sin^2 a) for the sun's angular radius a."""
    towards = lighting.direction(light.elevation_deg, light.azimuth_deg)
    sine = float(np.sin(np.radians(SUN_DIAMETER_DEG / 2)))
    radius = SUN_DISTANCE_M * sine / np.sqrt(1 - sine**2)
    to_scene = _look_at(SUN_DISTANCE_M * towards, np.zeros(3)) @ np.diag([radius, radius, 1.0, 1.0])
    power = light.lux * illuminants.illuminant(light.illuminant)
    return _area_light("disk", to_scene, power / (np.pi * sine**2), light.lux, scene)


def _near_light(light: Near, scene: Scene) -> dict[str, Any]:
    """A panel, bulb or lamp of finite distance as a rectangle, sphere or disc."""
    position, target = (np.multiply(p, 1e-2) for p in (light.position_cm, light.target_cm))
    radiance = light.lux * illuminants.illuminant(light.illuminant) * lighting.radiance_per_lux(light)
    if isinstance(light, Panel):
        width, height = (side * 1e-2 for side in light.size_cm)
        return _area_light(
            "rectangle",
            _look_at(position, target) @ np.diag([width / 2, height / 2, 1.0, 1.0]),
            radiance,
            light.lux,
            scene,
        )
    radius = light.radius_cm * 1e-2
    if isinstance(light, Bulb):
        return _area_light(
            "sphere", _look_at(position, target) @ np.diag([radius, radius, radius, 1.0]), radiance, light.lux, scene
        )
    return _area_light(
        "disk", _look_at(position, target) @ np.diag([radius, radius, 1.0, 1.0]), radiance, light.lux, scene
    )


def _area_light(shape: str, to_scene: FloatArray, radiance: FloatArray, lux: float, scene: Scene) -> Any:
    """An area light that emits on its +z side.

    Args:
        shape: name of Mitsuba's shape plugin.
        to_scene: transform from the shape's own axes to scene coordinates, [4, 4], metres.
        radiance: [wavelength], W m^-2 sr^-1 nm^-1.
        lux: relative weight with which it is drawn where one of several emitters is.
        scene: the scene, for its camera pose.
    """
    return area_light(shape, scenes.world_to_camera(scene) @ to_scene, radiance, lux)


def area_light(shape: str, to_camera: FloatArray, radiance: FloatArray, lux: float = 1.0) -> Any:
    """Mitsuba's shape, or its description, of an area light in camera axes; arguments as in :func:`_area_light`."""
    import drjit as dr
    import mitsuba as mi

    light = {
        "type": shape,
        "to_world": transform(to_camera),
        "emitter": {"type": "area", "radiance": spectrum_dict(radiance), "sampling_weight": float(lux)},
    }
    if shape != "rectangle" or mi.variant().startswith("scalar"):
        return light
    # Mitsuba compiles the transform of a rectangle into kernels, unlike that of other shapes.
    rectangle = mi.load_dict(light)
    parameters = mi.traverse(rectangle)
    place = parameters["to_world"]
    dr.make_opaque(place)
    parameters["to_world"] = place
    parameters.update()
    return rectangle


def _look_at(position: np.ndarray, target: np.ndarray) -> np.ndarray:
    """Transform [4, 4] that moves the origin to ``position`` and turns +z towards ``target``.

    +x stays horizontal, except for directions within about 26 degrees of the vertical.
    """
    forward = (target - position) / np.linalg.norm(target - position)
    helper = np.array([0.0, 1.0, 0.0]) if abs(forward[1]) < 0.9 else np.array([1.0, 0.0, 0.0])
    right = np.cross(helper, forward)
    right /= np.linalg.norm(right)
    matrix = np.eye(4)
    matrix[:3, :3] = np.stack([right, np.cross(forward, right), forward], axis=1)
    matrix[:3, 3] = position
    return matrix
