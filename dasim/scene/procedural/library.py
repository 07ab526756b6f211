"""Procedural meshes by name, ``NAME`` or ``NAME:SEED``; the same seed gives the same triangles in every run.

``BODIES`` have random proportions and are scaled so that the longest side of their bounding box, centred on the origin,
is 1. The units of plants and of the head are stated in :mod:`~dasim.scene.procedural.plants` and
:mod:`~dasim.scene.procedural.mannequin`.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache

import numpy as np

from dasim.base.errors import InputError
from dasim.base.suggestions import did_you_mean
from dasim.scene.procedural import mannequin, plants, solids
from dasim.scene.procedural.triangles import Triangles, ball, fit_unit_cube, merge, sheet, tube
from dasim.typing import FloatArray

PREFIX = "procedural:"
LARGEST_SEED = 2**31 - 1
_REVOLUTION_SIDES = 96  # cells around a body of revolution


def _power(values: FloatArray, exponent: float) -> FloatArray:
    """Power of the magnitude with the sign of the value."""
    return np.sign(values) * np.abs(values) ** exponent


def _superellipsoid(seed: int) -> Triangles:
    """A superellipsoid (Barr 1981): depending on its exponents a rounded box, a ball or a double cone.

    The three axes are scaled by 0.5 to 1.
    """
    random = np.random.default_rng((seed, 1))
    upright, level = random.uniform(0.25, 1.8, 2)
    down, turn = np.linspace(0, np.pi, 65)[:, None], np.linspace(-np.pi, np.pi, 129)
    ring, height = _power(np.sin(down), upright), _power(np.cos(down), upright)
    points = np.stack(
        np.broadcast_arrays(ring * _power(np.sin(turn), level), -height, -ring * _power(np.cos(turn), level)), axis=-1
    )
    points[:, -1] = points[:, 0]
    return fit_unit_cube(sheet(points * random.uniform(0.5, 1.0, 3), periodic=True))


def _vase(seed: int) -> Triangles:
    """A vase: a body of revolution with an inner wall, open at the top; foot, belly, neck and lip have random radii."""
    from scipy.interpolate import PchipInterpolator

    random = np.random.default_rng((seed, 2))
    foot, belly, neck, lip = random.uniform((0.12, 0.25, 0.09, 0.12), (0.25, 0.42, 0.22, 0.30))
    outline = PchipInterpolator((0, random.uniform(0.25, 0.5), random.uniform(0.72, 0.85), 1), (foot, belly, neck, lip))
    height = np.linspace(1, 0, 80)
    outer = outline(height)
    inner = np.maximum(outer[::-1] - 0.02, 0.0)
    radius = np.concatenate([inner, outer, [0.0]])
    up = np.concatenate([np.maximum(height[::-1], 0.02), height, [0.0]])
    radius[0] = 0.0  # the inner floor
    return fit_unit_cube(_revolution(radius, up))


def _revolution(radius: FloatArray, up: FloatArray) -> Triangles:
    """A body of revolution about the upright axis, from the radius and height of its profile, each [rows].

    The outside lies to the left of the direction in which the profile runs.
    """
    turn = np.linspace(-np.pi, np.pi, _REVOLUTION_SIDES + 1)
    points = np.stack(
        np.broadcast_arrays(radius[:, None] * np.sin(turn), -up[:, None], -radius[:, None] * np.cos(turn)), axis=-1
    )
    return sheet(points, periodic=True)


def _twisted_box(seed: int) -> Triangles:
    """An upright bar with rounded edges, twisted by 40 to 200 degrees, tapered towards one end and closed at both."""
    random = np.random.default_rng((seed, 3))
    twist, taper = np.radians(random.uniform(40, 200)) * random.choice((-1, 1)), random.uniform(0.45, 1.0)
    turn = np.linspace(-np.pi, np.pi, 129)
    across, deep = _power(np.sin(turn), 0.25), _power(np.cos(turn), 0.25) * random.uniform(0.5, 1.0)
    up = np.concatenate([[1.0], np.linspace(1, 0, 97), [0.0]])
    wide = np.concatenate([[0.0], 1 + (taper - 1) * np.linspace(1, 0, 97), [0.0]]) * random.uniform(0.18, 0.32)
    angle = twist * up[:, None]
    x = wide[:, None] * (across * np.cos(angle) - deep * np.sin(angle))
    z = -wide[:, None] * (across * np.sin(angle) + deep * np.cos(angle))
    points = np.stack(np.broadcast_arrays(x, -up[:, None], z), axis=-1)
    points[:, -1] = points[:, 0]
    return fit_unit_cube(sheet(points, periodic=True))


def _knot(seed: int) -> Triangles:
    """A closed tube along a torus knot, which winds p times around the axis and q times through the hole."""
    random = np.random.default_rng((seed, 4))
    p, q = ((2, 3), (3, 2), (2, 5), (3, 4), (1, 3), (1, 0))[int(random.integers(6))]
    angle = np.linspace(0, 2 * np.pi, 481)
    ring = 1 + 0.42 * np.cos(q * angle)
    path = np.stack([ring * np.cos(p * angle), ring * np.sin(p * angle), 0.42 * np.sin(q * angle)], axis=-1)
    return fit_unit_cube(tube(path, random.uniform(0.12, 0.22), 32, closed=True))


def _rock(seed: int) -> Triangles:
    """A ball with lumps from four octaves of waves and 3 to 7 flat cuts."""
    random = np.random.default_rng((seed, 5))
    towards = ball(80, 160)
    radius = np.ones(towards.shape[:2])
    for octave in range(4):
        waves = random.normal(size=(10, 3)) * 2.2 * 1.9**octave
        phase = random.uniform(0, 2 * np.pi, 10)
        radius += 0.055 * 0.55**octave * np.sin(towards @ waves.T + phase).sum(axis=-1)
    for _ in range(int(random.integers(3, 8))):  # a plane 0.62 to 0.9 from the centre cuts off a cap
        normal = random.normal(size=3)
        cosine = towards @ (normal / np.linalg.norm(normal))
        radius = np.minimum(radius, random.uniform(0.62, 0.9) / np.maximum(cosine, 1e-3))
    points = towards * radius[..., None] * random.uniform(0.6, 1.0, 3)
    points[:, -1] = points[:, 0]
    return fit_unit_cube(sheet(points, periodic=True))


def _chain_link(_: int) -> Triangles:
    """A chain-link fence 26 wide and 20 high: zigzag wires, 0.1 thick and 1 apart, interlock with their neighbours."""
    down = np.linspace(-10, 10, 20 * 24 + 1)
    zigzag = np.arcsin(np.sin(np.pi * down) * 0.97) / np.pi  # rounded at the interlocking bends
    wires = []
    for number, x in enumerate(np.arange(-13, 13.5, 1.0)):
        side = (-1) ** number
        # A wire passes in front of one neighbour and behind the other.
        path = np.stack([x + side * 1.08 * zigzag, down, 0.06 * np.sin(np.pi * down) * side], axis=-1)
        wires.append(tube(path, 0.05, 8))
    return merge(wires)


MESHES: dict[str, Callable[[int], Triangles]] = {
    "superellipsoid": _superellipsoid,
    "vase": _vase,
    "twisted-box": _twisted_box,
    "knot": _knot,
    "rock": _rock,
    "chain-link": _chain_link,
    **solids.MESHES,
    **plants.MESHES,
    **mannequin.MESHES,
}
BODIES = ("superellipsoid", "vase", "twisted-box", "knot", "rock", *solids.MESHES)  # each a complete object


def procedural(name: str) -> Triangles:
    """The mesh called ``NAME`` or ``NAME:SEED`` (default: seed 0); raises InputError for an unknown name or
    a bad seed.
    """
    kind, colon, text = name.partition(":")
    if kind not in MESHES:
        raise InputError(f"mesh '{PREFIX}{name}': there are {', '.join(MESHES)}{did_you_mean(kind, MESHES)}")
    seed = int(text) if text.isdecimal() else -1 if colon else 0
    if not 0 <= seed <= LARGEST_SEED:
        raise InputError(f"mesh '{PREFIX}{name}': the seed is a whole number from 0 to {LARGEST_SEED}")
    return _mesh_of(kind, seed)


@lru_cache(maxsize=16)  # of one scene: they take up to 8 MB each
def _mesh_of(kind: str, seed: int) -> Triangles:
    return MESHES[kind](seed)
