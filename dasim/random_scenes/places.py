"""Placement of objects in a random scene: on the floor, on other objects, on a wall or in the air.

Coordinates and constraints are those of :mod:`dasim.random_scenes.layout`.

Tested in tests/dasim/random_scenes/test_scene.py.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from dasim.random_scenes.draws import Random
from dasim.random_scenes.layout import FLOOR, Room, Wall
from dasim.typing import FloatArray


class Place(NamedTuple):
    """A position for an object, its size and its depth, all in centimetres.

    ``position`` is the centre of the object's foot if it stands on the floor, else the centre of the object.
    """

    position: FloatArray
    size: float
    depth: float


class Occupied(NamedTuple):
    """The space that a placed object occupies, in centimetres.

    Attributes:
        middle: centre of the object
        radius: of the upright cylinder that bounds it
        reach: radius of the ball around ``middle`` that bounds it in any orientation
    """

    middle: FloatArray
    radius: float
    reach: float


class Top(NamedTuple):
    """The level top of an object, in centimetres: its middle, and the radius of the largest disc that fits on it."""

    middle: FloatArray
    radius: float


class Outline(NamedTuple):
    """The bounding cylinder of an object of size 1: radius about its upright axis, and height."""

    radius: float
    height: float

    def reach(self) -> float:
        """Radius of the ball around the centre that bounds the object in any orientation."""
        return float(np.hypot(self.radius, self.height / 2))


CANDIDATES = 12  # random positions, of which the one with the largest gap to other objects is used
EDGE = 0.92  # centres of objects lie within this share of the picture's width and height
CLEAR = 1.002  # safety factor of the distance to walls and to the limits of depth


def place_on_floor(
    random: Random, space: Room, outline: Outline, share: float, band: tuple[float, float], occupied: list[Occupied]
) -> Place:
    """Draw a position on the floor, the one of ``CANDIDATES`` with the largest gap to other objects per object radius.

    An object that does not fit into the gap is reduced, at most to a third of its size, and may then overlap others.

    Args:
        random: source of randomness
        space: the room
        outline: bounding cylinder of the object at size 1
        share: size of the object over the width of the picture at its depth
        band: interval from which the object's inverse depth is drawn, as a share of the allowed range: 0 is the
            farthest, 1 the nearest. Blur is linear in inverse depth
        occupied: space of the objects that have been placed
    """
    candidates: list[tuple[float, Place]] = []
    for _ in range(CANDIDATES):
        x, nearness = random.uniform(-EDGE, EDGE) * space.frame.half_width, random.uniform(*band)
        place = _floor_place(space, outline, 2 * space.frame.half_width * share, x, nearness)
        radius = outline.radius * place.size
        foot = place.position[::2].tolist()
        gaps = [math.dist(foot, other.middle[::2]) - radius - other.radius for other in occupied]
        candidates.append((min(gaps, default=np.inf) / radius, place))
    gap, best = max(candidates, key=lambda item: item[0])
    return best._replace(size=best.size * float(np.clip(1 + gap, 1 / 3, 1.0)))


def _floor_place(space: Room, outline: Outline, relative: float, x: float, nearness: float) -> Place:
    """The position B on the floor, at picture coordinate ``x``, of an object of size ``relative`` times its depth z.

    ``nearness`` selects the inverse depth within the allowed range, from 0 (farthest) to 1 (nearest). ``relative`` is
    halved until that range is not empty.
    """
    frame = space.frame
    sine, cosine = np.sin(frame.pitch), np.cos(frame.pitch)
    # On the floor y = height. Depth is z = y sine + l cosine, so that the horizontal distance l follows from z.
    for _ in range(16):  # ends: for size 0 the range is that of the floor itself, which is not empty
        radius, height = outline.radius * relative, outline.height * relative
        low = max(CLEAR * space.near / max(1 - radius - height * sine, 0.01), space.floor_near)
        high = space.far / (CLEAR * (1 + radius))
        for wall in space.walls:
            normal = wall.normal()
            # n . B + radius z <= d, with B = (x z, height, (z - height sine) / cosine)
            slope = normal[0] * x + normal[2] / cosine + CLEAR * radius
            high = min(high, (wall.distance + normal[2] * space.height * sine / cosine) / (CLEAR * slope))
        if high > low:
            break
        relative /= 2
    depth = 1 / ((1 - nearness) / high + nearness / low)
    horizontal = (depth - space.height * sine) / cosine
    return Place(np.array([x * depth, space.height, horizontal]), relative * depth, depth)


def place_on_top(space: Room, outline: Outline, share: float, top: Top) -> Place | None:
    """The place of an object in the middle of a top, or None where it would be less than a third of its size.

    The object is reduced to fit on the top, so that it is as clear of walls as what bears it, and to stay farther than
    the near end of the depth range: a cylinder of radius r and height h, upright at depth z, reaches as near as
    z - r cos(pitch) - h sin(pitch).

    Args:
        space: the room
        outline: bounding cylinder of the object at size 1
        share: size of the object over the width of the picture at its depth
        top: what it stands on
    """
    depth = float(top.middle @ space.frame.forward())
    wanted = 2 * space.frame.half_width * share * depth
    reach = outline.radius * np.cos(space.frame.pitch) + outline.height * np.sin(space.frame.pitch)
    size = min(wanted, top.radius / (CLEAR * outline.radius), (depth - CLEAR * space.near) / float(reach))
    return Place(top.middle, float(size), depth) if size > wanted / 3 else None


def place_in_air(
    random: Random, space: Room, outline: Outline, share: float, band: tuple[float, float], occupied: list[Occupied]
) -> Place:
    """Draw a position in the air, in the upper two thirds of the picture, clear of walls and floor.

    The arguments and the choice among candidates are those of :func:`place_on_floor`.
    """
    frame = space.frame
    candidates: list[tuple[float, Place]] = []
    for _ in range(CANDIDATES):
        x = random.uniform(-EDGE, EDGE) * frame.half_width
        y = random.uniform(-EDGE, 0.33) * frame.half_height
        ray = frame.ray(x, y)
        # A ball of radius rho z at depth z fits if n . r z + rho z <= d for all planes, and z (1 - rho) >= near.
        largest = min(
            float((1 / space.near - normal @ ray / distance) / (1 / distance + 1 / space.near))
            for normal, distance in space.planes()
        )
        rho = min(outline.reach() * share * 2 * frame.half_width, 0.5 * largest)
        high = 1 / max(float(normal @ ray + CLEAR * rho) / distance for normal, distance in space.planes())
        high = min(high, space.far / (CLEAR * (1 + rho)))
        low = CLEAR * space.near / (1 - rho)
        nearness = random.uniform(*band)
        depth = 1 / ((1 - nearness) / high + nearness / low)
        place = Place(ray * depth, rho * depth / outline.reach(), depth)
        gaps = [math.dist(place.position, other.middle) - rho * depth - other.reach for other in occupied]
        candidates.append((min(gaps, default=np.inf) / (rho * depth), place))
    gap, best = max(candidates, key=lambda item: item[0])
    return best._replace(size=best.size * float(np.clip(1 + gap, 1 / 3, 1.0)))


def place_on_wall(
    random: Random, space: Room, width: float, height: float, share: float, off: float
) -> tuple[Place, Wall]:
    """Draw a position for a picture on a wall; return it with that wall.

    The size is limited so that no part of the picture leaves the depth range.

    Args:
        random: source of randomness
        space: the room
        width: of the picture at size 1
        height: of the picture at size 1
        share: size over the width of the photograph at that depth
        off: gap between picture and wall, centimetres
    """
    frame = space.frame
    x, y = random.uniform(-0.8, 0.8) * frame.half_width, random.uniform(-0.8, -0.1) * frame.half_height
    ray = frame.ray(x, y)
    wall = max(space.walls, key=lambda item: float(item.normal() @ ray) / item.distance)
    depth = (wall.distance - off) / float(wall.normal() @ ray)
    size = share * 2 * frame.half_width * depth
    along = np.array([np.cos(wall.turn), 0.0, -np.sin(wall.turn)])
    forward = frame.forward()
    reach = (abs(float(along @ forward)) * width + abs(float(FLOOR @ forward)) * height) / 2
    room_left = min(space.far / CLEAR - depth, depth - CLEAR * space.near)
    return Place(ray * depth, min(size, max(room_left, 0.01 * depth) / max(reach, 1e-6)), depth), wall
