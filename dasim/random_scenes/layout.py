"""Where things stand in a scene that is drawn: what the camera sees, the room, and places for objects in it.

Everything is in scene axes (x right, y down, z forward, level), centimetres, the camera at the origin and pitched
down. The room is convex: planes n . X <= d around the camera, the floor among them. A ray (x, y) of the picture meets
plane i at the depth d_i / (n_i . r(x, y)), with r linear in x and y, and sizes are drawn relative to depth; so every
limit (within the depth range, before the walls, above the floor) is a linear inequality, solved, never searched.

Tested in tests/dasim/random_scenes/test_specification.py.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from dasim.typing import FloatArray

Random = np.random.Generator

STEEPEST = np.tan(np.radians(40.0))  # tangent of the camera's pitch
FLOOR = np.array([0.0, 1.0, 0.0])


class Frame(NamedTuple):
    """What the picture shows: tangents of half its width and height, and the camera's pitch (radians, down)."""

    half_width: float
    half_height: float
    pitch: float

    def ray(self, x: FloatArray | float, y: FloatArray | float) -> FloatArray:
        """Directions of depth 1 of places of the picture (tangents, y down), [..., 3]."""
        x, y = np.broadcast_arrays(x, y)
        sine, cosine = np.sin(self.pitch), np.cos(self.pitch)
        return np.stack([x, sine + y * cosine, cosine - y * sine], axis=-1)

    def forward(self) -> FloatArray:
        """Unit vector of the optical axis."""
        return self.ray(0.0, 0.0)


class Wall(NamedTuple):
    """An upright plane n . X = ``distance``; it is turned by ``turn`` (radians about y) from facing the camera."""

    turn: float
    distance: float

    def normal(self) -> FloatArray:
        """Unit vector out of the room."""
        return np.array([np.sin(self.turn), 0.0, np.cos(self.turn)])


class Room(NamedTuple):
    """A picture of a room: a floor ``height`` below the camera, walls, and the depths that are allowed."""

    frame: Frame
    height: float
    walls: tuple[Wall, ...]
    near: float
    far: float
    floor_near: float  # depth at which the floor enters the picture, below

    def planes(self) -> list[tuple[FloatArray, float]]:
        """Normal (out of the room) and distance of each plane, the floor first."""
        return [(FLOOR, self.height), *((wall.normal(), wall.distance) for wall in self.walls)]

    def background(self, x: FloatArray | float, y: FloatArray | float) -> FloatArray:
        """Depth of floor or wall at places of the picture."""
        ray = self.frame.ray(x, y)
        return np.asarray(1 / np.max([ray @ normal / distance for normal, distance in self.planes()], axis=0))


def room(random: Random, half_width: float, half_height: float, near: float, far: float, *, corner: bool) -> Room:
    """A floor and a wall, or two that meet in a ``corner``; all that is seen lies between ``near`` and ``far``.

    The floor enters the picture at a depth of 1.05 to 1.4 ``near`` (log-uniform) and would reach the farthest depth,
    0.85 to 0.95 ``far``, at a row between the picture's top and a little below its middle: both fix the camera's height
    and pitch. Walls are then moved so that none of what is seen above that row is deeper.
    """
    deepest = far * random.uniform(0.85, 0.95)
    high = min(1.4 * near, 0.6 * deepest)
    floor_near = float(np.exp(random.uniform(np.log(1.05 * near), np.log(max(high, 1.06 * near)))))
    ratio = deepest / floor_near
    horizon = random.uniform(-0.9, 0.5 / ratio) * half_height
    # (tan + half_height) / (tan + horizon) = ratio, the floor's depths being inverse to tan + y.
    slope = min((half_height - ratio * horizon) / (ratio - 1), STEEPEST)
    horizon = (half_height - slope * (ratio - 1)) / ratio
    frame = Frame(half_width, half_height, float(np.arctan(slope)))
    height = deepest * float(frame.ray(0.0, horizon)[1])
    turns, corner_x = _turns(random, frame, horizon, deepest / (1.25 * floor_near), corner=corner)
    ray = frame.ray(corner_x, horizon)
    unit = [Wall(turn, float(Wall(turn, 1.0).normal() @ ray)) for turn in turns]
    scale = deepest / _farthest(unit, frame, horizon)
    walls = tuple(Wall(wall.turn, wall.distance * scale) for wall in unit)
    return Room(frame, height, walls, near, far, floor_near)


def _turns(random: Random, frame: Frame, horizon: float, ratio: float, *, corner: bool) -> tuple[list[float], float]:
    """How walls are turned, and where in the picture they meet: the depths of each span at most ``ratio``."""
    above = float(frame.ray(0.0, -frame.half_height)[2])
    below = float(frame.ray(0.0, horizon)[2])
    steepest = (ratio * below - above) / (frame.half_width * (1 + ratio / 2))
    if corner and steepest > 1.1:
        low = np.arctan(1 / min(steepest, 3.0))
        turn = random.uniform(low, np.pi / 2 - low)
        return [turn, turn - np.pi / 2], frame.half_width * random.uniform(-0.5, 0.5)
    tilt = np.arctan(np.clip(steepest, 0.0, 0.6))
    return [random.uniform(-tilt, tilt)], 0.0


