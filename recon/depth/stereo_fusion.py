"""Two dual-aperture cameras side by side (sec. 6.3.1): depth of defocus, of stereo, and of both."""

from __future__ import annotations

import math

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from dasim.camera import geometry
from dasim.camera.specification import Camera
from dasim.scene.specification import Scene, world_to_camera
from dasim.typing import FloatArray
from dasim.values import Reconstruction, Truth

BLOCK_PX = 5  # of the matcher
MOST_SHIFT = 0.6  # of the frame's width: beyond, hardly anything is in both pictures
MATCH_PX = 0.25  # standard deviation of a match, for the weights
LEVEL_SIGMA = 0.75  # of a level by defocus where it is sure, for the weights: its median error there is half a level
LEAST_CONFIDENCE = 0.01  # of a level: below, it is a guess, which refutes no match
AGREE_SIGMAS = 3.0  # a match farther from defocus than that is taken for wrong
BOTH_WAYS_PX = 1.0  # that the matches of a point and of its partner may differ by
OCCLUDED = 0.02  # of z by which what the other camera sees there is nearer


def other_view(scene: Scene, baseline_m: float) -> Scene:
    """The scene as a camera ``baseline_m`` to the right of the first one sees it, looking in parallel."""
    right = world_to_camera(scene)[0, :3] * (100 * baseline_m)
    view = scene.view.model_copy(
        update={
            key: tuple(float(v) for v in np.add(getattr(scene.view, key), right))
            for key in ("position_cm", "look_at_cm")
        }
    )
    return scene.model_copy(update={"name": f"{scene.name}, {1e3 * baseline_m:g} mm to the right", "view": view})


def shift_px(camera: Camera, baseline_m: float, depth_m: ArrayLike) -> FloatArray:
    """Disparity x_left - x_right = b f / (p z) in pixels."""
    return np.asarray(baseline_m * geometry.intrinsic_matrix(camera)[0, 0] / np.asarray(depth_m))


def stereo_depth_m(left: Reconstruction, right: Reconstruction, baseline_m: float, nearest_m: float) -> FloatArray:
    """Depth by semi-global matching (Hirschmueller 2008, OpenCV) of both all-in-focus pictures, [h, w]; NaN without.

    ``nearest_m`` bounds the search: the nearest depth of the PSF bank.
    """
    camera = left.camera
    width = left.level.shape[1]
    most = min(float(shift_px(camera, baseline_m, np.float64(nearest_m))), MOST_SHIFT * width)
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
    grey = [
        cv2.cvtColor(np.clip(r.sharp_rgb * 255, 0, 255).astype(np.uint8), cv2.COLOR_RGB2GRAY) for r in (left, right)
    ]
    found = _disparity_px(matcher, grey[0], grey[1], count)
    back = _disparity_px(matcher, grey[1][:, ::-1], grey[0][:, ::-1], count)[:, ::-1]
    # what the other camera does not see is matched with something else, which has its own partner (sec. 2.3 there)
    partner = np.clip(np.rint(np.arange(width) - found), 0, width - 1).astype(int)
    same = np.abs(np.take_along_axis(back, partner, axis=1) - found) <= BOTH_WAYS_PX
    focal_px = geometry.intrinsic_matrix(camera)[0, 0]
    return np.where((found > 0) & same, baseline_m * focal_px / np.maximum(found, 1e-9), np.nan)


def _disparity_px(matcher: cv2.StereoSGBM, one: NDArray, other: NDArray, count: int) -> FloatArray:
    """How far points of a picture have moved to the left in another, px, [h, w]; not above 0 without a match.

    As wide again to the left, so that points near the left edge can be sought as far as all others.
    """
    padded = [cv2.copyMakeBorder(np.ascontiguousarray(g), 0, 0, count, 0, cv2.BORDER_CONSTANT) for g in (one, other)]
    return np.asarray(matcher.compute(*padded)[:, count:].astype(np.float64) / 16)


def combined_m(result: Reconstruction, stereo_m: FloatArray, baseline_m: float) -> FloatArray:
    """Both depths weighted by their variances in dioptres; defocus alone where there is no match that agrees.

    Defocus's deviation is that of a level over its confidence: an unsure level neither weighs nor refutes a match. A
    match's is that of a quarter of a pixel, tens of times less, so where it stands it decides.
    """
    camera = result.camera
    focal_px = geometry.intrinsic_matrix(camera)[0, 0]
    per_level = float(
        geometry.level_blur_px(camera)[1] * camera.sensor.pixel_pitch_um * 1e-6
        / (geometry.aperture_m(camera) * geometry.image_distance_m(camera))
    )  # fmt: skip
    own = LEVEL_SIGMA * per_level / np.maximum(result.confidence.astype(np.float64), LEAST_CONFIDENCE)
    match = MATCH_PX / (baseline_m * focal_px)
    defocus, stereo = 1 / result.depth_m.astype(np.float64), 1 / stereo_m
    agree = np.abs(defocus - stereo) <= AGREE_SIGMAS * np.hypot(own, match)  # False where there is none
    share = own**2 / (own**2 + match**2)
    return np.asarray(1 / np.where(agree, defocus + share * (np.nan_to_num(stereo) - defocus), defocus))


def occluded(left: Truth, right: Truth, camera: Camera, baseline_m: float) -> NDArray[np.bool_]:
    """Pixels of the left picture whose point the right camera does not see, [h, w]: hidden, or out of its frame."""
    height, width = left.depth_m.shape
    x = np.arange(width) - shift_px(camera, baseline_m, left.depth_m.astype(np.float64))
    inside = np.isfinite(x) & (x >= 0) & (x <= width - 1)
    column = np.clip(np.rint(np.nan_to_num(x)), 0, width - 1).astype(int)
    nearer = right.depth_m[np.arange(height)[:, None], column] < (1 - OCCLUDED) * left.depth_m
    return np.asarray(left.valid & (~inside | nearer))


def figures(
    left: Reconstruction, right: Reconstruction, truth: Truth, other: Truth, baseline_m: float, nearest_m: float
) -> dict[str, float]:
    """Errors in dioptres of defocus, of stereo and of both, how much is matched, how much is occluded.

    Of all three where both cameras see a point and it is matched, so that they compare; of both together everywhere.
    """
    stereo = stereo_depth_m(left, right, baseline_m, nearest_m)
    both = combined_m(left, stereo, baseline_m)
    near = truth.valid & (truth.level >= -0.5)
    hidden = occluded(truth, other, left.camera, baseline_m)
    matched = np.isfinite(stereo)

    def error(depth_m: NDArray, where: NDArray[np.bool_]) -> FloatArray:
        exact, found = (1 / a[where].astype(np.float64) for a in (truth.depth_m, depth_m))
        return np.asarray(np.abs(found - exact) if where.any() else [math.nan])

    seen, shade = near & ~hidden & matched, near & hidden
    return {
        "matched-defocus": float(np.median(error(left.depth_m, seen))),
        "stereo-median": float(np.median(error(stereo, seen))),
        "matched-combined": float(np.median(error(both, seen))),
        "stereo-coverage": float(matched[near].mean()),
        "combined-median": float(np.median(error(both, near))),
        "combined-rmse": float(np.sqrt(np.mean(error(both, near) ** 2))),
        "occluded-share": float(hidden[near].mean()),
        "occluded-median": float(np.median(error(both, shade))),
        "occluded-matched": float(matched[shade].mean()) if shade.any() else 0.0,
    }
