"""Objects that are drawn: what they are, how they stand, and the user's own meshes and pictures.

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
from dasim.random_scenes.layout import Outline, Room, Taken
from dasim.random_scenes.materials import Stock
from dasim.scene import meshes, shapes
from dasim.scene.procedural import library
from dasim.typing import FloatArray

Random = np.random.Generator

MESH_SUFFIXES = (".obj", ".ply", ".glb", ".stl", ".off")
SOLID_SEEDS = 2**20

# Weights of what an object is. In rooms some hang, or are pictures on the walls.
KINDS = {"solid": 0.45, "box": 0.18, "sphere": 0.13, "cylinder": 0.06, "card": 0.13, "disc": 0.05}
HANGING_SHARE = 0.3  # of the objects of a room; balls, boxes and solids can hang
POSTER_SHARE = {True: 0.12, False: 0.04}  # on the walls of rooms, and behind tables
BANDS = ((0.85, 1.0), (0.0, 0.15))  # the first two objects, so that blur spans the range; the others are anywhere
CROWD = 16  # more objects than this are smaller, so that they cover about as much
SPECIAL = 0.6  # metal and glass are smaller: their highlights and noise stay few


class OwnMesh(NamedTuple):
    """A file of the user's: its box in its own unit, whether it has texture coordinates, and colours."""

    name: str
    low: tuple[float, float, float]
    high: tuple[float, float, float]
    has_uv: bool
    coloured: bool


class OwnMeshes(NamedTuple):
    """The user's folder of meshes and how they are used."""

    folder: str
    files: tuple[OwnMesh, ...]
    share: float
    up: str
    near_infrared: str


class Setting(NamedTuple):
    """What all objects of a scene share."""

    space: Room
    is_room: bool
    size: tuple[float, float]
    number: int
    stock: Stock
    meshes: OwnMeshes | None


class Thing(NamedTuple):
    """An object of size 1 cm without a place: keys of its specification that are lengths, and those that are not.

    ``middle`` is the middle of its box in its own axes, ``turned`` how it stands upright (degrees), ``outline`` what it
    takes, standing so.
    """

    kind: str
    lengths: dict[str, Any]
    others: dict[str, Any]
    outline: Outline
    turned: tuple[float, float, float]
    middle: FloatArray = np.zeros(3)
    has_uv: bool = True
    closed: bool = True
    coloured: bool = False


def objects(generators: list[Random], setting: Setting) -> list[dict[str, Any]]:
    """The scene's objects, each from its own generator."""
    taken: list[Taken] = []
    return [_object(random, number, setting, taken) for number, random in enumerate(generators)]


def _object(random: Random, number: int, setting: Setting, taken: list[Taken]) -> dict[str, Any]:
    space = setting.space
    low, high = np.log(setting.size)
    share = float(np.exp(random.uniform(low, high))) * min(1.0, (CROWD / setting.number) ** 0.5)
    band = BANDS[number] if number < len(BANDS) else (0.0, 1.0)
    if number >= len(BANDS) and random.random() < POSTER_SHARE[setting.is_room]:
        return _poster(random, number, setting, share)
    thing = _thing(random, setting)
    surface = _surface(random, thing, setting)
    if surface.get("material") in setting.stock.special():
        share *= SPECIAL
    hangs = setting.is_room and thing.kind in ("solid", "box", "sphere", "mesh") and random.random() < HANGING_SHARE
    if hangs:
        place = layout.hanging(random, space, thing.outline, share, band, taken)
        turned = tuple(random.uniform(-180.0, 180.0, 3))
        middle, radius = place.position, thing.outline.reach() * place.size
    else:
        place = layout.standing(random, space, thing.outline, share, band, taken)
        turned = thing.turned
        middle = place.position - (0.0, thing.outline.height * place.size / 2, 0.0)
        radius = thing.outline.radius * place.size
    taken.append(Taken(middle, radius, thing.outline.reach() * place.size))
    position = middle - shapes.rotation(turned) @ thing.middle * place.size
    lengths = {key: _rounded(np.multiply(value, place.size)) for key, value in thing.lengths.items()}
    placed = {"position_cm": _rounded(position), "rotation_deg": _rounded(turned)}
    return {"name": f"{thing.kind} {number + 1}", **thing.others, **lengths, **placed, **surface}


def _rounded(values: Any) -> Any:
    if np.ndim(values) == 0:
        return float(f"{float(values):.6g}")
    return [round(float(value), 4) for value in values]


def _surface(random: Random, thing: Thing, setting: Setting) -> dict[str, str]:
    """The key ``material`` of an object, or ``near_infrared`` of a mesh with colours of its own."""
    rule = str(random.choice(photographs.NEAR_INFRARED_RULES))
    drawn = float(random.random())
    if thing.coloured and setting.meshes is not None:
        wanted = setting.meshes.near_infrared
        return {"near_infrared": rule if wanted == "drawn" else wanted}
    surfaces = setting.stock.pictures if thing.kind == "card" else setting.stock.surfaces
    fitting = [
        surface
        for surface in surfaces
        if (thing.has_uv or not surface.textured) and (thing.closed or not surface.is_glass)
    ]
    return {"material": fitting[int(drawn * len(fitting))].name}


def _poster(random: Random, number: int, setting: Setting, share: float) -> dict[str, Any]:
    """A picture on a wall, each a little farther before it than the last, so that none lies in another."""
    width, height = _sides(random)
    off = (2e-3 + 3e-4 * number) * setting.space.far
    place, wall = layout.on_wall(random, setting.space, width, height, 1.5 * share, off)
    pictures = setting.stock.pictures
    material = pictures[int(random.integers(len(pictures)))].name
    return {
        **{"name": f"poster {number + 1}", "shape": "plane", "material": material},
        "size_cm": [float(f"{place.size * side:.6g}") for side in (width, height)],
        **{"position_cm": _rounded(place.position), "rotation_deg": _rounded((0.0, np.degrees(wall.turn), 0.0))},
    }


