"""Random rooms and table tops for data sets, from a seed and an index; each is valid by construction.

A scene depends only on the specification, the camera's field of view, the seed and the index. Each stage of sampling
has its own random generator, so that a change of one stage, such as the number of objects, leaves the others (such as
the lights) unchanged. ``RandomScenes`` documents the distributions; ``layout`` positions objects, ``objects`` and
``materials`` draw their shapes and surfaces.
"""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field, model_validator

from dasim.base.errors import InputError
from dasim.base.toml import Specification, parse, parse_toml
from dasim.camera import geometry
from dasim.camera import specification as cameras
from dasim.camera.noise import Exposure
from dasim.camera.specification import Camera
from dasim.materials.library import Texture
from dasim.random_scenes import layout
from dasim.random_scenes import materials as random_materials
from dasim.random_scenes import objects as random_objects
from dasim.random_scenes.layout import Room
from dasim.random_scenes.materials import Palette, Shares
from dasim.scene.lights import Lux
from dasim.scene.specification import Scene
from dasim.spectra import illuminants
from dasim.typing import FloatArray

Random = np.random.Generator
Share = Annotated[float, Field(ge=0, le=1)]
Positive = Annotated[float, Field(gt=0)]

PREFIX = "random:"
PICTURE_PX = (512, 384)  # crop of da-mobile, the default camera, whose field of view positions objects
LEAST_RATIO = 1.5  # least ratio of the far to the near end of the depth range
_STAGES = {
    "room": 1,
    "palette": 2,
    "background": 3,
    "count": 4,
    "object": 5,
    "light": 6,
    "focus": 7,
    "exposure": 8,
    "surface": 9,
}

# Default weights. Daylight and incandescent light are rich in near-infrared; LEDs and fluorescent lamps emit little.
ILLUMINANTS = {
    **{"D50": 1.0, "D55": 1.0, "D65": 1.5, "D75": 0.5},
    **{"A": 1.0, "incandescent-2800K": 1.0, "blackbody": 1.5},
    **{"F2": 0.4, "F7": 0.3, "F11": 0.4, "energy-saving-3500K": 0.7},
    **{"LED-B1": 0.3, "LED-B3": 0.3, "LED-B5": 0.3, "LED-V1": 0.3},
}


class RandomScenes(Specification):
    """Distributions of random scenes. Ranges are uniform unless stated otherwise; lengths are in centimetres."""

    room_share: Share = Field(
        default=0.5, description="share of rooms (corner, hanging objects, posters); the rest are table tops"
    )
    depth_cm: tuple[Positive, Positive] = Field(
        default=(20.0, 80.0), description="range of the depths of all visible points"
    )
    objects: tuple[int, int] = Field(default=(5, 40), description="number of objects, without floor and walls")
    size: tuple[Positive, Positive] = Field(
        default=(0.07, 0.32), description="size of an object over the width of the picture, log-uniform; less in crowds"
    )
    surfaces: int = Field(default=10, ge=1, le=100, description="number of different surfaces, without pictures")
    textured_share: Share = 0.65
    background_textured_share: Share = 0.95
    glossy_share: Share = 0.10
    metal_share: Share = 0.03
    glass_share: Share = 0.02
    mesh_folder: str | None = Field(default=None, description="OBJ, PLY, GLB, STL and OFF files, scaled to size")
    mesh_share: Share = Field(default=0.4, description="share of objects from mesh_folder, if given")
    mesh_up: Literal["y", "z"] = Field(default="y", description="axis of the mesh files that points up")
    mesh_near_infrared: Literal["print", "dyed", "achromatic", "drawn"] = Field(
        default="drawn", description="rule for meshes with RGB colours of their own; 'drawn' chooses at random"
    )
    image_folder: str | None = Field(default=None, description="PNG and JPEG files instead of the bundled photographs")
    lamps: tuple[int, int] = Field(default=(1, 3), description="number of lamps, in scenes lit by lamps")
    window_share: Share = Field(default=0.2, description="share of scenes lit by a large panel on one side")
    outdoor_share: Share = Field(default=0.1, description="share of scenes lit by sun and sky, or an overcast sky")
    lux: tuple[Lux, Lux] = Field(default=(100.0, 2000.0), description="sum of all lamps, log-uniform")
    fill_share: tuple[Share, Share] = Field(default=(0.1, 0.3), description="level of the dome relative to the lamps")
    illuminants: dict[str, Positive] = Field(
        default=ILLUMINANTS, description="weights; blackbodies are uniform in mired"
    )
    blackbody_k: tuple[int, int] = (2300, 6500)
    mixed_light_share: Share = Field(default=0.25, description="share of scenes whose lamps have different illuminants")
    focus: Literal["far", "near", "within"] = Field(
        default="far", description="at one end of the depth range, or (within) uniform in dioptres between them"
    )
    auto_level: tuple[Share, Share] = Field(
        default=(0.6, 0.9), description="share of full scale that the exposure aims at"
    )
    gains: dict[float, Positive] = Field(default={1.0: 3.0, 2.0: 1.0, 4.0: 1.0}, description="weights")
    folder: Path = Path(".")

    @model_validator(mode="after")
    def _ranges(self) -> RandomScenes:
        for name in ("depth_cm", "objects", "size", "lamps", "lux", "fill_share", "blackbody_k", "auto_level"):
            low, high = getattr(self, name)
            if low > high:
                raise ValueError(f"{name} is [{low}, {high}]: the smaller number comes first")
        if self.depth_cm[1] < LEAST_RATIO * self.depth_cm[0]:
            raise ValueError(f"depth_cm must reach at least {LEAST_RATIO} times its nearer end")
        if self.depth_cm[0] < 3 or self.depth_cm[1] > 4000:
            raise ValueError("depth_cm must lie within 3 and 4000: nearer, the floor would touch the lens")
        if not 3 <= self.objects[0] <= self.objects[1] <= 200:
            raise ValueError("objects must lie within 3 and 200")
        if not 1 <= self.lamps[0] <= self.lamps[1] <= 8:
            raise ValueError("lamps must lie within 1 and 8")
        if self.size[1] > 0.6:
            raise ValueError("size must not exceed 0.6 of the picture's width")
        if self.auto_level[0] <= 0 or not self.gains or not self.illuminants:
            raise ValueError("auto_level must be above 0; gains and illuminants need at least one entry")
        if self.metal_share + self.glass_share + self.glossy_share > 1 or self.window_share + self.outdoor_share > 1:
            raise ValueError(
                "metal_share + glass_share + glossy_share and window_share + outdoor_share must not exceed 1"
            )
        low_k, high_k = self.blackbody_k
        for name in self.illuminants:
            for variant in (f"blackbody-{low_k}K", f"blackbody-{high_k}K") if name == "blackbody" else (name,):
                try:
                    illuminants.illuminant(variant)
                except InputError as error:
                    raise ValueError(f"illuminants: {error}") from None
        for gain in self.gains:
            Exposure(gain=gain)
        return self


