"""Regularised depth (sec. 5.2): nonlocal means of the raw levels with weights from infrared, eq. (13)-(14).

Tested in tests/recon/depth/test_scores.py.
"""

from __future__ import annotations

import numpy as np

from dasim.typing import Float32Array
from recon.picture.denoise import nonlocal_sums

SEARCH_PX = 9  # side of the search window, blocks
STRIDES = (1, 2, 4, 8, 16, 32)  # of successive searches, blocks; the last search extends 128 blocks to each side
SUFFICIENT_WEIGHT = 3.0  # sum of weights in a search above which a wider search is not used
MIN_WIDE_WEIGHT = np.float32(1e-3)  # of a wider search, against division by zero
PATCH_SIGMA_PX = 1.0


def regularise(
    level: Float32Array, confidence: Float32Array, guide: Float32Array, bandwidth: float
) -> tuple[Float32Array, Float32Array]:
    """Regularised level of every block, eq. (13), and the mean confidence of the estimates it averages, both [h, w].

    d_s(p) = sum W(p, q) c(q) d(q) / sum W(p, q) c(q), with the weights W of eq. (14) from patches of ``guide``.

    Deviations: estimates are weighted by their confidence c. The 9x9 search is repeated with increasing strides, each
    on the sums of the previous one; the wider search complements blocks with few estimates in the narrow one, which
    fills areas without texture from their surroundings.

    Args:
        level: raw levels, [h, w]; NaN without an estimate. A frame without any estimate gets level 0.
        confidence: confidence of the raw levels, 0..1, [h, w]. If it is 0 everywhere, all estimates have equal weights,
            and the result has no confidence either.
        guide: infrared in units of its noise, [h, w].
        bandwidth: tau of eq. (14), noise variances.
    """
    known = np.isfinite(level)
    if known.any() and not confidence[known].max() > 0:
        even, _ = regularise(level, known.astype(np.float32), guide, bandwidth)
        return even, np.zeros_like(level)
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
    mean_level = np.float32(np.average(level[known], weights=np.maximum(confidence[known], 1e-6)))
    result = np.full_like(level, mean_level)
    for value, weight in reversed(sums):
        wide_weight = np.maximum(SUFFICIENT_WEIGHT - weight, MIN_WIDE_WEIGHT)
        result = (value + wide_weight * result) / (weight + wide_weight)
    return result.astype(np.float32), weight if evidence is None else evidence
