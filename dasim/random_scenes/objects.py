"""Objects of random scenes: their shapes and orientations, and the user's own meshes and pictures.

Tested in tests/dasim/random_scenes/test_specification.py.
"""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from dasim.base.errors import InputError
from dasim.materials import photographs
from dasim.random_scenes import layout
from dasim.random_scenes.layout import Occupied, Outline, Room
from dasim.random_scenes.materials import Stock
from dasim.scene import meshes, shapes
from dasim.scene.procedural import library
from dasim.typing import FloatArray

Random = np.random.Generator

MESH_SUFFIXES = (".obj", ".ply", ".glb", ".stl", ".off")
SOLID_SEEDS = 2**20

# Weights of the kinds of objects.
KINDS = {"solid": 0.45, "box": 0.18, "sphere": 0.13, "cylinder": 0.06, "card": 0.13, "disc": 0.05}
HANGING_SHARE = 0.3  # probability that a sphere, box, solid or mesh of a room hangs in the air
POSTER_SHARE = {True: 0.12, False: 0.04}  # probability that an object is a poster: in rooms, behind table tops
BANDS = ((0.85, 1.0), (0.0, 0.15))  # of inverse depth, for the first two objects: blur then spans its whole range
CROWD = 16  # above this number, objects shrink so that together they cover about the same area
SPECIAL = 0.6  # factor on the size of metal and glass, whose highlights are noisy


class OwnMesh(NamedTuple):
    """A mesh file of the user: its bounding box in its own unit, and whether it has texture coordinates and colours."""

    name: str
    low: tuple[float, float, float]
    high: tuple[float, float, float]
    has_uv: bool
    has_colours: bool


class OwnMeshes(NamedTuple):
    """The user's folder of meshes and how they are used.

    Attributes:
        folder: its path, relative to the specification
        files: its meshes
        share: probability 0..1 that an object is one of them
        up: axis of the files that points up, "y" or "z"
        near_infrared: rule for meshes with colours of their own, or "drawn" for a random one
    """

    folder: str
    files: tuple[OwnMesh, ...]
    share: float
    up: str
    near_infrared: str


class Setting(NamedTuple):
    """The properties that all objects of a scene share.

    Attributes:
        space: the room
        is_room: room (True) or table top
        size: range of an object's size over the width of the picture
        number: of objects
        stock: surfaces and pictures
        meshes: the user's own, or None
    """

    space: Room
    is_room: bool
    size: tuple[float, float]
    number: int
    stock: Stock
    meshes: OwnMeshes | None


class Prototype(NamedTuple):
    """An object of size 1 cm before it is placed.

    Attributes:
        kind: one of ``KINDS``, or "mesh"
        lengths: keys of its specification that scale with its size
        others: keys that do not
        outline: bounding cylinder in its upright orientation
        rotation_deg: its upright orientation
        middle: centre of its bounding box in its local axes
        has_uv: whether it has texture coordinates
        closed: whether it may be of solid glass
        has_colours: whether it has RGB colours of its own
    """

    kind: str
    lengths: dict[str, Any]
    others: dict[str, Any]
    outline: Outline
    rotation_deg: tuple[float, float, float]
    middle: FloatArray = np.zeros(3)
    has_uv: bool = True
    closed: bool = True
    has_colours: bool = False


def objects(generators: list[Random], setting: Setting) -> list[dict[str, Any]]:
    """Specifications of the objects of a scene, each drawn from its own generator."""
    occupied: list[Occupied] = []
    return [_object(random, number, setting, occupied) for number, random in enumerate(generators)]


