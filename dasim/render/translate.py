"""Scene to Mitsuba dictionary, in camera axes: x right, y down, z forward, metres, the lens at the origin.

The camera's pose is baked into the objects, so that depth is simply z. Spectral values are the scene's own
(W m^-2 sr^-1 nm^-1 for lights, 0..1 for surfaces), without Mitsuba's RGB upsampling anywhere.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from dasim import materials, spectra
from dasim import scene as scenes
from dasim.materials import Diffuse, Surface
from dasim.render.mixture import mixture_dict
from dasim.scene import Dome, Lamp, Scene

MAX_PATH_DEPTH = 6  # lens to light: four bounces after the first surface
_UP = np.diag([1.0, -1.0, -1.0, 1.0])  # Mitsuba's flat shapes face +z with v up; ours face -z with v down


def load(scene: Scene) -> Any:
    """The scene in Mitsuba, in the variant that is active."""
    import mitsuba as mi

    return mi.load_dict(scene_dict(scene), optimize=False)  # merged shapes would lose their numbers


def scene_dict(scene: Scene) -> dict[str, Any]:
    """Mitsuba's description of a scene's objects, lights and integrator; objects first and in order."""
    result: dict[str, Any] = {"type": "scene"}
    result["integrator"] = {"type": "path", "max_depth": MAX_PATH_DEPTH}
    surfaces: dict[tuple[str, bool], Any] = {}
    for index, item in enumerate(scene.objects):
        # Mitsuba's sphere counts v from its upper pole, everything else from the bottom.
        key = (item.material, item.shape == "sphere")
        if key not in surfaces:
            texture = scene.materials.get(item.material, item.material)
            surfaces[key] = _material(materials.surface(texture, scene.folder), flip=key[1])
        result[object_key(index)] = _shape(item, scene, surfaces[key], object_key(index))
    lamps = any(isinstance(light, Lamp) for light in scene.lights)
    for index, light in enumerate(scene.lights):
        result[f"light_{index:04d}"] = _light(light, scene, lamps)
    return result


def object_key(index: int) -> str:
    """Name of the scene's object ``index`` (from 0) in Mitsuba's scene."""
    return f"object_{index:04d}"


def spectrum_dict(values: spectra.FloatArray) -> dict[str, Any]:
    """A spectral curve on the wavelength grid."""
    return {
        "type": "regular",
        "wavelength_min": float(spectra.WAVELENGTH_NM[0]),
        "wavelength_max": float(spectra.WAVELENGTH_NM[-1]),
        "values": ",".join(f"{value:.9g}" for value in values),
    }


def _material(surface: Surface, *, flip: bool) -> Any:
    """A two-sided surface, one instance for all objects that have it."""
    import mitsuba as mi

    return mi.load_dict({"type": "twosided", "bsdf": _bsdf(materials.flipped(surface) if flip else surface)})


def _bsdf(surface: Surface) -> dict[str, Any]:
    import mitsuba as mi

    if isinstance(surface, Diffuse):
        return {"type": "diffuse", "reflectance": spectrum_dict(surface.reflectance)}
    if not mi.variant().startswith("scalar"):
        return {"type": "diffuse", "reflectance": mixture_dict(surface)}
    # Mitsuba's v runs down from the bitmap's top row; shapes and mesh files have v = 0 at the bottom.
    weight = np.ascontiguousarray(surface.weight[::-1, :, None], dtype=np.float32)
    uv = mi.ScalarTransform4f().scale([*surface.repeat, 1.0])
    return {
        "type": "blendbsdf",
        "weight": {"type": "bitmap", "bitmap": mi.Bitmap(weight), "raw": True, "wrap_mode": "mirror", "to_uv": uv},
        "first": _bsdf(surface.first),
        "second": _bsdf(surface.second),
    }


def _transform(matrix: np.ndarray) -> Any:
    import mitsuba as mi

    return mi.ScalarTransform4f(matrix)


def _shape(item: Any, scene: Scene, bsdf: Any, key: str) -> Any:
    to_camera = scenes.object_to_camera(item, scene)
    _, half = scenes.half_extent_m(item, scene)
    if item.shape == "mesh":
        return _mesh(scenes.load_mesh(item, scene), to_camera, bsdf, key)
    if item.shape in ("plane", "disc"):
        local = _UP @ np.diag([half[0], half[1], 1.0, 1.0])
        plugin = {"plane": "rectangle", "disc": "disk"}[item.shape]
        return {"type": plugin, "to_world": _transform(to_camera @ local), "bsdf": bsdf}
    if item.shape == "box":
        return _mesh(_box(half), to_camera, bsdf, key)
    # Mitsuba's sphere has its poles, and its cylinder its axis, along z: turn z to up (-y).
    stand = np.array([[1.0, 0, 0, 0], [0, 0, -1, 0], [0, 1, 0, 0], [0, 0, 0, 1]])
    if item.shape == "sphere":
        return {"type": "sphere", "to_world": _transform(to_camera @ stand @ np.diag([*half, 1.0])), "bsdf": bsdf}
    lower = np.eye(4)
    lower[2, 3] = -half[1]
    scale = np.diag([half[0], half[2], 2 * half[1], 1.0])
    return {"type": "cylinder", "to_world": _transform(to_camera @ stand @ lower @ scale), "bsdf": bsdf}


def _box(half: np.ndarray) -> scenes.MeshData:
    """A box whose every side shows the whole texture upright, seen from outside; the lids as seen with z up."""
    corners = np.array([[-1, 1], [1, 1], [1, -1], [-1, -1]])  # bottom left first, right, y down
    vertices: list[np.ndarray] = []
    faces: list[tuple[int, int, int]] = []
    # right and down of each side as seen from outside; the side itself lies at right x down, turned outward
    for right, down in (
        ((1, 0, 0), (0, 1, 0)),
        ((-1, 0, 0), (0, 1, 0)),
        ((0, 0, 1), (0, 1, 0)),
        ((0, 0, -1), (0, 1, 0)),
        ((1, 0, 0), (0, 0, -1)),
        ((1, 0, 0), (0, 0, 1)),
    ):
        outward = -np.cross(right, down)
        first = len(vertices)
        vertices += [(x * np.array(right) + y * np.array(down) + outward) * half for x, y in corners]
        faces += [(first, first + 1, first + 2), (first, first + 2, first + 3)]
    uv = np.tile([[0, 0], [1, 0], [1, 1], [0, 1]], (6, 1)).astype(float)
    return scenes.MeshData(np.array(vertices), np.array(faces, np.uint32), uv)


def _mesh(data: scenes.MeshData, to_camera: np.ndarray, bsdf: Any, key: str) -> Any:
    import mitsuba as mi

    props = mi.Properties()
    props["bsdf"] = bsdf
    mesh = mi.Mesh(key, len(data.vertices), len(data.faces), has_vertex_texcoords=data.uv is not None, props=props)
    vertices = data.vertices @ to_camera[:3, :3].T + to_camera[:3, 3]
    params = mi.traverse(mesh)
    params["vertex_positions"] = np.ascontiguousarray(vertices, np.float32).ravel()
    params["faces"] = np.ascontiguousarray(data.faces, np.uint32).ravel()
    if data.uv is not None:
        params["vertex_texcoords"] = np.ascontiguousarray(data.uv, np.float32).ravel()
    params.update()
    return mesh


def _light(light: Dome | Lamp, scene: Scene, lamps: bool) -> dict[str, Any]:
    power = light.lux * spectra.illuminant(light.illuminant)
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
        "to_world": _transform(scenes.world_to_camera(scene) @ facing),
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