def _farthest(walls: list[Wall], frame: Frame, bottom: float) -> float:
    """Largest depth of the nearest wall between the picture's top and the row ``bottom``.

    The inverse depth is the largest of linear functions: its least value lies in a corner of that part of the picture,
    or where two walls meet upon its edge.
    """
    corners = [
        (x * frame.half_width, y)
        for x, y in ((-1, -frame.half_height), (1, -frame.half_height), (1, bottom), (-1, bottom))
    ]
    places = list(corners)

    def inverse(place: tuple[float, float]) -> list[float]:
        return [float(frame.ray(*place) @ wall.normal()) / wall.distance for wall in walls]

    if len(walls) == 2:
        for start, end in zip(corners, [*corners[1:], corners[0]], strict=True):
            a, b = (first - second for first, second in (inverse(start), inverse(end)))
            if a * b < 0:
                share = a / (a - b)
                places.append((start[0] + share * (end[0] - start[0]), start[1] + share * (end[1] - start[1])))
    return 1 / min(max(inverse(place)) for place in places)


# --- places --------------------------------------------------------------------------------------


class Place(NamedTuple):
    """A place for a thing: the middle of its foot (standing) or its own (hanging), and its size in centimetres."""

    position: FloatArray
    size: float
    depth: float


class Taken(NamedTuple):
    """What a thing that has its place takes: its middle, its radius about the upright axis, and that of a ball."""

    middle: FloatArray
    radius: float
    reach: float


class Outline(NamedTuple):
    """What a thing of size 1 takes: its radius about its upright axis, and its height."""

    radius: float
    height: float

    def reach(self) -> float:
        """Radius of a ball around its middle that holds it however it is turned."""
        return float(np.hypot(self.radius, self.height / 2))


CANDIDATES = 12
EDGE = 0.92  # middles lie within this share of the picture
CLEAR = 1.002  # of walls and limits of depth


def standing(
    random: Random, space: Room, outline: Outline, share: float, band: tuple[float, float], taken: list[Taken]
) -> Place:
    """A place upon the floor, of the most free one of ``CANDIDATES``; ``share`` is the size over the picture's width.

    ``band`` is the part of the range of inverse depth (blur is linear in it) it is drawn from, 0 the farthest. What
    does not fit between the others is made smaller, to a third at most, and is then part of a heap.
    """
    found: list[tuple[float, Place]] = []
    for _ in range(CANDIDATES):
        x, where = random.uniform(-EDGE, EDGE) * space.frame.half_width, random.uniform(*band)
        place = _standing_at(space, outline, 2 * space.frame.half_width * share, x, where)
        radius = outline.radius * place.size
        level = place.position[::2].tolist()
        gaps = [math.dist(level, other.middle[::2]) - radius - other.radius for other in taken]
        found.append((min(gaps, default=np.inf) / radius, place))
    gap, best = max(found, key=lambda item: item[0])
    return best._replace(size=best.size * float(np.clip(1 + gap, 1 / 3, 1.0)))


def _standing_at(space: Room, outline: Outline, relative: float, x: float, where: float) -> Place:
    """The place at column ``x``: B = z (x, ., .) on the floor, its size ``relative`` times its depth z."""
    frame = space.frame
    sine, cosine = np.sin(frame.pitch), np.cos(frame.pitch)
    # On the floor y = height; with depth z = y sine + level cosine, the level distance is (z - height sine) / cosine.
    for _ in range(16):  # halved until it fits; at size 0 the floor's own depths remain, which never are none
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
    depth = 1 / ((1 - where) / high + where / low)
    level = (depth - space.height * sine) / cosine
    return Place(np.array([x * depth, space.height, level]), relative * depth, depth)


def hanging(
    random: Random, space: Room, outline: Outline, share: float, band: tuple[float, float], taken: list[Taken]
) -> Place:
    """A place in the air, in the picture's upper two thirds, away from walls and floor; as ``standing``."""
    frame = space.frame
    found: list[tuple[float, Place]] = []
    for _ in range(CANDIDATES):
        x = random.uniform(-EDGE, EDGE) * frame.half_width
        y = random.uniform(-EDGE, 0.33) * frame.half_height
        ray = frame.ray(x, y)
        # Room for a ball of radius rho z at depth z: n . r z + rho z <= d, and z (1 - rho) >= near.
        largest = min(
            float((1 / space.near - normal @ ray / distance) / (1 / distance + 1 / space.near))
            for normal, distance in space.planes()
        )
        rho = min(outline.reach() * share * 2 * frame.half_width, 0.5 * largest)
        high = 1 / max(float(normal @ ray + CLEAR * rho) / distance for normal, distance in space.planes())
        high = min(high, space.far / (CLEAR * (1 + rho)))
        low = CLEAR * space.near / (1 - rho)
        where = random.uniform(*band)
        depth = 1 / ((1 - where) / high + where / low)
        place = Place(ray * depth, rho * depth / outline.reach(), depth)
        gaps = [math.dist(place.position, other.middle) - rho * depth - other.reach for other in taken]
        found.append((min(gaps, default=np.inf) / (rho * depth), place))
    gap, best = max(found, key=lambda item: item[0])
    return best._replace(size=best.size * float(np.clip(1 + gap, 1 / 3, 1.0)))


def on_wall(random: Random, space: Room, width: float, height: float, share: float, off: float) -> tuple[Place, Wall]:
    """The middle of a picture ``width`` x ``height`` (of size 1) upon the wall that is seen there, ``off`` before it.

    Its size is limited so that none of it is deeper than the range.
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
