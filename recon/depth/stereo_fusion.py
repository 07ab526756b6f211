"""Depth from two dual-aperture cameras side by side (sec. 6.3.1): stereo matching, and its fusion with defocus.

Disparity is linear in dioptres: x_left - x_right = b f / (p z), so that ``px_per_dioptre`` = b f / p, the baseline
times the image distance in pixels, is all that the cameras contribute.
"""

from __future__ import annotations

import math

import cv2
import numpy as np
from numpy.typing import NDArray

from dasim.typing import FloatArray

BLOCK_PX = 5  # side of the matcher's window
MOST_SHIFT = 0.6  # largest disparity as a share of the frame's width: beyond, the pictures hardly overlap
MATCH_PX = 0.25  # standard deviation of a match, for the weights
LEVEL_SIGMA = 0.75  # standard deviation of a confident level, for the weights: its median error is half a level
LEAST_CONFIDENCE = 0.01  # of a level: below it the level is a guess and rejects no match
AGREE_SIGMAS = 3.0  # a match farther from defocus than this many standard deviations is rejected
BOTH_WAYS_PX = 1.0  # largest difference between the matches from left to right and from right to left


def stereo_depth_m(left_rgb: NDArray, right_rgb: NDArray, px_per_dioptre: float, nearest_m: float) -> FloatArray:
    """Depth in metres by semi-global matching (Hirschmueller 2008, OpenCV), [h, w]; NaN without a match.

    ``left_rgb`` and ``right_rgb`` [h, w, 3] are all-in-focus pictures of display values 0..1. ``nearest_m`` bounds
    the search. Points that the right camera does not see are rejected by matching both ways (left-right check).
    """
    width = left_rgb.shape[1]
    most = min(px_per_dioptre / nearest_m, MOST_SHIFT * width)
    count = 16 * max(math.ceil(most / 16), 1)
    matcher = cv2.StereoSGBM.create(
        minDisparity=0,
        numDisparities=count,
        blockSize=BLOCK_PX,
        P1=8 * BLOCK_PX**2,
        P2=32 * BLOCK_PX**2,
        disp12MaxDiff=1,
        uniquenessRatio=10,
        speckleWindowSize=50,
        speckleRange=2,
        mode=cv2.STEREO_SGBM_MODE_HH,
    )
    left, right = (
        cv2.cvtColor(np.clip(picture * 255, 0, 255).astype(np.uint8), cv2.COLOR_RGB2GRAY)
        for picture in (left_rgb, right_rgb)
    )
    shift = _disparity_px(matcher, left, right, count)
    back = _disparity_px(matcher, right[:, ::-1], left[:, ::-1], count)[:, ::-1]
    partner = np.clip(np.rint(np.arange(width) - shift), 0, width - 1).astype(int)
    same = np.abs(np.take_along_axis(back, partner, axis=1) - shift) <= BOTH_WAYS_PX
    return np.where((shift > 0) & same, px_per_dioptre / np.maximum(shift, 1e-9), np.nan)


def _disparity_px(matcher: cv2.StereoSGBM, one: NDArray, other: NDArray, count: int) -> FloatArray:
    """Shift to the left of each point of a grey picture in another, pixels, [h, w]; 0 or less without a match.

    Both are padded on the left by ``count`` pixels, so that points near the left edge are searched as far as others.
    """
    padded = [cv2.copyMakeBorder(np.ascontiguousarray(g), 0, 0, count, 0, cv2.BORDER_CONSTANT) for g in (one, other)]
    return np.asarray(matcher.compute(*padded)[:, count:].astype(np.float64) / 16)


def combined_m(
    depth_m: NDArray, confidence: NDArray, stereo_m: FloatArray, px_per_dioptre: float, dioptres_per_level: float
) -> FloatArray:
    """Depth by defocus and by stereo, weighted by their inverse variances in dioptres, metres, [h, w].

    Where there is no match, or one that contradicts defocus, the depth by defocus stays. Its standard deviation is
    that of a level over its ``confidence`` 0..1, so that an uncertain level has little weight and rejects no match. A
    match's is a quarter of a pixel, tens of times less, so it dominates wherever there is one.
    """
    own = LEVEL_SIGMA * dioptres_per_level / np.maximum(confidence.astype(np.float64), LEAST_CONFIDENCE)
    match = MATCH_PX / px_per_dioptre
    defocus, stereo = 1 / depth_m.astype(np.float64), 1 / stereo_m
    agree = np.abs(defocus - stereo) <= AGREE_SIGMAS * np.hypot(own, match)  # False without a match
    share = own**2 / (own**2 + match**2)
    return np.asarray(1 / np.where(agree, defocus + share * (np.nan_to_num(stereo) - defocus), defocus))
