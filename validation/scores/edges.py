"""Steepness of the edges of a picture relative to the sharp truth.

Tested in tests/validation/claims/test_pictures.py.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from dasim.typing import BoolArray, FloatArray

EDGE_SHARE = 0.1  # of the pixels, those with the steepest truth
GRADIENT_SIGMA_PX = 0.7  # of the Gaussian before the differences


def slope(picture: FloatArray, exact: FloatArray, where: BoolArray) -> float:
    """Slope of the regression of a picture's gradients [2, h, w] on exact ones, at the steepest of these within a mask
    [h, w].
    """
    steep = np.hypot(*exact)
    edge = where & (steep >= np.quantile(steep[where], 1 - EDGE_SHARE))
    return float((picture * exact)[:, edge].sum() / (exact**2)[:, edge].sum())


def gradients(image: NDArray) -> FloatArray:
    """Differences along y and x of an image [h, w], slightly smoothed, [2, h, w]."""
    smooth = cv2.GaussianBlur(image.astype(np.float64), (0, 0), GRADIENT_SIGMA_PX)
    return np.stack(np.gradient(smooth))