def _sides(random: Random) -> tuple[float, float]:
    """Width and height of a picture, 1:1 to 3:2, the longer one 1."""
    shorter = float(random.uniform(2 / 3, 1.0))
    return (1.0, shorter) if random.random() < 0.5 else (shorter, 1.0)


# --- things --------------------------------------------------------------------------------------


def _thing(random: Random, setting: Setting) -> Thing:
    if setting.meshes is not None and random.random() < setting.meshes.share:
        return _own(random, setting.meshes)
    kind = str(random.choice(list(KINDS), p=np.array(list(KINDS.values())) / sum(KINDS.values())))
    turn = float(random.uniform(-180.0, 180.0))
    if kind == "solid":
        name = str(random.choice(library.BODIES))
        return _solid(f"{name}:{int(random.integers(SOLID_SEEDS))}", turn)
    if kind == "box":
        sides = random.uniform(0.25, 1.0, 3)
        sides /= sides.max()
        outline = Outline(float(np.hypot(sides[0], sides[2])) / 2, float(sides[1]))
        return Thing(kind, {"size_cm": sides}, {"shape": "box"}, outline, (0.0, turn, 0.0))
    if kind == "sphere":
        return Thing(kind, {"radius_cm": 0.5}, {"shape": "sphere"}, Outline(0.5, 1.0), (0.0, turn, 0.0))
    if kind == "cylinder":
        radius, height = (random.uniform(0.15, 0.5), 1.0) if random.random() < 0.5 else (0.5, random.uniform(0.3, 1.0))
        lengths = {"radius_cm": float(radius), "height_cm": float(height)}
        outline = Outline(float(radius), float(height))
        return Thing(kind, lengths, {"shape": "cylinder"}, outline, (0.0, turn, 0.0), closed=False)
    if kind == "disc":
        # A coaster: it lies a hundredth of its width above the floor.
        return Thing(kind, {"radius_cm": 0.5}, {"shape": "disc"}, Outline(0.5, 0.02), (-90.0, turn, 0.0), closed=False)
    width, height = _sides(random)
    lean, turn = random.uniform(5.0, 35.0), random.uniform(-45.0, 45.0)
    sine, cosine = np.sin(np.radians(lean)), np.cos(np.radians(lean))
    outline = Outline(float(np.hypot(width, height * sine)) / 2, float(height * cosine))
    return Thing(
        kind, {"size_cm": (width, height)}, {"shape": "plane"}, outline, (-float(lean), float(turn), 0.0), closed=False
    )


def _solid(name: str, turn: float) -> Thing:
    x, y, z = library.procedural(name).vertices.T
    across, height = float(np.sqrt((x**2 + z**2).max())), float(np.ptp(y))
    file = {"shape": "mesh", "file": f"{library.PREFIX}{name}"}
    return Thing("solid", {"unit_cm": 1.0}, file, Outline(across, height), (0.0, turn, 0.0))


def _own(random: Random, own: OwnMeshes) -> Thing:
    """A file of the user's, its longest side 1, standing on what is its lower side."""
    mesh = own.files[int(random.integers(len(own.files)))]
    low, high = np.array(mesh.low), np.array(mesh.high)
    unit = 1 / float((high - low).max())
    sides = (high - low) * unit
    upright, across = (1, 2) if own.up == "y" else (2, 1)
    outline = Outline(float(np.hypot(sides[0], sides[across])) / 2, float(sides[upright]))
    turned = (180.0 if own.up == "y" else 90.0, float(random.uniform(-180.0, 180.0)), 0.0)
    file = {"shape": "mesh", "file": str(Path(own.folder) / mesh.name)}
    middle = (low + high) / 2 * unit
    return Thing(
        "mesh", {"unit_cm": unit}, file, outline, turned, middle, mesh.has_uv, closed=False, coloured=mesh.coloured
    )


# --- folders of the user -------------------------------------------------------------------------


@lru_cache(maxsize=4)
def measured(folder: Path, files: tuple[tuple[str, int, int], ...]) -> tuple[OwnMesh, ...]:
    """The boxes of a folder's meshes; InputError that names all that are broken. ``files`` says when they changed."""
    found, problems = [], []
    for name, _, _ in files:
        try:
            found.append(_measured(folder / name))
        except InputError as error:
            problems.append(str(error))
    if problems:
        raise InputError("; ".join(problems))
    return tuple(found)


def _measured(path: Path) -> OwnMesh:
    where = f"mesh {path}"
    parts = meshes.read(path, 1.0, where)
    if meshes.colour_kinds(parts):
        meshes.merge_with_colours(parts, where)  # raises where some faces have none, or they are too many
    low = np.min([part.vertices.min(axis=0) for part in parts], axis=0)
    high = np.max([part.vertices.max(axis=0) for part in parts], axis=0)
    if not (high - low).max() > 0:
        raise InputError(f"{where}: all its vertices are in one place")
    corners = tuple(tuple(float(value) for value in corner) for corner in (low, high))
    has_uv = all(part.uv is not None for part in parts)
    return OwnMesh(path.name, corners[0], corners[1], has_uv, bool(meshes.colour_kinds(parts)))  # type: ignore[arg-type]


@lru_cache(maxsize=4)
def check_pictures(folder: Path, files: tuple[tuple[str, int, int], ...]) -> None:
    """InputError that names all of a folder's pictures that cannot be read."""
    problems = []
    for name, _, _ in files:
        try:
            photographs.linear_rgb(name, folder)
        except InputError as error:
            problems.append(str(error))
    if problems:
        raise InputError("; ".join(problems))
