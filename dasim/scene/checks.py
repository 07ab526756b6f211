"""Checks of a scene across its keys: names, files and positions.

Tested in tests/dasim/scene/test_specification.py and tests/dasim/scene/test_shapes.py.
"""

from __future__ import annotations

import numpy as np

from dasim.base.errors import InputError
from dasim.base.suggestions import did_you_mean
from dasim.materials.library import Glass, Surface, is_textured, material_names, surface, unknown
from dasim.materials.photographs import NEAR_INFRARED_RULES, mask
from dasim.scene import mesh_merging, panorama
from dasim.scene.clearance import LENS_CLEARANCE_M, distance_m, placement_problems, size_problems
from dasim.scene.lights import Light, Near
from dasim.scene.object_materials import triangles
from dasim.scene.shapes import Box, HeightField, Mesh, Object, Sphere, half_extent_m, mesh_parts, placement
from dasim.scene.specification import Scene, View, object_to_camera, world_to_camera
from dasim.spectra import illuminants


def check(scene: Scene, where: str) -> None:
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
    """Problems of a solid glass object: its shape must be closed, or refracted light would never exit."""
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
    if distance_m(light, world_to_camera(scene)) < LENS_CLEARANCE_M:
        problems.append("lies on the lens or encloses it; move it")
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
    return size_problems(item, scene.folder) + placement_problems(item, scene.folder, to_camera, moved=_moved(scene))


def _moved(scene: Scene) -> bool:
    return scene.view != View()


def check_clear(scene: Scene, pupil_radius_m: float) -> None:
    """Raise InputError if an object reaches into a lens opening of ``pupil_radius_m``, metres, or encloses it."""
    moved, problems = _moved(scene), []
    for item in scene.objects:
        to_camera = object_to_camera(item, scene)
        problems += placement_problems(item, scene.folder, to_camera, pupil_radius_m, moved=moved)
    if problems:
        raise InputError(f"scene '{scene.name}': " + "; ".join(problems))
