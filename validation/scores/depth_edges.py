"""Precision and recall of the depth edges of a map, within a distance of those of the truth.

Boundaries are compared as contours of pictures are (Martin, Fowlkes and Malik, PAMI 26, 2004), by the share of boundary
pixels with one of the other map within a distance, without one-to-one matching (Perazzi et al. 2016, contour accuracy
F). An edge is a relative jump between neighbours, as in the boundary metrics of monocular depth (Bochkovskii et al.
2024, "Depth Pro"), here of levels, since blur measures these.
"""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from dasim.typing import BoolArray

JUMP_LEVELS = 1.0
JUMP_SHARE = 0.1  # of the larger level
TOLERANCE_PX = 3.0
FEWEST_PX = 100  # true edge pixels, both sides of an edge counted; with fewer there is no outline to judge
NEIGHBOURS = np.ones((3, 3), np.uint8)


class EdgeScore(NamedTuple):
    """Agreement of the edges of two maps; NaN where there are none to agree on."""

    precision: float  # share of the estimated edge pixels near a true one
    recall: float  # share of the true edge pixels near an estimated one
    f_score: float  # 2 precision recall / (precision + recall)


def edges(level: NDArray, where: BoolArray) -> BoolArray:
    """Pixels [h, w] whose 3 x 3 neighbourhood spans more than a jump of max(1 level, 10 % of its largest level).

    A step between two pixels marks both, so that the edge of neither side is preferred. Only neighbourhoods within
    ``where`` count; at the frame's border they are smaller.
    """
    values = np.where(where, level, 0).astype(np.float32)
    high, low = cv2.dilate(values, NEIGHBOURS), cv2.erode(values, NEIGHBOURS)
    complete = cv2.erode(where.astype(np.uint8), NEIGHBOURS) > 0
    return np.asarray(complete & (high - low > np.maximum(JUMP_LEVELS, JUMP_SHARE * high)))


def edge_score(level: NDArray, true: NDArray, where: BoolArray, tolerance_px: float = TOLERANCE_PX) -> EdgeScore:
    """Score of the edges of a map of levels [h, w] against the true levels, in the region ``where``.

    A map without edges has an F-score of 0. NaN if the truth has fewer than ``FEWEST_PX`` edge pixels.
    """
    estimated, exact = edges(level, where), edges(true, where)
    if np.count_nonzero(exact) < FEWEST_PX:
        return EdgeScore(float("nan"), float("nan"), float("nan"))
    precision, recall = _share_near(estimated, exact, tolerance_px), _share_near(exact, estimated, tolerance_px)
    agree = precision * recall > 0  # neither is 0, nor is precision unknown
    return EdgeScore(precision, recall, 2 * precision * recall / (precision + recall) if agree else 0.0)


def _share_near(part: BoolArray, other: BoolArray, tolerance_px: float) -> float:
    """Share of the pixels of ``part`` with a pixel of ``other`` within a distance; NaN without any."""
    if not part.any():
        return float("nan")
    if not other.any():
        return 0.0
    return float(np.mean(ndimage.distance_transform_edt(~other)[part] <= tolerance_px))
