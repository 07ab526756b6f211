"""Procedural images: linear weights 0..1, ``SIZE_PX`` pixels square, the same in every run.

A pattern is named ``NAME`` or ``NAME:NUMBER``; what the number means and its default stand with each pattern.
Edges of geometric patterns are area-sampled (``OVERSAMPLING`` per side) to avoid aliasing.
"""

from __future__ import annotations

from collections.abc import Callable
from difflib import get_close_matches
from functools import lru_cache
from typing import NamedTuple

import cv2
import numpy as np

from dasim.base.errors import InputError
from dasim.typing import Float32Array

SIZE_PX = 1024
OVERSAMPLING = 4


def _positions(size: int) -> tuple[Float32Array, Float32Array]:
    """Pixel centres across and down, 0..1 over the image."""
    centres = ((np.arange(size) + 0.5) / size).astype(np.float32)
    return centres[None, :], centres[:, None]


def _area_sampled(inside: Callable[[Float32Array, Float32Array], np.ndarray]) -> Float32Array:
    """Mean over each pixel of a function of the position that is 0 or 1."""
    x, y = _positions(SIZE_PX * OVERSAMPLING)
    result = np.empty((SIZE_PX, SIZE_PX), np.float32)
    band = 64  # rows at a time: the fine image is never held as a whole
    for top in range(0, SIZE_PX, band):
        rows = inside(x, y[top * OVERSAMPLING : (top + band) * OVERSAMPLING]).astype(np.float32)
        result[top : top + band] = rows.reshape(band, OVERSAMPLING, SIZE_PX, OVERSAMPLING).mean(axis=(1, 3))
    return result


def _siemens_star(sectors: int) -> Float32Array:
    """``sectors`` pairs of a bright and a dark sector; grey where they are finer than two pixels."""
    x, y = _positions(SIZE_PX)
    resolved = np.hypot(x - 0.5, y - 0.5) * SIZE_PX * np.pi / sectors > 2.0

    def bright(x: Float32Array, y: Float32Array) -> np.ndarray:
        return np.sin(np.arctan2(y - 0.5, x - 0.5) * sectors) > 0

    return np.where(resolved, _area_sampled(bright), np.float32(0.5))


def _checkerboard(squares: int) -> Float32Array:
    """``squares`` across and down, the first dark."""
    return _area_sampled(lambda x, y: (np.floor(x * squares) + np.floor(y * squares)) % 2)


def _stripes(pairs: int) -> Float32Array:
    """``pairs`` of a dark and a bright upright stripe."""
    return _area_sampled(lambda x, y: np.broadcast_to(np.floor(2 * x * pairs) % 2, (len(y), x.shape[1])))


def _dead_leaves(seed: int) -> Float32Array:
    """Occluding discs of even grey levels, radii r as r^-3 from 4 to 200 pixels (Lee, Mumford and Huang 2001)."""
    random = np.random.default_rng(seed)
    fine, count = SIZE_PX * 2, 20_000
    low, high = 4.0 * 2, 200.0 * 2
    radii = (low**-2 - random.random(count) * (low**-2 - high**-2)) ** -0.5
    canvas = np.full((fine, fine), 0.5, np.float32)
    for radius, (x, y), level in zip(radii, random.random((count, 2)) * fine, random.random(count), strict=True):
        cv2.circle(canvas, (round(x), round(y)), round(radius), float(level), -1)
    return np.asarray(cv2.resize(canvas, (SIZE_PX, SIZE_PX), interpolation=cv2.INTER_AREA), np.float32)


def _fractal(seed: int, cells: tuple[int, int], octaves: int) -> Float32Array:
    """Value noise of mean 0.5 in ``octaves``, each twice as fine and half as strong; ``cells`` across and down."""
    random = np.random.default_rng(seed)
    total, height = np.zeros((SIZE_PX, SIZE_PX), np.float32), 0.0
    for octave in range(octaves):
        across, down = cells[0] << octave, cells[1] << octave
        coarse = random.random((down + 3, across + 3)).astype(np.float32)
        x, y = (np.arange(SIZE_PX) + 0.5) / SIZE_PX * across, (np.arange(SIZE_PX) + 0.5) / SIZE_PX * down
        maps = np.meshgrid((x + 0.5).astype(np.float32), (y + 0.5).astype(np.float32))
        total += 0.5**octave * cv2.remap(coarse, *maps, interpolation=cv2.INTER_CUBIC, borderMode=cv2.BORDER_REFLECT)
        height += 0.5**octave
    return total / np.float32(height)


def _stretched(values: Float32Array, low: float = 0.0, high: float = 1.0) -> Float32Array:
    """Values mapped so that the 1st and 99th percentile are 0 and 1, then to low..high."""
    bottom, top = np.percentile(values, (1, 99))
    return (low + (high - low) * np.clip((values - bottom) / (top - bottom), 0.0, 1.0)).astype(np.float32)


def _noise(seed: int) -> Float32Array:
    """Clouds: value noise in seven octaves, values 0..1."""
    return _stretched(_fractal(seed, (4, 4), 7))


