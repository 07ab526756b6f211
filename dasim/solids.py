"""Solids by formula and number: a family of meshes without files, for scenes that are drawn.

``procedural:NAME:NUMBER`` is one of ``SOLIDS``; the number is a seed that its proportions are drawn from. Solids stand
upright in scene axes (y down), centred at the origin, with the longest side of their box 1 long; texture coordinates
run once around and once from foot to top.
"""

from __future__ import annotations

from collections.abc import Callable
from difflib import get_close_matches
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from dasim.errors import InputError
from dasim.meshes import Part

FloatArray = NDArray[np.float64]
Random = np.random.Generator

AROUND, ALONG = 96, 64  # cells of a grid
MOST_SEED = 2**31 - 1


def solid(name: str, unit_m: float, where: str) -> Part:
    """The solid ``NAME`` or ``NAME:SEED`` of unit length ``unit_m``; InputError where there is none."""
    kind, colon, text = name.partition(":")
    if kind not in SOLIDS:
        near = get_close_matches(kind, SOLIDS, n=1)
        hint = f"; did you mean '{near[0]}'" if near else ""
        raise InputError(f"{where}: there are {', '.join(SOLIDS)}{hint}")
    seed = int(text) if text.isdecimal() else 0 if not colon else -1
    if not 0 <= seed <= MOST_SEED:
        raise InputError(f"{where}: the number is a seed, a whole one from 0 to {MOST_SEED}")
    part = _made(kind, seed)
    return Part(part.vertices * unit_m, part.faces, part.uv, part.normals)


def outline(name: str) -> tuple[float, float]:
    """Radius about the upright axis, and height, of ``NAME:SEED`` of unit length 1."""
    kind, _, text = name.partition(":")
    points = _points(kind, int(text))
    return float(np.sqrt((points[..., 0] ** 2 + points[..., 2] ** 2).max())), float(np.ptp(points[..., 1]))


@lru_cache(maxsize=64)
def _made(kind: str, seed: int) -> Part:
    return _skin(_points(kind, seed))


@lru_cache(maxsize=64)
def _points(kind: str, seed: int) -> FloatArray:
    """The grid of a solid, centred, its longest side 1."""
    points = SOLIDS[kind](np.random.default_rng(seed))
    low, high = points.min(axis=(0, 1)), points.max(axis=(0, 1))
    return np.asarray((points - (low + high) / 2) / (high - low).max())


def _skin(points: FloatArray) -> Part:
    """Triangles of a grid [rows, columns, xyz], first row below, the last column upon the first; faces point outwards.

    Without normals of its own: it is shaded flat, as its geometry is.
    """
    rows, columns = points.shape[:2]
    v, u = np.meshgrid(np.linspace(0, 1, rows), np.linspace(0, 1, columns), indexing="ij")
    first = (np.arange(rows - 1)[:, None] * columns + np.arange(columns - 1)).ravel()
    right, above, across = first + 1, first + columns, first + columns + 1
    faces = np.concatenate([np.stack([first, right, across], -1), np.stack([first, across, above], -1)])
    vertices = points.reshape(-1, 3)
    sides = vertices[faces]
    area = np.cross(sides[:, 1] - sides[:, 0], sides[:, 2] - sides[:, 0])
    whole = np.linalg.norm(area, axis=-1) > 1e-12  # poles and caps have faces of no area
    faces, area = faces[whole], area[whole]
    if np.einsum("ij,ij->", sides[whole].mean(axis=1), area) < 0:
        faces, area = faces[:, ::-1], -area
    return Part(vertices, faces.astype(np.uint32), np.stack([u, v], axis=-1).reshape(-1, 2))


# --- grids [ALONG + 1, AROUND + 1, xyz], foot first ----------------------------------------------


def _around() -> FloatArray:
    return np.linspace(0.0, 2 * np.pi, AROUND + 1)


def _turned(radius: FloatArray, height: FloatArray) -> FloatArray:
    """A body of revolution from the profile's ``radius`` and ``height``, each [rows]."""
    angle = _around()
    x, z = radius[:, None] * np.cos(angle), radius[:, None] * np.sin(angle)
    return np.stack([x, np.broadcast_to(-height[:, None], x.shape), z], axis=-1)