def load_random_scenes(path: str | Path) -> RandomScenes:
    """Load a specification from a TOML file; InputError lists all problems of the file and of its folders."""
    path = Path(path)
    if not path.is_file():
        raise InputError(f"random scenes '{path}': no such file")
    spec = parse_toml(RandomScenes, path).model_copy(update={"folder": path.parent.resolve()})
    check(spec)
    return spec


def check(spec: RandomScenes) -> None:
    """Raise InputError with all broken meshes and pictures of the user's folders; files read once are cached."""
    problems: list[str] = []
    for read in (_own_meshes, _own_pictures):
        try:
            read(spec)
        except InputError as error:
            problems.append(str(error))
    if problems:
        raise InputError("; ".join(problems))


def random_scene(
    seed: int, index: int, spec: RandomScenes | None = None, camera: Camera | str | Path | None = None
) -> Scene:
    """Random scene number ``index`` of a seed; the same numbers give the same scene.

    Raises InputError if a file or folder of the specification is broken.

    Args:
        seed: 0 or above
        index: 0 or above
        spec: the distributions. Default: ``RandomScenes()``
        camera: the camera that will photograph the scene, with its final crop, or its name or path; objects are placed
            within its field of view. Default: the central 512 x 384 pixels of da-mobile
    """
    _check_numbers(seed, index)
    spec = spec or RandomScenes()
    meshes, pictures = _own_meshes(spec), _own_pictures(spec)
    focus_cm = _focus_cm(_generator(seed, index, "focus"), spec)
    space, kind = _room(_generator(seed, index, "room"), spec, _field_of_view(camera, focus_cm))
    images = random_materials.palette(_generator(seed, index, "palette"), pictures)
    materials: dict[str, Texture] = {}
    objects = _background(_generator(seed, index, "background"), spec, space, images, materials)
    shares = Shares(spec.textured_share, spec.glossy_share, spec.metal_share, spec.glass_share)
    surfaces = [_generator(seed, index, "surface", number) for number in range(spec.surfaces)]
    stock = random_materials.stock(surfaces, images, shares)
    count = int(_generator(seed, index, "count").integers(spec.objects[0], spec.objects[1] + 1))
    setting = random_objects.Setting(space, kind == "room", spec.size, count, stock, meshes)
    objects += random_objects.objects([_generator(seed, index, "object", number) for number in range(count)], setting)
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
        "view": {"look_at_cm": _rounded(100 * space.frame.forward())},
        "materials": materials,
        "lights": _lights(seed, index, spec, space),
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
    random = _generator(seed, index, "exposure")
    level = round(float(random.uniform(*spec.auto_level)), 4)
    return Exposure(gain=float(_weighted(random, spec.gains)), auto_level=level)


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