def _leaf_veins(pairs: int) -> Float32Array:
    """Veins bright on a blade: a midrib upright in the middle, ``pairs`` of curved side veins, and a fine net."""
    x, y = _positions(SIZE_PX)
    away = np.abs(x - 0.5)
    midrib = np.exp(-((away / (0.006 + 0.008 * y)) ** 2))
    phase = (y + 0.75 * away - 0.5 * away**2) * pairs  # side veins rise outwards
    distance = np.abs(phase - np.round(phase)) / pairs
    side = np.exp(-((distance / (0.0045 * (1.15 - away))) ** 2))
    ridges = 1.0 - np.abs(2.0 * _stretched(_fractal(5, (24, 24), 2)) - 1.0)
    net = 0.35 * np.clip((ridges - 0.82) / 0.18, 0.0, 1.0)
    return np.clip(np.maximum(np.maximum(midrib, 0.8 * side), net), 0.0, 1.0).astype(np.float32)


def _wood_grain(seed: int) -> Float32Array:
    """A tangentially cut board: year rings drawn out along the grain (upright), and pores; 1 is late wood."""
    x, _ = _positions(SIZE_PX)
    rings = (x + 0.16 * (_fractal(seed, (3, 1), 3) - 0.5)) * 14.0
    late = (rings - np.floor(rings)) ** 2.5
    pores = _stretched(_fractal(seed + 1, (160, 8), 2))
    return np.clip(0.75 * late + 0.35 * pores**3, 0.0, 1.0).astype(np.float32)


def _weave(threads: int) -> Float32Array:
    """Plain weave of ``threads`` each way: 1 on a thread's crown, 0 in the gaps, yarns uneven by a tenth."""
    x, y = _positions(SIZE_PX)
    u, v = x * threads, y * threads
    over = (np.floor(u) + np.floor(v)) % 2  # 1 where the upright thread is on top
    across, along = np.sin(np.pi * (u % 1)), np.sin(np.pi * (v % 1))
    crown = np.where(over > 0, across * (0.45 + 0.55 * along), along * (0.45 + 0.55 * across))
    uneven = 0.9 + 0.1 * _stretched(_fractal(11, (threads, threads), 2))
    return np.clip(crown * uneven, 0.0, 1.0).astype(np.float32)


def _petal(seed: int) -> Float32Array:
    """Streaks that run from the foot (below) to the rim and fork, over soft clouds."""
    streaks = _stretched(_fractal(seed, (40, 2), 3))
    clouds = _stretched(_fractal(seed + 1, (3, 3), 4))
    return np.clip(0.65 * streaks + 0.35 * clouds, 0.0, 1.0).astype(np.float32)


def _skin(seed: int) -> Float32Array:
    """Fine relief with pores (small dark spots), over soft patches."""
    relief = _stretched(_fractal(seed, (110, 110), 2), 0.25, 1.0)
    pores = np.clip((_stretched(_fractal(seed + 1, (60, 60), 1)) - 0.78) / 0.22, 0.0, 1.0)
    patches = _stretched(_fractal(seed + 2, (4, 4), 3))
    return np.clip((0.6 * relief + 0.4 * patches) * (1.0 - 0.7 * pores), 0.0, 1.0).astype(np.float32)


class _Kind(NamedTuple):
    make: Callable[[int], Float32Array]
    default: int
    meaning: str
    limits: tuple[int, int]


_SEED = ("seed", (0, 2**31 - 1))
PATTERNS = {
    "siemens-star": _Kind(_siemens_star, 36, "pairs of sectors", (1, 360)),
    "checkerboard": _Kind(_checkerboard, 8, "squares across", (1, 512)),
    "stripes": _Kind(_stripes, 8, "pairs of stripes", (1, 256)),
    "dead-leaves": _Kind(_dead_leaves, 0, *_SEED),
    "noise": _Kind(_noise, 0, *_SEED),
    "leaf-veins": _Kind(_leaf_veins, 9, "pairs of side veins", (1, 40)),
    "wood-grain": _Kind(_wood_grain, 0, *_SEED),
    "weave": _Kind(_weave, 48, "threads each way", (2, 256)),
    "petal": _Kind(_petal, 0, *_SEED),
    "skin": _Kind(_skin, 0, *_SEED),
}


def pattern(name: str) -> Float32Array:
    """The pattern ``NAME`` or ``NAME:NUMBER``: linear weights 0..1, [SIZE_PX, SIZE_PX], top row first, read-only."""
    kind, colon, text = name.partition(":")
    if kind not in PATTERNS:
        near = get_close_matches(kind, PATTERNS, n=1)
        hint = f"; did you mean '{near[0]}'" if near else ""
        raise InputError(f"image 'pattern:{name}': there are {', '.join(PATTERNS)}{hint}")
    made = PATTERNS[kind]
    low, high = made.limits
    number = int(text) if text.isdecimal() else made.default if not colon else -1
    if not low <= number <= high:
        raise InputError(f"image 'pattern:{name}': the number is its {made.meaning}, a whole one from {low} to {high}")
    return _drawn(kind, number)


@lru_cache(maxsize=16)
def _drawn(kind: str, number: int) -> Float32Array:
    image = np.ascontiguousarray(PATTERNS[kind].make(number), np.float32)
    image.setflags(write=False)
    return image