def _object(random: Random, number: int, setting: Setting, occupied: list[Occupied]) -> dict[str, Any]:
    space = setting.space
    low, high = np.log(setting.size)
    share = float(np.exp(random.uniform(low, high))) * min(1.0, (CROWD / setting.number) ** 0.5)
    band = BANDS[number] if number < len(BANDS) else (0.0, 1.0)
    if number >= len(BANDS) and random.random() < POSTER_SHARE[setting.is_room]:
        return _poster(random, number, setting, share)
    prototype = _prototype(random, setting)
    surface = _surface(random, prototype, setting)
    if surface.get("material") in setting.stock.special():
        share *= SPECIAL
    hangs = setting.is_room and prototype.kind in ("solid", "box", "sphere", "mesh") and random.random() < HANGING_SHARE
    if hangs:
        place = layout.place_in_air(random, space, prototype.outline, share, band, occupied)
        rotation_deg = tuple(random.uniform(-180.0, 180.0, 3))
        middle, radius = place.position, prototype.outline.reach() * place.size
    else:
        place = layout.place_on_floor(random, space, prototype.outline, share, band, occupied)
        rotation_deg = prototype.rotation_deg
        middle = place.position - (0.0, prototype.outline.height * place.size / 2, 0.0)
        radius = prototype.outline.radius * place.size
    occupied.append(Occupied(middle, radius, prototype.outline.reach() * place.size))
    position = middle - shapes.rotation(rotation_deg) @ prototype.middle * place.size
    lengths = {key: _rounded(np.multiply(value, place.size)) for key, value in prototype.lengths.items()}
    pose = {"position_cm": _rounded(position), "rotation_deg": _rounded(rotation_deg)}
    return {"name": f"{prototype.kind} {number + 1}", **prototype.others, **lengths, **pose, **surface}


def _rounded(values: Any) -> Any:
    if np.ndim(values) == 0:
        return float(f"{float(values):.6g}")
    return [round(float(value), 4) for value in values]


def _surface(random: Random, prototype: Prototype, setting: Setting) -> dict[str, str]:
    """Draw the key ``material`` of an object, or ``near_infrared`` of a mesh with colours of its own."""
    rule = str(random.choice(photographs.NEAR_INFRARED_RULES))
    quantile = float(random.random())
    if prototype.has_colours and setting.meshes is not None:
        choice = setting.meshes.near_infrared
        return {"near_infrared": rule if choice == "drawn" else choice}
    surfaces = setting.stock.pictures if prototype.kind == "card" else setting.stock.surfaces
    suitable = [
        surface
        for surface in surfaces
        if (prototype.has_uv or not surface.needs_uv) and (prototype.closed or not surface.is_glass)
    ]
    return {"material": suitable[int(quantile * len(suitable))].name}


def _poster(random: Random, number: int, setting: Setting, share: float) -> dict[str, Any]:
    """Draw a picture on a wall; the gap to the wall grows with its number, so that no two pictures coincide."""
    width, height = _sides(random)
    off = (2e-3 + 3e-4 * number) * setting.space.far
    place, wall = layout.place_on_wall(random, setting.space, width, height, 1.5 * share, off)
    pictures = setting.stock.pictures
    material = pictures[int(random.integers(len(pictures)))].name
    return {
        **{"name": f"poster {number + 1}", "shape": "plane", "class": "print", "material": material},
        "size_cm": [float(f"{place.size * side:.6g}") for side in (width, height)],
        **{"position_cm": _rounded(place.position), "rotation_deg": _rounded((0.0, np.degrees(wall.turn), 0.0))},
    }


def _sides(random: Random) -> tuple[float, float]:
    """Draw the width and height of a picture of aspect 1:1 to 3:2, portrait or landscape; the longer side is 1."""
    shorter = float(random.uniform(2 / 3, 1.0))
    return (1.0, shorter) if random.random() < 0.5 else (shorter, 1.0)


# --- prototypes ---------------------------------------------------------------------------------


def _prototype(random: Random, setting: Setting) -> Prototype:
    if setting.meshes is not None and random.random() < setting.meshes.share:
        return _own_mesh(random, setting.meshes)
    kind = str(random.choice(list(KINDS), p=np.array(list(KINDS.values())) / sum(KINDS.values())))
    turn = float(random.uniform(-180.0, 180.0))
    if kind == "solid":
        name = str(random.choice(library.BODIES))
        return _solid(f"{name}:{int(random.integers(SOLID_SEEDS))}", turn)
    if kind == "box":
        sides = random.uniform(0.25, 1.0, 3)
        sides /= sides.max()
        outline = Outline(float(np.hypot(sides[0], sides[2])) / 2, float(sides[1]))
        return Prototype(kind, {"size_cm": sides}, {"shape": "box"}, outline, (0.0, turn, 0.0))
    if kind == "sphere":
        return Prototype(kind, {"radius_cm": 0.5}, {"shape": "sphere"}, Outline(0.5, 1.0), (0.0, turn, 0.0))
    if kind == "cylinder":
        radius, height = (random.uniform(0.15, 0.5), 1.0) if random.random() < 0.5 else (0.5, random.uniform(0.3, 1.0))
        lengths = {"radius_cm": float(radius), "height_cm": float(height)}
        outline = Outline(float(radius), float(height))
        return Prototype(kind, lengths, {"shape": "cylinder"}, outline, (0.0, turn, 0.0), closed=False)
    if kind == "disc":
        # A coaster, which lies a hundredth of its width above the floor.
        return Prototype(
            kind, {"radius_cm": 0.5}, {"shape": "disc"}, Outline(0.5, 0.02), (-90.0, turn, 0.0), closed=False
        )
    width, height = _sides(random)
    lean, turn = random.uniform(5.0, 35.0), random.uniform(-45.0, 45.0)
    sine, cosine = np.sin(np.radians(lean)), np.cos(np.radians(lean))
    outline = Outline(float(np.hypot(width, height * sine)) / 2, float(height * cosine))
    return Prototype(
        kind,
        {"size_cm": (width, height)},
        {"shape": "plane", "class": "print"},
        outline,
        (-float(lean), float(turn), 0.0),
        closed=False,
    )