# --- stages --------------------------------------------------------------------------------------


def _check_numbers(seed: int, index: int) -> None:
    for name, value in (("seed", seed), ("index", index)):
        if value < 0:
            raise InputError(f"random scene: {name} is {value}; 0 or a positive whole number is needed")


def _generator(seed: int, index: int, stage: str, number: int = 0) -> Random:
    return np.random.Generator(np.random.Philox(np.random.SeedSequence((seed, index, _STAGES[stage], number))))


def _weighted(random: Random, weights: dict[Any, float]) -> Any:
    share = np.cumsum(list(weights.values()))
    return list(weights)[int(np.searchsorted(share, random.random() * share[-1], side="right"))]


def _rounded(values: Any) -> list[float]:
    return [round(float(value), 4) for value in values]


def _focus_cm(random: Random, spec: RandomScenes) -> float:
    near, far = spec.depth_cm
    share = random.random()
    return {"near": near, "far": far}.get(spec.focus, 1 / (share / near + (1 - share) / far))


@lru_cache(maxsize=1)
def _default_camera() -> Camera:
    return cameras.cropped(cameras.load_camera("da-mobile"), *PICTURE_PX)


def _field_of_view(camera: Camera | str | Path | None, focus_cm: float) -> tuple[float, float]:
    """Tangents of half the width and height of the field of view at a focus distance, centred on the axis."""
    camera = cameras.refocused(camera or _default_camera(), focus_cm * 1e-2)
    axis = np.array(cameras.principal_point(camera.sensor))
    pixels = np.maximum(axis, [camera.sensor.width_px, camera.sensor.height_px] - axis)
    half = pixels * camera.sensor.pixel_pitch_um * 1e-6 / geometry.image_distance_m(camera)
    return float(half[0]), float(half[1])


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
        plane = {"shape": "plane", "name": name, "material": material, "size_cm": _rounded(size)}
        result.append(plane | {"position_cm": _rounded(position), "rotation_deg": _rounded(rotation)})

    add("floor", random_materials.FLOORS, np.array([2.4, 1.6]) * far, (0, space.height, 0.5 * far), (-90, 0, 0))
    for number, wall in enumerate(space.walls):
        middle = wall.normal() * wall.distance + (0, space.height - 0.6 * far, 0)
        size = np.array([2.6, 1.3]) * far
        add(f"wall {number + 1}", random_materials.WALLS, size, middle, (0, float(np.degrees(wall.turn)), 0))
    return result


# --- lights --------------------------------------------------------------------------------------


def _illuminant(random: Random, spec: RandomScenes) -> str:
    """Draw an illuminant by its weight; the temperature of a blackbody is uniform in mired, rounded to 50 K."""
    name = str(_weighted(random, spec.illuminants))
    low, high = spec.blackbody_k
    kelvin = 1 / random.uniform(1 / high, 1 / low)
    return f"blackbody-{int(np.clip(round(kelvin / 50) * 50, low, high))}K" if name == "blackbody" else name


def _lights(seed: int, index: int, spec: RandomScenes, space: Room) -> list[dict[str, Any]]:
    """Draw the lights: lamps or a window with a weak dome of the first one's illuminant, or daylight.

    Lamps stand outside the picture, at least a third of the farthest depth from everything visible, so that no object
    near a lamp is much brighter than the others. Their levels are illuminances on a surface that faces them, on the
    optical axis at the middle of the range of inverse depth.
    """
    random = _generator(seed, index, "light")
    lux = float(np.exp(random.uniform(*np.log(spec.lux))))
    fill = random.uniform(*spec.fill_share)
    kind, mixed = random.random(2)
    main = _illuminant(random, spec)
    near, far = spec.depth_cm
    target = space.frame.forward() * (2 / (1 / near + 1 / far))
    dome = {"kind": "dome", "illuminant": main, "lux": round(lux * fill, 3)}
    if kind < spec.outdoor_share:
        return [_outdoors(random, lux)]
    if kind < spec.outdoor_share + spec.window_share:
        side = 1 if random.random() < 0.5 else -1
        size = random.uniform(0.4, 0.8, 2) * far
        place = _lamp_place(random, space, float(np.hypot(*size)) / 2, (55.0, 80.0), side)
        window = {"kind": "panel", "size_cm": _rounded(size), "illuminant": main, "lux": round(lux, 3)}
        return [window | {"position_cm": _rounded(place), "target_cm": _rounded(target)}, dome]
    count = int(random.integers(spec.lamps[0], spec.lamps[1] + 1))
    parts = np.sort(random.dirichlet(np.full(count, 2.0)))[::-1]
    result: list[dict[str, Any]] = []
    for number in range(count):
        generator = _generator(seed, index, "light", number + 1)
        radius = float(np.exp(generator.uniform(np.log(0.02), np.log(0.12)))) * far
        place = _lamp_place(generator, space, radius, (-75.0, 75.0), 1)
        illuminant = _illuminant(generator, spec)
        lamp = {"kind": "lamp", "radius_cm": round(radius, 4), "lux": round(lux * float(max(parts[number], 0.02)), 3)}
        lamp |= {"illuminant": illuminant if number and mixed < spec.mixed_light_share else main}
        result.append(lamp | {"position_cm": _rounded(place), "target_cm": _rounded(target)})
    return [*result, dome]


