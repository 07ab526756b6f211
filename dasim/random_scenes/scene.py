"""A random scene and its exposure, by seed and index.

A scene depends only on the specification, the camera's field of view, the seed and the index. Each stage of sampling
has its own random generator, so that a change of one stage, such as the number of objects, leaves the others (such as
the lights) unchanged. ``layout`` draws the room and ``places`` positions objects in it, ``objects`` and ``materials``
draw their shapes and surfaces, ``lights`` their light.

Tested in tests/dasim/random_scenes/test_scene.py.
"""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from dasim.base.errors import InputError
from dasim.base.toml import parse
from dasim.camera import geometry
from dasim.camera import sensor as sensors
from dasim.camera import specification as cameras
from dasim.camera.noise import Exposure
from dasim.camera.specification import Camera
from dasim.materials.library import Texture
from dasim.random_scenes import layout
from dasim.random_scenes import materials as random_materials
from dasim.random_scenes import objects as random_objects
from dasim.random_scenes.draws import Random, generator, rounded, weighted
from dasim.random_scenes.layout import Room
from dasim.random_scenes.lights import lights
from dasim.random_scenes.materials import Palette, Shares
from dasim.random_scenes.specification import RandomScenes, load_random_scenes, own_meshes, own_pictures
from dasim.scene.clearance import LENS_CLEARANCE_M
from dasim.scene.specification import Scene
from dasim.typing import FloatArray

PREFIX = "random:"
CLEARANCE = 1.001  # safety factor of the least gap to the lens, for positions that are rounded
WIDENING, MOST_WIDENINGS = 1.25, 40  # factor of each step to a wider field of view
PICTURE_PX = (512, 384)  # crop of da-mobile, the default camera, whose field of view positions objects


def random_scene(
    seed: int, index: int, spec: RandomScenes | None = None, camera: Camera | str | Path | None = None
) -> Scene:
    """Random scene number ``index`` of a seed; the same numbers give the same scene.

    Raises InputError if a file that the specification names is missing or broken.

    Args:
        seed: 0 or above
        index: 0 or above
        spec: the distributions. Default: ``RandomScenes()``
        camera: the camera that will photograph the scene, with its final crop, or its name or path; objects are placed
            within its field of view. Default: the central 512 x 384 pixels of da-mobile
    """
    _check_numbers(seed, index)
    spec = spec or RandomScenes()
    meshes, pictures = own_meshes(spec), own_pictures(spec)
    focus_cm = _focus_cm(generator(seed, index, "focus"), spec)
    space, kind = _clear_room(seed, index, spec, cameras.refocused(camera or _default_camera(), focus_cm * 1e-2))
    images = random_materials.palette(generator(seed, index, "palette"), pictures)
    materials: dict[str, Texture] = {}
    objects = _background(generator(seed, index, "background"), spec, space, images, materials)
    shares = Shares(spec.textured_share, spec.glossy_share, spec.metal_share, spec.glass_share)
    surfaces = [generator(seed, index, "surface", number) for number in range(spec.surfaces)]
    stock = random_materials.stock(surfaces, images, shares)
    count = int(generator(seed, index, "count").integers(spec.objects[0], spec.objects[1] + 1))
    setting = random_objects.Setting(space, kind == "room", spec.size, count, stock, meshes, spec.floating)
    objects += random_objects.objects([generator(seed, index, "object", number) for number in range(count)], setting)
    used = {item.get("material") for item in objects}
    materials |= {
        item.name: item.texture
        for item in (*stock.surfaces, *stock.pictures)
        if item.texture is not None and item.name in used
    }
    data = {
        "name": f"{PREFIX}{seed}:{index}",
        "description": f"{kind}, {count} objects from {spec.depth_cm[0]:g} to {spec.depth_cm[1]:g} cm",
        "focus_cm": round(focus_cm, 4),
        "view": {"look_at_cm": rounded(100 * space.frame.forward())},
        "materials": materials,
        "lights": lights(seed, index, spec, space),
        "objects": objects,
    }
    return parse(Scene, data, str(data["name"])).model_copy(update={"folder": spec.folder})


def random_exposure(seed: int, index: int, spec: RandomScenes | None = None) -> Exposure:
    """Exposure of random scene number ``index`` of a seed: automatic, with a random level and gain.

    The level is the share of full scale that the 99.5th percentile of the pixels reaches. ``spec`` holds its range and
    the weights of the gains (default: ``RandomScenes()``).
    """
    _check_numbers(seed, index)
    spec = spec or RandomScenes()
    random = generator(seed, index, "exposure")
    level = round(float(random.uniform(*spec.auto_level)), 4)
    return Exposure(gain=float(weighted(random, spec.gains)), auto_level=level)


