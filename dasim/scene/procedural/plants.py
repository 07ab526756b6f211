"""Procedural flowers, leaves and grass.

A flower faces the camera (-z) and its petals meet at the origin; one unit is the radius of its corolla. It consists of
several meshes, so that each can have its own material: the petals (``daisy``, ``dahlia``, ``poppy``), ``flower-centre``
and ``flower-stem`` with two leaves. They share one origin: objects at the same position form the flower. The texture
is repeated on every petal and leaf, from the foot (v = 0) to the tip (v = 1).

Tested in tests/dasim/scene/procedural/test_library.py.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from dasim.scene.procedural.triangles import Triangles, merge, rotation_matrix, sheet, transform, tube
from dasim.typing import FloatArray


def blade(
    length: float,
    width: float,
    *,
    rise: float,
    curl: float,
    cup: float,
    tip: float,
    pleats: float = 0.0,
    detail: float = 1.0,
) -> Triangles:
    """A petal or leaf that starts at the origin, points along -y and faces -z.

    Args:
        length: from foot to tip
        width: at its widest place
        rise: angle by which it leans towards the camera at its foot, degrees
        curl: angle by which it bends back between foot and tip, degrees
        cup: how far the edges bend forward, as a share of half the local width
        tip: up to 1 for a petal's outline with a round end, above 1 for a leaf's, more pointed the larger it is
        pleats: amplitude of the folds along it, as a share of half the local width
        detail: resolution; 1 gives 32 cells along the blade and 20 across
    """
    along, across = np.linspace(1, 0, round(32 * detail) + 1), np.linspace(-1, 1, 2 * round(10 * detail) + 1)
    outline = np.sin(np.pi * along**0.75) ** 0.8 if tip > 1 else (along**0.6) * np.sqrt(1 - along**6 + 1e-9)
    wide = np.maximum(outline * (1 - along) ** (0.35 * max(tip - 1, 0)), 0.02) * width / 2
    lean = np.radians(rise - curl * along)
    step = length / (len(along) - 1)
    up = np.concatenate([np.cumsum((np.cos(lean) * step)[::-1])[::-1][1:], [0.0]])
    forward = np.concatenate([np.cumsum((np.sin(lean) * step)[::-1])[::-1][1:], [0.0]])
    x = wide[:, None] * across
    # Cup and pleats displace the blade along its own normal.
    relief = cup * wide[:, None] * across**2 + pleats * wide[:, None] * np.cos(5 * np.pi * across)
    y = -up[:, None] + relief * np.sin(lean)[:, None]
    z = -forward[:, None] - relief * np.cos(lean)[:, None]
    return sheet(np.stack(np.broadcast_arrays(x, y, z), axis=-1))


def _whorl(count: int, seed: int, *, start: float = 0.0, **shape: float) -> list[Triangles]:
    """``count`` petals at equal angles around the axis, the first at ``start`` degrees, with small random variations.

    ``shape`` holds the arguments of :func:`blade`.
    """
    random = np.random.default_rng((seed, count))
    petals = []
    for number in range(count):
        variation = shape | {
            "length": shape["length"] * (1 + 0.06 * random.normal()),
            "rise": shape["rise"] + 5 * random.normal(),
            "curl": shape["curl"] + 8 * random.normal(),
        }
        angle = start + 360 * number / count + 60 / count * random.normal() / 3
        foot = 0.06 * shape["length"] * np.array([np.sin(np.radians(angle)), -np.cos(np.radians(angle)), 0.0])
        # Every second petal lies 0.03 farther back, so that neighbours do not intersect.
        foot[2] = 0.03 * (number % 2)
        petals.append(
            transform(blade(**variation), rotation_matrix(random.normal() * 2, 6 * random.normal(), angle), foot)
        )
    return petals


def _daisy(seed: int) -> Triangles:
    lower = _whorl(13, seed, length=0.94, width=0.3, rise=12, curl=18, cup=0.2, tip=0.5, pleats=0.05)
    upper = _whorl(12, seed + 1, start=14, length=0.88, width=0.28, rise=24, curl=24, cup=0.2, tip=0.5, pleats=0.05)
    return merge(lower + upper)


def _dahlia(seed: int) -> Triangles:
    rings = [(16, 0.94, 10), (15, 0.86, 24), (13, 0.72, 38), (11, 0.55, 52), (8, 0.38, 66), (6, 0.22, 80)]
    return merge(
        [
            petal
            for ring, (count, length, rise) in enumerate(rings)
            for petal in _whorl(
                count, seed + ring, start=11.0 * ring, length=length, width=0.34 * length**0.5, rise=rise, curl=14,
                cup=0.7, tip=1.2, pleats=0.03,
            )
        ]
    )  # fmt: skip


def _poppy(seed: int) -> Triangles:
    outer = _whorl(3, seed, length=0.95, width=1.25, rise=30, curl=26, cup=0.25, tip=0.5, pleats=0.05)
    inner = _whorl(3, seed + 7, start=60, length=0.88, width=1.1, rise=46, curl=30, cup=0.25, tip=0.5, pleats=0.05)
    return merge(outer + inner)


def _flower_centre(seed: int) -> Triangles:
    """A dome of 220 florets in Vogel's spiral: small knobs, each with the whole texture."""
    random = np.random.default_rng((seed, 11))
    count, radius = 220, 0.3
    turns = np.arange(count) * np.radians(137.508)
    away = radius * np.sqrt((np.arange(count) + 0.5) / count)
    height = 0.16 * np.sqrt(np.maximum(1 - (away / radius) ** 2, 0.0)) + 0.02
    down, turn = np.linspace(0, np.pi / 2, 5)[:, None], np.linspace(-np.pi, np.pi, 9)
    knob = sheet(
        np.stack(
            np.broadcast_arrays(np.sin(down) * np.sin(turn), np.sin(down) * np.cos(turn), -1.6 * np.cos(down)), -1
        ),
        periodic=True,
    )
    knobs = [
        transform(knob, None, (r * np.sin(t), -r * np.cos(t), -h), 0.021 * (1 + 0.2 * random.normal()))
        for t, r, h in zip(turns, away, height, strict=True)
    ]
    base = np.stack(
        np.broadcast_arrays(
            radius * np.sin(down) * np.sin(turn), radius * np.sin(down) * np.cos(turn), -0.02 - 0.16 * np.cos(down)
        ),
        axis=-1,
    )
    return merge([*knobs, sheet(base, periodic=True)])


