"""Layout of random scenes: the camera's field of view, the room, and positions of objects in it.

Coordinates are scene axes (x right, y down, z forward and horizontal) in centimetres; the camera stands at the origin,
pitched down. The room is convex: the intersection of half-spaces n . X <= d around the camera, one of them the floor. A
ray through picture coordinates (x, y) meets plane i at the depth d_i / (n_i . r(x, y)), where r is linear in x and y,
and sizes are relative to depth. Every constraint (within the depth range, in front of the walls, above the floor) is
therefore a linear inequality with a direct solution; no sample is ever rejected.

Tested in tests/dasim/random_scenes/test_specification.py.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from dasim.typing import FloatArray

Random = np.random.Generator

STEEPEST = np.tan(np.radians(40.0))  # upper limit on the tangent of the camera's pitch
FLOOR = np.array([0.0, 1.0, 0.0])


class Frame(NamedTuple):
    """The field of view: tangents of half its width and height, and the camera's downward pitch in radians.

    Picture coordinates x and y (down) are tangents of the angles from the optical axis.
    """

    half_width: float
    half_height: float
    pitch: float

    def ray(self, x: FloatArray | float, y: FloatArray | float) -> FloatArray:
        """Points at depth 1 on the rays through picture coordinates (x, y), in scene axes, [..., 3]."""
        x, y = np.broadcast_arrays(x, y)
        sine, cosine = np.sin(self.pitch), np.cos(self.pitch)
        return np.stack([x, sine + y * cosine, cosine - y * sine], axis=-1)

    def forward(self) -> FloatArray:
        """Unit vector of the optical axis."""
        return self.ray(0.0, 0.0)


class Wall(NamedTuple):
    """An upright plane n . X = ``distance`` (cm); ``turn`` (radians) rotates it about y from facing the camera."""

    turn: float
    distance: float

    def normal(self) -> FloatArray:
        """Unit normal n, which points out of the room."""
        return np.array([np.sin(self.turn), 0.0, np.cos(self.turn)])


class Room(NamedTuple):
    """A room as the camera sees it, in centimetres.

    Attributes:
        frame: the field of view
        height: of the camera above the floor
        walls: one, or two that meet in a corner
        near: least allowed depth of anything visible
        far: largest allowed depth
        floor_near: depth at which the floor enters the picture at its bottom edge
    """

    frame: Frame
    height: float
    walls: tuple[Wall, ...]
    near: float
    far: float
    floor_near: float

    def planes(self) -> list[tuple[FloatArray, float]]:
        """Normal (out of the room) and distance in centimetres of each plane, the floor first."""
        return [(FLOOR, self.height), *((wall.normal(), wall.distance) for wall in self.walls)]

    def background(self, x: FloatArray | float, y: FloatArray | float) -> FloatArray:
        """Depth in centimetres of the floor or wall at picture coordinates (x, y)."""
        ray = self.frame.ray(x, y)
        return np.asarray(1 / np.max([ray @ normal / distance for normal, distance in self.planes()], axis=0))


def is_clear(space: Room, radius: float, gap: float) -> bool:
    """Whether floor and walls keep a ``gap`` to the lens opening, a disc of ``radius`` at the origin; centimetres.

    The rim comes as near to a plane as the radius times the sine of the angle between its normal and the optical axis.
    """
    forward = space.frame.forward()
    return all(
        distance - radius * np.sqrt(max(1 - float(normal @ forward) ** 2, 0.0)) > gap
        for normal, distance in space.planes()
    )


def room(random: Random, half_width: float, half_height: float, near: float, far: float, *, corner: bool) -> Room:
    """Draw a room with one wall, or two that meet in a ``corner``; its visible part lies between ``near`` and ``far``.

    The floor enters the picture at a depth of 1.05 to 1.4 ``near`` (log-uniform). It would reach the farthest depth,
    0.85 to 0.95 ``far``, at a row between the top of the picture and slightly below its centre. These two conditions
    fix the height and the pitch of the camera. The walls are then moved so that nothing above that row is deeper.
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
    turns, corner_x = _wall_angles(random, frame, horizon, deepest / (1.25 * floor_near), corner=corner)
    ray = frame.ray(corner_x, horizon)
    unit = [Wall(turn, float(Wall(turn, 1.0).normal() @ ray)) for turn in turns]
    scale = deepest / _farthest(unit, frame, horizon)
    walls = tuple(Wall(wall.turn, wall.distance * scale) for wall in unit)
    return Room(frame, height, walls, near, far, floor_near)


def _wall_angles(
    random: Random, frame: Frame, horizon: float, ratio: float, *, corner: bool
) -> tuple[list[float], float]:
    """Random angles of the walls (radians) and the picture coordinate x of their corner.

    The angles are limited so that the ratio of the largest to the least depth on each wall is at most about ``ratio``.
    """
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
    """Largest visible depth of the walls between the top of the picture and the row ``bottom``.

    The inverse depth is the maximum of linear functions, one per wall, hence convex. Its minimum over that part of the
    picture is taken at a corner, or where the line at which two walls meet crosses the border.
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
        band: part of the range of inverse depth from which its own is drawn; 0 is the farthest, 1 the nearest. Blur is
            linear in inverse depth
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