def _power(value: FloatArray, exponent: float) -> FloatArray:
    return np.sign(value) * np.abs(value) ** exponent


def _superellipsoid(random: Random) -> FloatArray:
    """Between box, ball and spindle (Barr 1981), eq. of superquadrics with exponents 0.2 to 1.6."""
    flat, round_ = random.uniform(0.2, 1.6, 2)
    size = random.uniform(0.5, 1.0, 3)
    polar, angle = np.linspace(-np.pi / 2, np.pi / 2, ALONG + 1)[:, None], _around()
    ring = _power(np.cos(polar), flat)
    return np.stack(
        [
            size[0] * ring * _power(np.cos(angle), round_),
            np.broadcast_to(-size[1] * _power(np.sin(polar), flat), (ALONG + 1, AROUND + 1)),
            size[2] * ring * _power(np.sin(angle), round_),
        ],
        axis=-1,
    )


def _vase(random: Random) -> FloatArray:
    """Turned on a lathe: foot, belly, neck and lip by a smooth curve through five radii, hollow above."""
    from scipy.interpolate import PchipInterpolator

    stations = np.array([0.0, 0.35, 0.7, 0.9, 1.0])
    radii = np.array(
        [random.uniform(a, b) for a, b in ((0.2, 0.4), (0.3, 0.55), (0.15, 0.45), (0.1, 0.3), (0.15, 0.4))]
    )
    outside = np.linspace(0.0, 1.0, ALONG * 3 // 4)
    curve = PchipInterpolator(stations, radii)
    inside = np.linspace(1.0, 0.1, ALONG + 1 - len(outside) - 2)
    wall = 0.03
    radius = np.concatenate([[0.0], curve(outside), np.maximum(curve(inside) - wall, 0.02), [0.0]])
    height = np.concatenate([[0.0], outside, inside, [0.1]])
    return _turned(radius, height * random.uniform(0.8, 1.8))


def _can(random: Random) -> FloatArray:
    """A closed cylinder or cone frustum with a small chamfer."""
    foot, top, height = random.uniform(0.3, 0.5), random.uniform(0.2, 0.5), random.uniform(0.4, 1.2)
    edge = 0.03
    side = np.linspace(edge, 1 - edge, ALONG - 3)
    radius = np.concatenate([[0.0, foot - edge], foot + (top - foot) * side, [top - edge, 0.0]])
    return _turned(radius, np.concatenate([[0.0, 0.0], side * height, [height, height]]))


def _rock(random: Random) -> FloatArray:
    """A ball, its radius displaced by plane waves of three scales, flattened."""
    polar, angle = np.linspace(-np.pi / 2, np.pi / 2, ALONG + 1)[:, None], _around()
    x, z = np.cos(polar) * np.cos(angle), np.cos(polar) * np.sin(angle)
    way = np.stack([x, np.broadcast_to(-np.sin(polar), x.shape), z], axis=-1)
    radius = np.ones(x.shape)
    for frequency, strength in ((1.7, 0.14), (3.9, 0.06), (8.5, 0.025)):
        waves = random.standard_normal((6, 3)) * frequency
        radius += strength * np.sin(way @ waves.T + random.uniform(0, 2 * np.pi, 6)).sum(axis=-1) / np.sqrt(3)
    return way * radius[..., None] * random.uniform(0.6, 1.0, 3)


def _torus_knot(random: Random) -> FloatArray:
    """A tube along the torus knot (p, q), or a plain ring, lying."""
    p, q = [(1, 0), (2, 3), (3, 2), (2, 5)][int(random.integers(4))]
    wide, tube = random.uniform(0.25, 0.4), random.uniform(0.1, 0.17)
    turn = np.linspace(0.0, 2 * np.pi, ALONG * 3 + 1)

    def curve(t: FloatArray) -> FloatArray:
        ring = 1.0 + wide * np.cos(q * t) * (q > 0)
        return np.stack([ring * np.cos(p * t), wide * np.sin(q * t), ring * np.sin(p * t)], axis=-1)

    centre = curve(turn)
    along = curve(turn + 1e-4) - curve(turn - 1e-4)
    along /= np.linalg.norm(along, axis=-1, keepdims=True)
    outwards = centre * (1.0, 0.0, 1.0)  # a frame that closes on itself
    side = np.cross(along, outwards)
    side /= np.linalg.norm(side, axis=-1, keepdims=True)
    normal = np.cross(side, along)
    angle = np.linspace(0.0, 2 * np.pi, AROUND // 4 + 1)
    ring = np.cos(angle)[:, None] * normal[:, None] + np.sin(angle)[:, None] * side[:, None]
    return centre[:, None] + tube * ring


def _pillar(outline: FloatArray, height: float, twist: float, taper: float) -> FloatArray:
    """An outline [AROUND + 1, xz] drawn upwards, turned by ``twist`` radians and tapered, with flat caps."""
    share = np.concatenate([[0.0], np.linspace(0.0, 1.0, ALONG - 1), [1.0]])
    scale = 1.0 + (taper - 1.0) * share
    scale[[0, -1]] = 0.0
    angle = twist * share
    x = scale[:, None] * (np.cos(angle)[:, None] * outline[:, 0] - np.sin(angle)[:, None] * outline[:, 1])
    z = scale[:, None] * (np.sin(angle)[:, None] * outline[:, 0] + np.cos(angle)[:, None] * outline[:, 1])
    return np.stack([x, np.broadcast_to(-height * share[:, None], x.shape), z], axis=-1)


def _polygon(corners: FloatArray) -> FloatArray:
    """Points along the sides of a polygon [n, 2], corners among them, the last upon the first; [AROUND + 1, 2]."""
    closed = np.vstack([corners, corners[:1]])
    places = np.linspace(0.0, len(corners), AROUND + 1)  # AROUND is a multiple of most numbers of corners
    return np.stack([np.interp(places, np.arange(len(closed)), closed[:, i]) for i in range(2)], axis=-1)


def _twisted_box(random: Random) -> FloatArray:
    """A square or oblong pillar, twisted by up to 100 degrees and tapered."""
    a, b = random.uniform(0.25, 0.5, 2)
    corners = np.array([[-a, -b], [a, -b], [a, b], [-a, b]])
    return _pillar(_polygon(corners), random.uniform(0.6, 1.4), random.uniform(-1.7, 1.7), random.uniform(0.5, 1.0))


def _star(random: Random) -> FloatArray:
    """A star or gear of 4 to 12 points, drawn upwards."""
    points = int(random.choice([4, 6, 8, 12]))
    inner = random.uniform(0.5, 0.8)
    angle = np.arange(2 * points) * np.pi / points
    radius = 0.5 * np.where(np.arange(2 * points) % 2, inner, 1.0)
    corners = np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=-1)
    return _pillar(_polygon(corners), random.uniform(0.2, 1.0), random.uniform(-0.8, 0.8), random.uniform(0.6, 1.0))


def _pebbles(random: Random) -> FloatArray:
    """Rounds stacked upon each other as one turned body: a bead chain, a chess man."""
    count = int(random.integers(2, 5))
    share = np.linspace(0.0, 1.0, ALONG + 1)
    place = np.clip(share * count, 0, count - 1e-9)
    size = random.uniform(0.25, 0.5, count)[np.floor(place).astype(int)]
    radius = 0.04 + size * np.sqrt(np.maximum(1 - (2 * (place % 1) - 1) ** 2, 0.0))
    radius[[0, -1]] = 0.0
    return _turned(radius, share * random.uniform(1.0, 1.6))


SOLIDS: dict[str, Callable[[Random], FloatArray]] = {
    "superellipsoid": _superellipsoid,
    "vase": _vase,
    "can": _can,
    "rock": _rock,
    "torus-knot": _torus_knot,
    "twisted-box": _twisted_box,
    "star": _star,
    "beads": _pebbles,
}