def _stem_path(seed: int) -> FloatArray:
    """Centre line of the stem [24, xyz], from behind the flower downwards, bent a little to one side."""
    lean = np.random.default_rng((seed, 12)).uniform(-0.5, 0.5)
    t = np.linspace(0, 1, 24)[:, None]
    return np.hstack([lean * t**2, 5.0 * t**1.15, 0.12 + 0.45 * np.sqrt(t + 0.002)])


def _flower_stem(seed: int) -> Triangles:
    """A stem, 5 units long, with two leaves."""
    random = np.random.default_rng((seed, 13))
    path = _stem_path(seed)
    parts = [tube(path, 0.07)]
    for place, side in ((9, 1), (14, -1)):
        leaf = blade(2.0, 0.85, rise=random.uniform(0, 30), curl=random.uniform(10, 60), cup=0.3, tip=1.3)
        parts.append(
            transform(leaf, rotation_matrix(0, random.uniform(-20, 20), side * random.uniform(35, 65)), path[place])
        )
    return merge(parts)


def _leaf(seed: int) -> Triangles:
    """One leaf of length 1 whose foot is at the origin."""
    random = np.random.default_rng((seed, 14))
    return blade(1.0, random.uniform(0.4, 0.7), rise=20, curl=random.uniform(20, 60), cup=0.25, tip=1.3, pleats=0.02)


def _foliage(seed: int) -> Triangles:
    """A bush seen from the front: leaves about 1 long fill a volume 16 wide, 12 high and 2 deep."""
    random = np.random.default_rng((seed, 15))
    kinds = [
        blade(1.0, width, rise=15, curl=curl, cup=0.3, tip=1.3, pleats=0.02, detail=0.4)
        for width, curl in ((0.55, 30), (0.65, 50), (0.8, 40))
    ]
    leaves = []
    for row in np.arange(-6.0, 6.01, 0.42):
        for column in np.arange(-8.0, 8.01, 0.5):
            at = np.array([column, row, -1.0]) + random.normal(size=3) * (0.25, 0.2, 0.45)
            at[2] = np.clip(at[2], -2.0, 0.0)
            turn = rotation_matrix(random.normal() * 22, random.normal() * 25, 180 + random.normal() * 55)
            leaves.append(transform(kinds[int(random.integers(3))], turn, at, random.uniform(0.8, 1.3)))
    return merge(leaves)


def _grass(seed: int) -> Triangles:
    """A strip of grass, 10 wide and 2 deep: 700 blades, 0.6 to 1.1 long, that stand on y = 0."""
    random = np.random.default_rng((seed, 16))
    blades = []
    for _ in range(700):
        length, rise, curl = random.uniform((0.6, 0, -45), (1.1, 25, 0))
        shape = blade(length, 0.07, rise=rise, curl=curl, cup=0.4, tip=1.3, detail=0.2)
        at = (random.uniform(-5, 5), 0.0, random.uniform(-1, 1))
        blades.append(transform(shape, rotation_matrix(0, random.uniform(-180, 180), random.normal() * 8), at))
    return merge(blades)


MESHES: dict[str, Callable[[int], Triangles]] = {
    "daisy": _daisy,
    "dahlia": _dahlia,
    "poppy": _poppy,
    "flower-centre": _flower_centre,
    "flower-stem": _flower_stem,
    "leaf": _leaf,
    "foliage": _foliage,
    "grass": _grass,
}