def is_random(name: str | Path) -> bool:
    """Whether a name denotes a random scene."""
    return str(name).startswith(PREFIX)


def by_name(name: str, camera: Camera | None = None) -> tuple[Scene, Exposure]:
    """Scene and exposure of a name ``random:SEED:INDEX`` or ``random:FILE.toml:SEED:INDEX``.

    ``camera`` is that of :func:`random_scene`.
    """
    path, colon, numbers = name.removeprefix(PREFIX).rpartition(":")
    file, _, first = path.rpartition(":")
    if not colon or not (first.isdecimal() and numbers.isdecimal()):
        raise InputError(f"scene '{name}': a random scene is random:SEED:INDEX or random:FILE.toml:SEED:INDEX")
    spec = load_random_scenes(file) if file else None
    return random_scene(int(first), int(numbers), spec, camera), random_exposure(int(first), int(numbers), spec)


def _check_numbers(seed: int, index: int) -> None:
    for name, value in (("seed", seed), ("index", index)):
        if value < 0:
            raise InputError(f"random scene: {name} is {value}; it must be 0 or a positive whole number")


def _focus_cm(random: Random, spec: RandomScenes) -> float:
    near, far = spec.depth_cm
    share = random.random()
    return {"near": near, "far": far}.get(spec.focus, 1 / (share / near + (1 - share) / far))


@lru_cache(maxsize=1)
def _default_camera() -> Camera:
    return cameras.cropped(cameras.load_camera("da-mobile"), *PICTURE_PX)


def _field_of_view(camera: Camera) -> tuple[float, float]:
    """Tangents of half the width and height of the field of view, centred on the axis."""
    axis = np.array(sensors.principal_point(camera.sensor))
    pixels = np.maximum(axis, [camera.sensor.width_px, camera.sensor.height_px] - axis)
    half = pixels * camera.sensor.pixel_pitch_um * 1e-6 / geometry.image_distance_m(camera)
    return float(half[0]), float(half[1])


def _clear_room(seed: int, index: int, spec: RandomScenes, camera: Camera) -> tuple[Room, str]:
    """Draw a room whose floor and walls are clear of the lens of a focused camera; return the room and its kind.

    With a very small field of view, the floor would reach the lens. The room is then drawn for a wider field of view,
    and the picture shows its centre.
    """
    width, height = _field_of_view(camera)
    radius, gap = 50 * geometry.aperture_m(camera), CLEARANCE * 100 * LENS_CLEARANCE_M
    for step in range(MOST_WIDENINGS):
        wider = (width * WIDENING**step, height * WIDENING**step)
        space, kind = _room(generator(seed, index, "room"), spec, wider)
        if layout.is_clear(space, radius, gap):
            break
    return space, kind


def _room(random: Random, spec: RandomScenes, field_of_view: tuple[float, float]) -> tuple[Room, str]:
    is_room = bool(random.random() < spec.room_share)
    corner = is_room and bool(random.random() < 0.8)
    return layout.room(random, *field_of_view, *spec.depth_cm, corner=corner), "room" if is_room else "table top"


def _background(
    random: Random, spec: RandomScenes, space: Room, images: Palette, materials: dict[str, Texture]
) -> list[dict[str, Any]]:
    """Floor and walls as objects, large enough to fill the picture and the margin that blur mixes into it.

    Their own materials are added to ``materials``.
    """
    far = space.far
    result = []

    def add(name: str, names: tuple[str, ...], size: FloatArray, position: Any, rotation: tuple[float, ...]) -> None:
        tile = random.uniform(0.5, 1.2) * 2 * space.frame.half_width * far * 0.5
        texture = random_materials.background(random, names, images, spec.background_textured_share, size[0] / tile)
        material = texture if isinstance(texture, str) else name
        if not isinstance(texture, str):
            materials[name] = texture
        plane: dict[str, Any] = {"shape": "plane", "name": name, "class": name.partition(" ")[0], "material": material}
        pose = {"position_cm": rounded(position), "rotation_deg": rounded(rotation)}
        result.append(plane | {"size_cm": rounded(size)} | pose)

    add("floor", random_materials.FLOORS, np.array([2.4, 1.6]) * far, (0, space.height, 0.5 * far), (-90, 0, 0))
    for number, wall in enumerate(space.walls):
        middle = wall.normal() * wall.distance + (0, space.height - 0.6 * far, 0)
        size = np.array([2.6, 1.3]) * far
        add(f"wall {number + 1}", random_materials.WALLS, size, middle, (0, float(np.degrees(wall.turn)), 0))
    return result
