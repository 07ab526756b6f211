"""Random scenes of surfaces with patterns, for training: sharp pictures in four channels, and their blur levels.

Blur is linear in dioptres, and the inverse depth of a plane is linear in the picture: a plane is a linear map of
levels. Scenes are drawn in the picture's coordinates, without rays: a wall, mostly a table or floor, and objects that
stand on it or float.
"""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from dasim.typing import BoolArray, Float32Array
from validation.training.patterns import PLAIN, SIDE, TEXTURED, Look, pattern

FINE = 2  # samples per pixel and axis
MOST_OBJECTS = 22


class Family(NamedTuple):
    """Rooms that are alike."""

    look: Look
    objects: tuple[float, ...]  # shares of ``OBJECTS``
    lattice: float  # share of the bars that cross


OBJECTS = ("ball", "card", "disc", "box", "leaves", "bars")
FAMILIES = {
    "plain": Family(PLAIN, (0.25, 0.22, 0.1, 0.25, 0.13, 0.05), 0.0),
    "textured": Family(TEXTURED, (0.24, 0.21, 0.1, 0.24, 0.13, 0.08), 0.4),
    "soft": Family(TEXTURED._replace(soft=0.7), (0.24, 0.21, 0.1, 0.24, 0.13, 0.08), 0.4),
}


class Room(NamedTuple):
    """A sharp picture, [channel, FINE h, FINE w] of reflectance times shading, and its levels, [FINE h, FINE w]."""

    radiance: Float32Array
    level: Float32Array


class _Surface(NamedTuple):
    level: Float32Array  # [h, w]
    mask: BoolArray  # [h, w]
    shading: Float32Array | None = None  # [h, w] of a ball: 0..1


def room(random: np.random.Generator, height: int, width: int, most_level: float, family: Family) -> Room:
    """A random scene of a family, of levels from 0 to ``most_level``, for a picture of [height, width] pixels."""
    shape = (FINE * height, FINE * width)
    back = most_level * random.uniform(0, 0.3) if random.random() < 0.6 else 0.0
    surfaces = [_Surface(_tilted(random, shape, back, 0.15 * most_level), np.ones(shape, bool))]
    floor = _floor(random, shape, back, most_level) if random.random() < 0.75 else None
    if floor is not None:
        surfaces.append(floor)
    for _ in range(int(random.integers(2, MOST_OBJECTS))):
        surfaces.extend(_object(random, shape, back, most_level, floor if random.random() < 0.75 else None, family))
    focus = np.exp(random.uniform(np.log(1.5), np.log(12)))  # in levels: of the dioptres at level 0
    nearest = np.full(shape, -1.0, np.float32)
    radiance = np.zeros((4, *shape), np.float32)
    for surface in surfaces:
        in_front = surface.mask & (surface.level >= nearest)
        if not in_front.any():
            continue
        nearest[in_front] = surface.level[in_front]
        radiance[:, in_front] = _painted(random, surface, in_front, focus, family.look)
    return Room(radiance * _light(random, shape), np.maximum(nearest, 0))


def _coordinates(shape: tuple[int, int]) -> tuple[NDArray, NDArray]:
    """Rows and columns, -1..1 over the height."""
    y, x = np.indices(shape, np.float32)
    return (2 * y - shape[0]) / shape[0], (2 * x - shape[1]) / shape[0]


def _tilted(random: np.random.Generator, shape: tuple[int, int], level: float, most: float) -> Float32Array:
    """A plane of a level in the middle, changing by up to ``most`` over the picture."""
    y, x = _coordinates(shape)
    slope = random.uniform(-most, most, 2) * (random.random() < 0.6)
    return np.asarray(np.maximum(level + slope[0] * y + slope[1] * x, 0), np.float32)


def _floor(random: np.random.Generator, shape: tuple[int, int], back: float, most: float) -> _Surface:
    """A plane that comes nearer towards the bottom, from a line where it meets the wall."""
    y, x = _coordinates(shape)
    line = random.uniform(-0.8, 0.7)
    nearest = back + (most - back) * random.uniform(0.2, 1.0)
    level = back + (nearest - back) * (y - line) / (1 - line) + random.normal(0, 0.03) * most * x
    return _Surface(np.asarray(np.maximum(level, 0), np.float32), y > line)