def _lamp_place(random: Random, space: Room, radius: float, turns: tuple[float, float], side: int) -> FloatArray:
    """Draw the position [3], cm, of a lamp of ``radius``: outside the picture, above the floor, in front of the walls.

    ``turns`` is the range of its angle around the optical axis in degrees: 0 is above it, 90 to its right (``side`` 1)
    or left (``side`` -1).
    """
    far, frame = space.far, space.frame
    depth = random.uniform(-0.9, 0.3) * far
    turn = side * np.radians(random.uniform(*turns))
    away = random.uniform(0.1, 0.7) * far
    diagonal = float(np.hypot(frame.half_width, frame.half_height))
    sideways = np.array([np.sin(turn), -np.cos(turn), 0.0])  # in scene axes, without the camera's pitch
    for _ in range(2):
        least = max(depth, 0.0) * diagonal * 1.5 + radius + far / 3
        axis = frame.forward() * depth
        room_left = min(
            (0.95 * wall.distance - radius - float(wall.normal() @ axis)) / max(float(wall.normal() @ sideways), 1e-9)
            for wall in space.walls
        )
        if room_left > least:
            break
        depth = -abs(depth)  # no room beside the field of view: move behind the camera, where nothing is visible
    return axis + sideways * max(min(least + away, room_left), 0.0)


def _outdoors(random: Random, lux: float) -> dict[str, Any]:
    """Draw sun and clear sky, with the sun behind the camera, or an overcast sky; ten times the level of lamps."""
    azimuth = float(random.uniform(110.0, 250.0))
    if random.random() < 0.5:
        sun = {"kind": "daylight", "elevation_deg": int(random.integers(25, 66)), "azimuth_deg": round(azimuth, 2)}
        return sun | {"lux": round(10 * lux, 3), "ground_reflectance": 0.2}
    return {
        **{"kind": "sky", "illuminant": "D65", "distribution": "overcast"},
        **{"lux": round(10 * lux, 3), "ground_reflectance": 0.2},
    }


# --- folders of the user -------------------------------------------------------------------------


def _files(folder: Path, suffixes: tuple[str, ...], what: str) -> tuple[tuple[str, int, int], ...]:
    """Name, modification time (ns) and size (bytes) of a folder's files with these suffixes, sorted by name."""
    if not folder.is_dir():
        raise InputError(f"{what} '{folder}': no such folder")
    paths = sorted(path for path in folder.iterdir() if path.suffix.lower() in suffixes)
    if not paths:
        raise InputError(f"{what} '{folder}': holds none of {', '.join(suffixes)}")
    return tuple((path.name, path.stat().st_mtime_ns, path.stat().st_size) for path in paths)


def _own_meshes(spec: RandomScenes) -> random_objects.OwnMeshes | None:
    if spec.mesh_folder is None:
        return None
    folder = spec.folder / spec.mesh_folder
    files = _files(folder, random_objects.MESH_SUFFIXES, "mesh_folder")
    measures = random_objects.measure_meshes(folder, files)
    return random_objects.OwnMeshes(spec.mesh_folder, measures, spec.mesh_share, spec.mesh_up, spec.mesh_near_infrared)


def _own_pictures(spec: RandomScenes) -> tuple[str, ...]:
    if spec.image_folder is None:
        return ()
    folder = spec.folder / spec.image_folder
    files = _files(folder, (".png", ".jpg", ".jpeg"), "image_folder")
    random_objects.check_pictures(folder, files)
    return tuple(str(Path(spec.image_folder) / name) for name, _, _ in files)
