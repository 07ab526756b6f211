"""Depth from two dual-aperture cameras side by side (sec. 6.3.1): stereo matching, and its fusion with defocus.

Disparity is linear in dioptres: x_left - x_right = b f / (p z). The cameras enter through ``px_per_dioptre`` = b f / p
alone, the baseline b times the image distance in pixels f / p.
"""

from __future__ import annotations

import math

import cv2
import numpy as np
from numpy.typing import NDArray

from dasim.typing import FloatArray

BLOCK_PX = 5  # side of the matcher's window
MAX_SHIFT_SHARE = 0.6  # largest disparity relative to the frame's width, where the pictures still overlap enough
MATCH_PX = 0.25  # standard deviation of a match, for the weights
LEVEL_SIGMA = 0.75  # standard deviation of a level of confidence 1, for the weights: the median error is half a level
LEAST_CONFIDENCE = 0.01  # lower bound of the confidence of a level; there it cannot reject a match
AGREE_SIGMAS = 3.0  # largest difference between match and defocus in standard deviations; beyond, the match is rejected
BOTH_WAYS_PX = 1.0  # largest difference between the matches from left to right and from right to left


def stereo_depth_m(left_rgb: NDArray, right_rgb: NDArray, px_per_dioptre: float, nearest_m: float) -> FloatArray:
    """Depth in metres by semi-global matching (Hirschmueller 2008, OpenCV), [h, w]; NaN without a match.

    A left-right check rejects points that the right camera does not see.

    Args:
        left_rgb: all-in-focus picture of the left camera, display values 0..1, [h, w, 3].
        right_rgb: the same of the right camera.
        px_per_dioptre: disparity per dioptre, pixels.
        nearest_m: smallest depth of the search, metres.
    """
    width = left_rgb.shape[1]
    largest_px = min(px_per_dioptre / nearest_m, MAX_SHIFT_SHARE * width)
    count = 16 * max(math.ceil(largest_px / 16), 1)
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
    consistent = np.abs(np.take_along_axis(back, partner, axis=1) - shift) <= BOTH_WAYS_PX
    return np.where((shift > 0) & consistent, px_per_dioptre / np.maximum(shift, 1e-9), np.nan)


def _disparity_px(matcher: cv2.StereoSGBM, one: NDArray, other: NDArray, count: int) -> FloatArray:
    """Leftward shift in pixels of each point of a grey picture ``one`` in the ``other``, [h, w]; <= 0 without a match.

    Both are padded on the left by ``count`` pixels, so that the search range is the same near the left edge.
    """
    padded = [cv2.copyMakeBorder(np.ascontiguousarray(g), 0, 0, count, 0, cv2.BORDER_CONSTANT) for g in (one, other)]
    return np.asarray(matcher.compute(*padded)[:, count:].astype(np.float64) / 16)


def combined_m(
    depth_m: NDArray, confidence: NDArray, stereo_m: FloatArray, px_per_dioptre: float, dioptres_per_level: float
) -> FloatArray:
    """Fusion of depth by defocus and by stereo, weighted by inverse variances in dioptres; metres, [h, w].

    Without a match, or with one that contradicts defocus, the result is the depth by defocus. The standard deviation
    of defocus is ``LEVEL_SIGMA`` divided by the confidence: an uncertain level has little weight and cannot reject a
    match. The standard deviation of a match, ``MATCH_PX``, is tens of times smaller, so a match dominates.

    Args:
        depth_m: depth by defocus, metres, [h, w].
        confidence: its confidence, 0..1, [h, w].
        stereo_m: depth by stereo, metres, [h, w]; NaN without a match.
        px_per_dioptre: disparity per dioptre, pixels.
        dioptres_per_level: vergence difference between blur levels, 1/m.
    """
    defocus_sd = LEVEL_SIGMA * dioptres_per_level / np.maximum(confidence.astype(np.float64), LEAST_CONFIDENCE)
    match_sd = MATCH_PX / px_per_dioptre
    defocus, stereo = 1 / depth_m.astype(np.float64), 1 / stereo_m
    agree = np.abs(defocus - stereo) <= AGREE_SIGMAS * np.hypot(defocus_sd, match_sd)  # False without a match
    share = defocus_sd**2 / (defocus_sd**2 + match_sd**2)
    return np.asarray(1 / np.where(agree, defocus + share * (np.nan_to_num(stereo) - defocus), defocus))
