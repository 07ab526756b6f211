"""Meshes by formula, named ``NAME`` or ``NAME:SEED``; a seed gives the same triangles in every run.

``BODIES`` fit into a cube of side 1 around the origin, with random proportions. The units of plants and of the head are
those of :mod:`~dasim.scene.procedural.plants` and :mod:`~dasim.scene.procedural.mannequin`.
"""

from __future__ import annotations

from collections.abc import Callable
from difflib import get_close_matches
from functools import lru_cache

import numpy as np

from dasim.base.errors import InputError
from dasim.scene.procedural import mannequin, plants, solids
from dasim.scene.procedural.triangles import Triangles, ball, fitted, sheet, together, tube
from dasim.typing import FloatArray

PREFIX = "procedural:"
LARGEST_SEED = 2**31 - 1
_REVOLVED_SIDES = 96  # of a body of revolution


def _power(values: FloatArray, exponent: float) -> FloatArray:
    return np.sign(values) * np.abs(values) ** exponent


def _superellipsoid(seed: int) -> Triangles:
    """From a rounded box over a ball to a double cone (Barr 1981), with sides of 0.5 to 1."""
    random = np.random.default_rng((seed, 1))
    upright, level = random.uniform(0.25, 1.8, 2)
    down, turn = np.linspace(0, np.pi, 65)[:, None], np.linspace(-np.pi, np.pi, 129)
    ring, height = _power(np.sin(down), upright), _power(np.cos(down), upright)
    points = np.stack(
        np.broadcast_arrays(ring * _power(np.sin(turn), level), -height, -ring * _power(np.cos(turn), level)), axis=-1
    )
    points[:, -1] = points[:, 0]
    return fitted(sheet(points * random.uniform(0.5, 1.0, 3), round_about=True))


def _vase(seed: int) -> Triangles:
    """A body of revolution, open above: foot, belly, neck and lip of drawn widths; inside and outside."""
    from scipy.interpolate import PchipInterpolator

    random = np.random.default_rng((seed, 2))
    foot, belly, neck, lip = random.uniform((0.12, 0.25, 0.09, 0.12), (0.25, 0.42, 0.22, 0.30))
    outline = PchipInterpolator((0, random.uniform(0.25, 0.5), random.uniform(0.72, 0.85), 1), (foot, belly, neck, lip))
    height = np.linspace(1, 0, 80)
    outer = outline(height)
    inner = np.maximum(outer[::-1] - 0.02, 0.0)
    radius = np.concatenate([inner, outer, [0.0]])
    up = np.concatenate([np.maximum(height[::-1], 0.02), height, [0.0]])
    radius[0] = 0.0  # the floor within
    return fitted(_revolved(radius, up))


def _revolved(radius: FloatArray, up: FloatArray) -> Triangles:
    """A body of revolution about the upright axis; going down its outline, the outside is on the left."""
    turn = np.linspace(-np.pi, np.pi, _REVOLVED_SIDES + 1)
    points = np.stack(
        np.broadcast_arrays(radius[:, None] * np.sin(turn), -up[:, None], -radius[:, None] * np.cos(turn)), axis=-1
    )
    return sheet(points, round_about=True)


def _twisted_box(seed: int) -> Triangles:
    """An upright bar with rounded edges, twisted by up to 200 degrees and tapered, closed above and below."""
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
    return fitted(sheet(points, round_about=True))


def _knot(seed: int) -> Triangles:
    """A closed tube around a torus, p times about and q times through (a torus knot)."""
    random = np.random.default_rng((seed, 4))
    p, q = ((2, 3), (3, 2), (2, 5), (3, 4), (1, 3), (1, 0))[int(random.integers(6))]
    angle = np.linspace(0, 2 * np.pi, 481)
    ring = 1 + 0.42 * np.cos(q * angle)
    path = np.stack([ring * np.cos(p * angle), ring * np.sin(p * angle), 0.42 * np.sin(q * angle)], axis=-1)
    return fitted(tube(path, random.uniform(0.12, 0.22), 32, closed=True))


def _rock(seed: int) -> Triangles:
    """A ball with lumps and a few flat cuts."""
    random = np.random.default_rng((seed, 5))
    towards = ball(80, 160)
    radius = np.ones(towards.shape[:2])
    for octave in range(4):
        waves = random.normal(size=(10, 3)) * 2.2 * 1.9**octave
        phase = random.uniform(0, 2 * np.pi, 10)
        radius += 0.055 * 0.55**octave * np.sin(towards @ waves.T + phase).sum(axis=-1)
    for _ in range(int(random.integers(3, 8))):  # a plane at some distance cuts off what lies beyond
        normal = random.normal(size=3)
        cosine = towards @ (normal / np.linalg.norm(normal))
        radius = np.minimum(radius, random.uniform(0.62, 0.9) / np.maximum(cosine, 1e-3))
    points = towards * radius[..., None] * random.uniform(0.6, 1.0, 3)
    points[:, -1] = points[:, 0]
    return fitted(sheet(points, round_about=True))


def _chain_link(_: int) -> Triangles:
    """A fence of zigzag wires 0.1 thick that hook into their neighbours, meshes of 1 x 1, 26 wide and 20 high."""
    down = np.linspace(-10, 10, 20 * 24 + 1)
    zigzag = np.arcsin(np.sin(np.pi * down) * 0.97) / np.pi  # rounded where it hooks
    wires = []
    for number, x in enumerate(np.arange(-13, 13.5, 1.0)):
        side = (-1) ** number
        # A wire passes before one neighbour and behind the other.
        path = np.stack([x + side * 1.08 * zigzag, down, 0.06 * np.sin(np.pi * down) * side], axis=-1)
        wires.append(tube(path, 0.05, 8))
    return together(wires)


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
BODIES = ("superellipsoid", "vase", "twisted-box", "knot", "rock", *solids.MESHES)  # alone and whole, of every seed


def procedural(name: str) -> Triangles:
    """The mesh ``NAME`` or ``NAME:SEED`` (seed 0 by default); InputError where there is none."""
    kind, colon, text = name.partition(":")
    if kind not in MESHES:
        near = get_close_matches(kind, MESHES, n=1)
        hint = f"; did you mean '{near[0]}'" if near else ""
        raise InputError(f"mesh '{PREFIX}{name}': there are {', '.join(MESHES)}{hint}")
    seed = int(text) if text.isdecimal() else -1 if colon else 0
    if not 0 <= seed <= LARGEST_SEED:
        raise InputError(f"mesh '{PREFIX}{name}': the seed is a whole number from 0 to {LARGEST_SEED}")
    return _made(kind, seed)


@lru_cache(maxsize=32)
def _made(kind: str, seed: int) -> Triangles:
    return MESHES[kind](seed)
