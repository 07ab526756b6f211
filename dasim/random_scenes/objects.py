"""Objects of random scenes: their shapes, sizes and orientations, and what they rest on.

Tested in tests/dasim/random_scenes/test_scene.py.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from dasim.materials import photographs
from dasim.random_scenes import places
from dasim.random_scenes.layout import Room
from dasim.random_scenes.materials import Stock
from dasim.random_scenes.own_files import OwnMeshes
from dasim.random_scenes.places import Occupied, Outline, Place, Top
from dasim.scene import shapes
from dasim.scene.procedural import library
from dasim.typing import FloatArray

Random = np.random.Generator

SOLID_SEEDS = 2**20

# Weights of the kinds of objects.
KINDS = {"solid": 0.45, "box": 0.18, "sphere": 0.13, "cylinder": 0.06, "card": 0.13, "disc": 0.05}
RAISED = ("solid", "box", "sphere", "mesh")  # kinds that may stand on another object, or float
RAISED_SHARE = 0.3  # probability that one of them does so in a room
POSTER_SHARE = {True: 0.12, False: 0.04}  # probability that an object is a poster: in rooms, behind table tops
BANDS = ((0.85, 1.0), (0.0, 0.15))  # of inverse depth, for the first two objects: blur then spans its whole range
CROWD = 16  # above this number, objects shrink so that together they cover about the same area
SPECIAL = 0.6  # factor on the size of metal and glass, whose highlights are noisy


class Setting(NamedTuple):
    """The properties that all objects of a scene share.

    Attributes:
        space: the room
        is_room: room (True) or table top
        size: range of an object's size over the width of the picture
        number: of objects
        stock: surfaces and pictures
        meshes: the user's own, or None
        floating: whether objects may float in the air instead of resting on something
    """

    space: Room
    is_room: bool
    size: tuple[float, float]
    number: int
    stock: Stock
    meshes: OwnMeshes | None
    floating: bool


class Taken(NamedTuple):
    """What the objects that have been placed take up, and the tops of boxes that are still free."""

    occupied: list[Occupied]
    tops: list[Top]


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
    taken = Taken([], [])
    return [_object(random, number, setting, taken) for number, random in enumerate(generators)]


def _object(random: Random, number: int, setting: Setting, taken: Taken) -> dict[str, Any]:
    low, high = np.log(setting.size)
    share = float(np.exp(random.uniform(low, high))) * min(1.0, (CROWD / setting.number) ** 0.5)
    band = BANDS[number] if number < len(BANDS) else (0.0, 1.0)
    if number >= len(BANDS) and random.random() < POSTER_SHARE[setting.is_room]:
        return _poster(random, number, setting, share)
    prototype = _prototype(random, setting)
    surface = _surface(random, prototype, setting)
    if surface.get("material") in setting.stock.special():
        share *= SPECIAL
    raised = setting.is_room and prototype.kind in RAISED and random.random() < RAISED_SHARE
    if raised and setting.floating:
        place = places.place_in_air(random, setting.space, prototype.outline, share, band, taken.occupied)
        rotation_deg = tuple(random.uniform(-180.0, 180.0, 3))
        middle, radius = place.position, prototype.outline.reach() * place.size
    else:
        place = _standing_place(random, setting, prototype, share, band, taken, raised=raised)
        rotation_deg = prototype.rotation_deg
        middle = place.position - (0.0, prototype.outline.height * place.size / 2, 0.0)
        radius = prototype.outline.radius * place.size
    taken.occupied.append(Occupied(middle, radius, prototype.outline.reach() * place.size))
    position = middle - shapes.rotation(rotation_deg) @ prototype.middle * place.size
    lengths = {key: _rounded(np.multiply(value, place.size)) for key, value in prototype.lengths.items()}
    pose = {"position_cm": _rounded(position), "rotation_deg": _rounded(rotation_deg)}
    return {"name": f"{prototype.kind} {number + 1}", **prototype.others, **lengths, **pose, **surface}


def _standing_place(
    random: Random,
    setting: Setting,
    prototype: Prototype,
    share: float,
    band: tuple[float, float],
    taken: Taken,
    *,
    raised: bool,
) -> Place:
    """Draw a place on the floor, or, if the object is ``raised``, on the top of a box that is large enough."""
    place = None
    if raised and taken.tops:
        number = int(random.integers(len(taken.tops)))
        place = places.place_on_top(setting.space, prototype.outline, share, taken.tops[number])
        if place is not None:
            del taken.tops[number]
    if place is None:
        place = places.place_on_floor(random, setting.space, prototype.outline, share, band, taken.occupied)
    if prototype.kind == "box":
        sides = np.multiply(prototype.lengths["size_cm"], place.size)
        taken.tops.append(Top(place.position - (0.0, sides[1], 0.0), float(min(sides[0], sides[2])) / 2))
    return place


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
    place, wall = places.place_on_wall(random, setting.space, width, height, 1.5 * share, off)
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
    file = {"shape": "mesh", "file": mesh.name}
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
