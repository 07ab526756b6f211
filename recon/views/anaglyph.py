"""Stereo pairs from one picture and its depth (Fig. 12): red-cyan anaglyphs and side-by-side pictures."""

from __future__ import annotations

from typing import Literal

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray

from dasim.base.errors import InputError
from dasim.typing import Float32Array

OUTLIERS = 0.01  # share of the pixels at either end of the depth range that is clamped

Where = Literal["in", "out"]


def disparity_px(depth_m: NDArray, strongest_px: float, where: Where = "in") -> Float32Array:
    """Disparity x_right - x_left in pixels between the pictures of the right and the left eye, [h, w].

    As for two parallel cameras, it is linear in dioptres: b f / p (1 / z_0 - 1 / z), with the screen at z_0. The
    nearest and the farthest hundredth of the pixels are clamped, so that a few wrong depths cannot occupy the range of
    shifts.

    Args:
        depth_m: depth, metres, [h, w]; unknown depths (NaN) count as farthest.
        strongest_px: largest shift, pixels.
        where: ``in`` places the nearest point on the screen and the rest behind it (shift > 0), ``out`` the farthest
            point on the screen and the rest in front of it (shift < 0).
    """
    if not (np.isfinite(strongest_px) and strongest_px >= 0):
        raise InputError(f"stereo: a largest shift of {strongest_px:g} px is not allowed; give 0 or more, such as 12")
    if where not in ("in", "out"):
        raise InputError(
            f"stereo: where '{where}' is unknown; allowed are 'in' (behind the screen) and 'out' (in front of it)"
        )
    vergence = 1 / np.asarray(depth_m, np.float64)
    known = np.isfinite(vergence) & (vergence > 0)
    if not known.any():
        return np.zeros(vergence.shape, np.float32)
    low = float(np.quantile(vergence[known], OUTLIERS, method="lower"))
    high = float(np.quantile(vergence[known], 1 - OUTLIERS, method="higher"))
    vergence = np.clip(np.where(known, vergence, low), low, high)
    span = high - low if high > low else 1.0
    screen = high if where == "in" else low
    return (strongest_px * (screen - vergence) / span).astype(np.float32)


def pair(
    image: NDArray, depth_m: NDArray, strongest_px: float, where: Where = "in"
) -> tuple[Float32Array, Float32Array]:
    """Pictures [h, w, channel] for the left and the right eye, each displaced by half the disparity.

    Nearer points occlude farther ones; disocclusions are filled from the farther side of the gap.
    """
    shift = disparity_px(depth_m, strongest_px, where)
    picture = np.ascontiguousarray(image, np.float32)
    vergence = np.nan_to_num(1 / np.asarray(depth_m, np.float32), nan=0.0, posinf=0.0, neginf=0.0).astype(np.float32)
    left, right = (np.empty_like(picture) for _ in range(2))
    _displace(picture, (-shift / 2).astype(np.float32), vergence, left)
    _displace(picture, (shift / 2).astype(np.float32), vergence, right)
    return left, right


def anaglyph(left: NDArray, right: NDArray) -> Float32Array:
    """Red-cyan picture from red of the left and green and blue of the right eye's picture, display values 0..1."""
    return np.concatenate([left[..., :1], right[..., 1:]], axis=-1).astype(np.float32)


def side_by_side(left: NDArray, right: NDArray) -> Float32Array:
    """Both pictures side by side, the left eye's on the left, [h, 2 w, channel]."""
    return np.concatenate([left, right], axis=1).astype(np.float32)


@njit(cache=True, parallel=True)
def _displace(
    image: Float32Array, shift: Float32Array, vergence: Float32Array, out: Float32Array
) -> None:  # pragma: no cover - compiled
    """Render each row from the segments between neighbouring pixels, near over far; gaps repeat their farther side.

    Neighbours whose shifts differ by more than one pixel belong to different surfaces, without a segment between them.
    """
    height, width, channels = image.shape
    for y in prange(height):
        nearest = np.full(width, -1.0, np.float32)
        for x in range(width):
            start = x + shift[y, x]
            end = x + 1 + shift[y, min(x + 1, width - 1)]
            joined = x + 1 < width and abs(end - start - 1) <= 1.0
            first = int(np.ceil(start)) if joined else int(np.rint(start))
            last = int(np.floor(end)) if joined else first
            for place in range(max(first, 0), min(last, width - 1) + 1):
                part = min(max((place - start) / (end - start), 0.0), 1.0) if joined and end > start else 0.0
                if vergence[y, x] >= nearest[place]:
                    nearest[place] = vergence[y, x]
                    for c in range(channels):
                        other = image[y, min(x + 1, width - 1), c]
                        out[y, place, c] = (1 - part) * image[y, x, c] + part * other
        x = 0
        while x < width:
            if nearest[x] >= 0:
                x += 1
                continue
            end_gap = x
            while end_gap < width and nearest[end_gap] < 0:
                end_gap += 1
            source = x - 1
            if x == 0 or (end_gap < width and nearest[end_gap] < nearest[x - 1]):
                source = min(end_gap, width - 1)
            for place in range(x, end_gap):
                for c in range(channels):
                    out[y, place, c] = out[y, source, c] if source >= 0 and nearest[source] >= 0 else image[y, place, c]
            x = end_gap
