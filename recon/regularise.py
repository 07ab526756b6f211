"""Regularised depth (sec. 5.2): raw levels averaged over pixels that look alike in infrared, eq. (13)-(14)."""

from __future__ import annotations

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray

from recon.denoise import patch_weights

Float32Array = NDArray[np.float32]

SEARCH_PX = 9
STRIDES = (1, 2, 4, 8, 16, 32)  # of the search, block by block: the last reaches 128 blocks to each side
ENOUGH = 3.0  # confident estimates in a neighbourhood that need no help from a wider one
MIN_NEED = np.float32(1e-3)  # of a wider search, so that nothing is divided by zero
PATCH_SIGMA_PX = 1.0


def regularise(
    level: Float32Array, confidence: Float32Array, guide: Float32Array, bandwidth: float
) -> tuple[Float32Array, Float32Array]:
    """Levels for every block [h, w] from raw ones (NaN: none), eq. (13); and the mean confidence of what each is
    made of, 0..1.

    d_s(p) = sum W(p, q) c(q) d(q) / sum W(p, q) c(q), W from patches of the infrared ``guide`` in units of its
    noise, eq. (14). Deviations: estimates count with their ``confidence`` c; the search of 9x9 repeats
    with growing strides, each on the sums of the one before, and a pixel takes from a wider search what it
    lacks in the narrow one, so that areas without texture are filled from around. A frame without any estimate
    gets level 0.
    """
    known = np.isfinite(level)
    weight = np.where(known, confidence, 0).astype(np.float32)
    value = np.where(known, level, 0).astype(np.float32) * weight
    if not weight.max() > 0:
        return np.zeros_like(level), np.zeros_like(level)
    patch = patch_weights(PATCH_SIGMA_PX)
    sums: list[tuple[Float32Array, Float32Array]] = []
    evidence: Float32Array | None = None
    reach = SEARCH_PX // 2
    for stride in STRIDES:
        border = reach * stride
        if border + 1 >= min(level.shape):
            break
        wide = [np.pad(a, border + 1, "reflect") for a in (guide, value, weight)]
        value, weight, norm = np.empty((3, *level.shape), np.float32)
        _spread(wide[0], wide[1], wide[2], patch, np.float32(1 / bandwidth), stride, reach, value, weight, norm)
        sums.append((value, weight))
        evidence = weight / norm if evidence is None else evidence
    everywhere = np.float32(np.average(level[known], weights=np.maximum(confidence[known], 1e-6)))
    result = np.full_like(level, everywhere)
    for value, weight in reversed(sums):
        need = np.maximum(ENOUGH - weight, MIN_NEED)
        result = (value + need * result) / (weight + need)
    return result.astype(np.float32), weight if evidence is None else evidence


@njit(cache=True, parallel=True)
def _spread(  # pragma: no cover - compiled
    guide: Float32Array,
    value: Float32Array,
    weight: Float32Array,
    patch: Float32Array,
    inverse_bandwidth: np.float32,
    stride: int,
    reach: int,
    value_out: Float32Array,
    weight_out: Float32Array,
    norm_out: Float32Array,
) -> None:
    half = patch.shape[0] // 2
    border = reach * stride + 1
    for y in prange(value_out.shape[0]):
        for x in range(value_out.shape[1]):
            cy, cx = y + border, x + border
            total = np.float32(0)
            known = np.float32(0)
            norm = np.float32(0)
            for dy in range(-reach, reach + 1):
                for dx in range(-reach, reach + 1):
                    qy, qx = cy + dy * stride, cx + dx * stride
                    distance = np.float32(0)
                    for j in range(-half, half + 1):
                        for i in range(-half, half + 1):
                            step = guide[cy + j, cx + i] - guide[qy + j, qx + i]
                            distance += patch[j + half, i + half] * step * step
                    similar = np.exp(-distance * inverse_bandwidth)
                    norm += similar
                    known += similar * weight[qy, qx]
                    total += similar * value[qy, qx]
            value_out[y, x] = total
            weight_out[y, x] = known
            norm_out[y, x] = norm
