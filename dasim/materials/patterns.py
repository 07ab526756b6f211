"""Procedural images: linear weights 0..1, ``SIZE_PX`` pixels square, identical in every run.

A pattern is called ``NAME`` or ``NAME:NUMBER``; ``PATTERNS`` states the meaning, the default and the limits of the
number. Edges of geometric patterns are averages of ``OVERSAMPLING`` squared samples per pixel, against aliasing.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from typing import NamedTuple

import cv2
import numpy as np

from dasim.base.errors import InputError
from dasim.base.suggestions import did_you_mean
from dasim.typing import Float32Array

SIZE_PX = 1024
OVERSAMPLING = 4


def _positions(size: int) -> tuple[Float32Array, Float32Array]:
    """Pixel centres across [1, size] and down [size, 1], 0..1 over the image."""
    centres = ((np.arange(size) + 0.5) / size).astype(np.float32)
    return centres[None, :], centres[:, None]


def _area_average(inside: Callable[[Float32Array, Float32Array], np.ndarray]) -> Float32Array:
    """Mean over each pixel of a function of position whose values are 0 or 1."""
    x, y = _positions(SIZE_PX * OVERSAMPLING)
    result = np.empty((SIZE_PX, SIZE_PX), np.float32)
    band = 64  # rows per step, so that the oversampled image is never in memory as a whole
    for top in range(0, SIZE_PX, band):
        rows = inside(x, y[top * OVERSAMPLING : (top + band) * OVERSAMPLING]).astype(np.float32)
        result[top : top + band] = rows.reshape(band, OVERSAMPLING, SIZE_PX, OVERSAMPLING).mean(axis=(1, 3))
    return result


def _siemens_star(sectors: int) -> Float32Array:
    """A star of ``sectors`` pairs of a bright and a dark sector; grey where a pair is finer than two pixels."""
    x, y = _positions(SIZE_PX)
    resolved = np.hypot(x - 0.5, y - 0.5) * SIZE_PX * np.pi / sectors > 2.0

    def bright(x: Float32Array, y: Float32Array) -> np.ndarray:
        return np.sin(np.arctan2(y - 0.5, x - 0.5) * sectors) > 0

    return np.where(resolved, _area_average(bright), np.float32(0.5))


def _checkerboard(squares: int) -> Float32Array:
    """A checkerboard with ``squares`` across and down; the top left one is dark."""
    return _area_average(lambda x, y: (np.floor(x * squares) + np.floor(y * squares)) % 2)


def _stripes(pairs: int) -> Float32Array:
    """Vertical stripes: ``pairs`` of a dark and a bright one."""
    return _area_average(lambda x, y: np.broadcast_to(np.floor(2 * x * pairs) % 2, (len(y), x.shape[1])))


def _dead_leaves(seed: int) -> Float32Array:
    """The dead-leaves model: occluding discs of uniform grey levels (Lee, Mumford and Huang 2001).

    The density of radii r is proportional to r^-3 from 4 to 200 pixels.
    """
    random = np.random.default_rng(seed)
    fine, count = SIZE_PX * 2, 20_000
    low, high = 4.0 * 2, 200.0 * 2
    radii = (low**-2 - random.random(count) * (low**-2 - high**-2)) ** -0.5
    canvas = np.full((fine, fine), 0.5, np.float32)
    for radius, (x, y), level in zip(radii, random.random((count, 2)) * fine, random.random(count), strict=True):
        cv2.circle(canvas, (round(x), round(y)), round(radius), float(level), -1)
    return np.asarray(cv2.resize(canvas, (SIZE_PX, SIZE_PX), interpolation=cv2.INTER_AREA), np.float32)


def _fractal(seed: int, cells: tuple[int, int], octaves: int) -> Float32Array:
    """Value noise of mean 0.5 in ``octaves``, each with half the period and amplitude of the one before.

    ``cells`` are the random values across and down of the first octave.
    """
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


def _normalise(values: Float32Array, low: float = 0.0, high: float = 1.0) -> Float32Array:
    """Map the 1st and the 99th percentile linearly to ``low`` and ``high``, and clip values beyond them."""
    bottom, top = np.percentile(values, (1, 99))
    return (low + (high - low) * np.clip((values - bottom) / (top - bottom), 0.0, 1.0)).astype(np.float32)


def _noise(seed: int) -> Float32Array:
    """Clouds: value noise in seven octaves, values 0..1."""
    return _normalise(_fractal(seed, (4, 4), 7))


def _leaf_veins(pairs: int) -> Float32Array:
    """Bright veins of a leaf: a vertical midrib in the middle, ``pairs`` of curved side veins, and a fine net."""
    x, y = _positions(SIZE_PX)
    away = np.abs(x - 0.5)
    midrib = np.exp(-((away / (0.006 + 0.008 * y)) ** 2))
    phase = (y + 0.75 * away - 0.5 * away**2) * pairs  # side veins rise outwards
    distance = np.abs(phase - np.round(phase)) / pairs
    side = np.exp(-((distance / (0.0045 * (1.15 - away))) ** 2))
    ridges = 1.0 - np.abs(2.0 * _normalise(_fractal(5, (24, 24), 2)) - 1.0)
    net = 0.35 * np.clip((ridges - 0.82) / 0.18, 0.0, 1.0)
    return np.clip(np.maximum(np.maximum(midrib, 0.8 * side), net), 0.0, 1.0).astype(np.float32)


def _wood_grain(seed: int) -> Float32Array:
    """A plain-sawn board with vertical grain: growth rings stretched along the grain, and pores; 1 is late wood."""
    x, _ = _positions(SIZE_PX)
    rings = (x + 0.16 * (_fractal(seed, (3, 1), 3) - 0.5)) * 14.0
    late = (rings - np.floor(rings)) ** 2.5
    pores = _normalise(_fractal(seed + 1, (160, 8), 2))
    return np.clip(0.75 * late + 0.35 * pores**3, 0.0, 1.0).astype(np.float32)


def _weave(threads: int) -> Float32Array:
    """A plain weave of ``threads`` across and down: 1 on the crown of a thread, 0 in the gaps, varied by a tenth."""
    x, y = _positions(SIZE_PX)
    u, v = x * threads, y * threads
    over = (np.floor(u) + np.floor(v)) % 2  # 1 where the vertical thread is on top
    across, along = np.sin(np.pi * (u % 1)), np.sin(np.pi * (v % 1))
    crown = np.where(over > 0, across * (0.45 + 0.55 * along), along * (0.45 + 0.55 * across))
    uneven = 0.9 + 0.1 * _normalise(_fractal(11, (threads, threads), 2))
    return np.clip(crown * uneven, 0.0, 1.0).astype(np.float32)


def _petal(seed: int) -> Float32Array:
    """Streaks of a petal that run from the foot (bottom) to the rim and fork, over smooth clouds."""
    streaks = _normalise(_fractal(seed, (40, 2), 3))
    clouds = _normalise(_fractal(seed + 1, (3, 3), 4))
    return np.clip(0.65 * streaks + 0.35 * clouds, 0.0, 1.0).astype(np.float32)


def _skin(seed: int) -> Float32Array:
    """Skin: a fine relief with pores (small dark spots), over smooth patches."""
    relief = _normalise(_fractal(seed, (110, 110), 2), 0.25, 1.0)
    pores = np.clip((_normalise(_fractal(seed + 1, (60, 60), 1)) - 0.78) / 0.22, 0.0, 1.0)
    patches = _normalise(_fractal(seed + 2, (4, 4), 3))
    return np.clip((0.6 * relief + 0.4 * patches) * (1.0 - 0.7 * pores), 0.0, 1.0).astype(np.float32)


class _Kind(NamedTuple):
    """A pattern: its function, and the default, meaning and limits of its number."""

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
    """The pattern ``NAME`` or ``NAME:NUMBER``: linear weights 0..1, [SIZE_PX, SIZE_PX], top row first, read-only.

    Raises InputError for an unknown name and for a number outside its limits.
    """
    kind, colon, text = name.partition(":")
    if kind not in PATTERNS:
        raise InputError(f"image 'pattern:{name}': there are {', '.join(PATTERNS)}{did_you_mean(kind, PATTERNS)}")
    entry = PATTERNS[kind]
    low, high = entry.limits
    number = int(text) if text.isdecimal() else entry.default if not colon else -1
    if not low <= number <= high:
        raise InputError(f"image 'pattern:{name}': its number ({entry.meaning}) must be whole, from {low} to {high}")
    return _image(kind, number)


@lru_cache(maxsize=6)  # of one scene: they take 4 MB each
def _image(kind: str, number: int) -> Float32Array:
    image = np.ascontiguousarray(PATTERNS[kind].make(number), np.float32)
    image.setflags(write=False)
    return image