def _object(
    random: np.random.Generator,
    shape: tuple[int, int],
    back: float,
    most: float,
    floor: _Surface | None,
    family: Family,
) -> list[_Surface]:
    """A ball, a card, a box of three faces, leaves, bars or a lattice, which stands on the floor or floats."""
    y, x = _coordinates(shape)
    level = back + (most - back) * random.uniform(0, 1)
    size = np.exp(random.uniform(np.log(0.05), np.log(0.5)))
    cy, cx = random.uniform(-1, 1), random.uniform(-1, 1) * shape[1] / shape[0]
    if floor is not None:
        foot = np.array([cy + size + 1, cx * shape[0] / shape[1] + 1]) / 2
        at = tuple((np.clip(foot, 0, 0.999) * shape).astype(int))
        level = float(floor.level[at]) if floor.mask[at] else back
    turn = random.uniform(0, np.pi)
    u = (np.cos(turn) * (x - cx) + np.sin(turn) * (y - cy)) / size
    v = (np.cos(turn) * (y - cy) - np.sin(turn) * (x - cx)) / size
    tilt = random.uniform(-0.3, 0.3, 2) * min(level + 0.5, most) * (random.random() < 0.5)
    plane = np.asarray(np.maximum(level + tilt[0] * u + tilt[1] * v, 0), np.float32)
    kind = random.choice(OBJECTS, p=family.objects)
    if kind == "ball":
        inside = u**2 + v**2 < 1
        height = np.sqrt(np.maximum(1 - u**2 - v**2, 0))
        bulge = random.uniform(0, 0.15) * (level + 1) * height
        light = random.normal(0, 1, 2)
        shading = 0.3 + 0.7 * np.clip((height + u * light[0] + v * light[1]) / np.hypot(1, np.hypot(*light)), 0, 1)
        return [_Surface(np.asarray(level + bulge, np.float32), inside, np.asarray(shading, np.float32))]
    if kind == "card":
        return [_Surface(plane, (np.abs(u) < 1) & (np.abs(v) < random.uniform(0.4, 1.5)))]
    if kind == "disc":
        return [_Surface(plane, u**2 + (v / random.uniform(0.4, 1)) ** 2 < 1)]
    if kind == "box":
        return _box(random, (y - cy) / size, (x - cx) / size, level, most)
    if kind == "leaves":
        return _leaves(random, y, x, (cy, cx), size, level)
    period, width = random.uniform(0.1, 0.4), random.uniform(0.15, 0.6)
    bars = np.mod(v * size, period) < width * period
    if family.lattice and random.random() < family.lattice:
        bars, crossing = (np.mod(axis * size, period) < 0.4 * width * period for axis in (v, u))
        bars |= crossing
    return [_Surface(plane, bars & (np.abs(u) < 2) & (np.abs(v) < 2))]


def _box(random: np.random.Generator, y: NDArray, x: NDArray, level: float, most: float) -> list[_Surface]:
    """A box that stands upright: two sides that meet at the near edge, and the top."""
    edge, height = random.uniform(-0.6, 0.6), random.uniform(0.5, 1.5)
    depth = random.uniform(0.02, 0.2) * (level + 1)
    left = level - depth * (edge - x) / (1 + edge)
    right = level - depth * (x - edge) / (1 - edge)
    sides = [(left, (x > -1) & (x < edge)), (right, (x >= edge) & (x < 1))]
    result = [_Surface(np.asarray(np.maximum(a, 0), np.float32), m & (np.abs(y) < height)) for a, m in sides]
    rise = random.uniform(0.1, 0.5)
    top = (y <= -height) & (y > -height - rise * np.minimum((x + 1) / (1 + edge), (1 - x) / (1 - edge)))
    level_of_top = level - depth * (-height - y) / rise
    return [*result, _Surface(np.asarray(np.maximum(level_of_top, 0), np.float32), top)]