def _solid(name: str, turn: float) -> Prototype:
    x, y, z = library.procedural(name).vertices.T
    across, height = float(np.sqrt((x**2 + z**2).max())), float(np.ptp(y))
    file = {"shape": "mesh", "file": f"{library.PREFIX}{name}"}
    return Prototype("solid", {"unit_cm": 1.0}, file, Outline(across, height), (0.0, turn, 0.0))


def _own_mesh(random: Random, meshes: OwnMeshes) -> Prototype:
    """Draw one of the user's meshes, upright and scaled so that its longest side is 1."""
    mesh = meshes.files[int(random.integers(len(meshes.files)))]
    low, high = np.array(mesh.low), np.array(mesh.high)
    unit = 1 / float((high - low).max())
    sides = (high - low) * unit
    upright, across = (1, 2) if meshes.up == "y" else (2, 1)
    outline = Outline(float(np.hypot(sides[0], sides[across])) / 2, float(sides[upright]))
    rotation_deg = (180.0 if meshes.up == "y" else 90.0, float(random.uniform(-180.0, 180.0)), 0.0)
    file = {"shape": "mesh", "file": str(Path(meshes.folder) / mesh.name)}
    middle = (low + high) / 2 * unit
    return Prototype(
        "mesh",
        {"unit_cm": unit},
        file,
        outline,
        rotation_deg,
        middle,
        mesh.has_uv,
        closed=False,
        has_colours=mesh.has_colours,
    )


# --- folders of the user -------------------------------------------------------------------------


@lru_cache(maxsize=4)
def measure_meshes(folder: Path, files: tuple[tuple[str, int, int], ...]) -> tuple[OwnMesh, ...]:
    """Read and measure the meshes of a folder; InputError lists all that are broken.

    ``files`` holds name, modification time and size of each, so that the cached result follows changes of the files.
    """
    results, problems = [], []
    for name, _, _ in files:
        try:
            results.append(_measure_mesh(folder / name))
        except InputError as error:
            problems.append(str(error))
    if problems:
        raise InputError("; ".join(problems))
    return tuple(results)


def _measure_mesh(path: Path) -> OwnMesh:
    where = f"mesh {path}"
    parts = meshes.read(path, 1.0, where)
    if meshes.colour_kinds(parts):
        meshes.merge_with_colours(parts, where)  # raises InputError for missing or too many colours
    low = np.min([part.vertices.min(axis=0) for part in parts], axis=0)
    high = np.max([part.vertices.max(axis=0) for part in parts], axis=0)
    if not (high - low).max() > 0:
        raise InputError(f"{where}: all its vertices coincide")
    corners = tuple(tuple(float(value) for value in corner) for corner in (low, high))
    has_uv = all(part.uv is not None for part in parts)
    return OwnMesh(path.name, corners[0], corners[1], has_uv, bool(meshes.colour_kinds(parts)))  # type: ignore[arg-type]


@lru_cache(maxsize=4)
def check_pictures(folder: Path, files: tuple[tuple[str, int, int], ...]) -> None:
    """Raise InputError with all pictures of a folder that cannot be read; arguments as in :func:`measure_meshes`."""
    problems = []
    for name, _, _ in files:
        try:
            photographs.linear_rgb(name, folder)
        except InputError as error:
            problems.append(str(error))
    if problems:
        raise InputError("; ".join(problems))
