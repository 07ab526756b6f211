"""Layout of random scenes: the camera's field of view and the room.

Coordinates are scene axes (x right, y down, z forward and horizontal) in centimetres; the camera stands at the origin,
pitched down. The room is convex: the intersection of half-spaces n . X <= d around the camera, one of them the floor. A
ray through picture coordinates (x, y) meets plane i at the depth d_i / (n_i . r(x, y)), where r is linear in x and y,
and sizes are relative to depth. Every constraint (within the depth range, in front of the walls, above the floor) is
therefore a linear inequality with a direct solution; no sample is ever rejected.

Tested in tests/dasim/random_scenes/test_scene.py.
"""

from __future__ import annotations

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

    The rim is nearer to a plane than the centre is, by the radius times the sine of the angle between the normal of the
    plane and the optical axis.
    """
    forward = space.frame.forward()
    return all(
        distance - radius * np.sqrt(max(1 - float(normal @ forward) ** 2, 0.0)) > gap
        for normal, distance in space.planes()
    )


def room(random: Random, half_width: float, half_height: float, near: float, far: float, *, corner: bool) -> Room:
    """Draw a room with one wall, or two that meet in a ``corner``; its visible part lies between ``near`` and ``far``.

    The floor enters the picture at a depth of 1.05 to 1.4 ``near`` (log-uniform). Without walls, it would reach the
    largest depth, 0.85 to 0.95 ``far``, at a row between the top of the picture and slightly below its centre. These
    two conditions determine the height and the pitch of the camera. The walls are then placed so that nothing above
    that row is deeper.
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