def _leaves(
    random: np.random.Generator, y: NDArray, x: NDArray, centre: tuple[float, float], size: float, level: float
) -> list[_Surface]:
    """Thin ellipses around a point, each at a level of its own."""
    result = []
    for _ in range(int(random.integers(3, 12))):
        turn, thin = random.uniform(0, np.pi), random.uniform(0.05, 0.35)
        cy, cx = centre[0] + size * random.normal(0, 0.6), centre[1] + size * random.normal(0, 0.6)
        u = (np.cos(turn) * (x - cx) + np.sin(turn) * (y - cy)) / size
        v = (np.cos(turn) * (y - cy) - np.sin(turn) * (x - cx)) / (size * thin)
        own = max(level * (1 + random.normal(0, 0.08)), 0)
        tilt = random.uniform(-0.1, 0.1) * (own + 0.5)
        result.append(_Surface(np.asarray(np.maximum(own + tilt * u, 0), np.float32), u**2 + v**2 < 1))
    return result


def _painted(
    random: np.random.Generator, surface: _Surface, where: BoolArray, focus: float, look: Look
) -> Float32Array:
    """Reflectance of a surface at the samples ``where``, [channel, sample], in perspective.

    Dioptres are proportional to the level plus ``focus``, and places on a plane to those in the picture over dioptres.
    """
    tile = pattern(random, look)
    y, x = np.nonzero(where)
    level = surface.level[where]
    turn = random.uniform(0, np.pi)
    scale = np.exp(
        random.uniform(np.log(look.least_scale), np.log(1.2))
    )  # samples of the pattern per fine sample, in the middle
    near = (level + focus) / (np.median(level) + focus)
    along, across = y / near, (x - where.shape[1] / 2) / near
    u = (np.cos(turn) * across + np.sin(turn) * along) * scale + random.uniform(0, SIDE)
    v = (np.cos(turn) * along - np.sin(turn) * across) * scale + random.uniform(0, SIDE)
    slope = random.normal(0, 0.3, 2) if random.random() < 0.7 else np.zeros(2)  # of the light that falls on it
    extent = max(np.ptp(y), np.ptp(x), 1)
    shading = np.exp(0.4 * random.standard_normal() + slope @ ((np.stack([y, x]) - [[y.mean()], [x.mean()]]) / extent))
    if surface.shading is not None:
        shading *= surface.shading[where]
    return np.stack([_looked_up(channel, v, u) for channel in tile]) * shading.astype(np.float32)


def _looked_up(tile: Float32Array, v: NDArray, u: NDArray) -> Float32Array:
    """Bilinear interpolation of a periodic tile."""
    v0, u0 = np.floor(v).astype(int), np.floor(u).astype(int)
    dv, du = (v - v0).astype(np.float32), (u - u0).astype(np.float32)
    rows, columns = (v0 % SIDE, (v0 + 1) % SIDE), (u0 % SIDE, (u0 + 1) % SIDE)
    upper = tile[rows[0], columns[0]] * (1 - du) + tile[rows[0], columns[1]] * du
    lower = tile[rows[1], columns[0]] * (1 - du) + tile[rows[1], columns[1]] * du
    return upper * (1 - dv) + lower * dv


def _light(random: np.random.Generator, shape: tuple[int, int]) -> Float32Array:
    """Shading and shadows, smooth, of all channels alike."""
    small = random.standard_normal((6, 8)).astype(np.float32)
    smooth = cv2.resize(small, shape[::-1], interpolation=cv2.INTER_CUBIC)
    shading = np.exp(random.uniform(0, 0.5) * smooth)
    for _ in range(int(random.integers(0, 3))):
        shadow = np.zeros(shape, np.float32)
        corners = random.uniform(-0.2, 1.2, (4, 2)) * shape[::-1]
        cv2.fillPoly(shadow, [corners.astype(np.int32)], 1.0)
        soft = np.exp(random.uniform(0, 4))
        shadow = cv2.GaussianBlur(shadow, (0, 0), soft)
        shading *= 1 - random.uniform(0.1, 0.6) * shadow
    return shading
