"""Regularised depth (sec. 5.2): raw levels averaged over pixels that look alike in infrared, eq. (13)-(14).

Tested in tests/recon/depth/test_scores.py.
"""

from __future__ import annotations

import numpy as np

from dasim.typing import Float32Array
from recon.picture.denoise import nonlocal_sums

SEARCH_PX = 9
STRIDES = (1, 2, 4, 8, 16, 32)  # of the search, block by block: the last reaches 128 blocks to each side
ENOUGH = 3.0  # confident estimates in a neighbourhood that need no help from a wider one
MIN_NEED = np.float32(1e-3)  # of a wider search, so that nothing is divided by zero
PATCH_SIGMA_PX = 1.0


def regularise(
    level: Float32Array, confidence: Float32Array, guide: Float32Array, bandwidth: float
) -> tuple[Float32Array, Float32Array]:
    """Levels for every block [h, w] from raw ones (NaN: none), eq. (13); and the mean confidence of the
    estimates that each averages, 0..1.

    d_s(p) = sum W(p, q) c(q) d(q) / sum W(p, q) c(q), W from patches of the infrared ``guide`` in units of its noise,
    eq. (14). Deviations: estimates are weighted by their ``confidence`` c; the search of 9x9 repeats with growing
    strides, each on the sums of the one before, and a pixel with few estimates in a narrow search is completed from the
    wider one, so that areas without texture are filled from around. A frame without any estimate gets level 0.
    """
    known = np.isfinite(level)
    weight = np.where(known, confidence, 0).astype(np.float32)
    value = np.where(known, level, 0).astype(np.float32) * weight
    if not weight.max() > 0:
        return np.zeros_like(level), np.zeros_like(level)
    sums: list[tuple[Float32Array, Float32Array]] = []
    evidence: Float32Array | None = None
    reach = SEARCH_PX // 2
    for stride in STRIDES:
        border = reach * stride
        if border + 1 >= min(level.shape):
            break
        wide = np.stack([np.pad(a, border + 1, "reflect") for a in (guide, value, weight)])
        (value, weight), norm = nonlocal_sums(wide[1:], wide[0], PATCH_SIGMA_PX, bandwidth, reach, stride)
        sums.append((value, weight))
        evidence = weight / norm if evidence is None else evidence
    everywhere = np.float32(np.average(level[known], weights=np.maximum(confidence[known], 1e-6)))
    result = np.full_like(level, everywhere)
    for value, weight in reversed(sums):
        need = np.maximum(ENOUGH - weight, MIN_NEED)
        result = (value + need * result) / (weight + need)
    return result.astype(np.float32), weight if evidence is None else evidence
