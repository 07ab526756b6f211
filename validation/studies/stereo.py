"""Two dual-aperture cameras side by side (sec. 6.3.1): depth of defocus, of stereo, and of both."""

from __future__ import annotations

import math

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from dasim import camera as cameras
from dasim.camera import Camera
from dasim.scene import Scene, world_to_camera
from dasim.values import Reconstruction, Truth

FloatArray = NDArray[np.float64]

BLOCK_PX = 5  # of the matcher
MOST_SHIFT = 0.6  # of the frame's width: beyond, hardly anything is in both pictures
MATCH_PX = 0.25  # standard deviation of a match, for the weights
LEVEL_SIGMA = 0.5  # of a level by defocus, for the weights
AGREE_SIGMAS = 3.0  # a match farther from defocus than that is taken for wrong
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
    return np.asarray(baseline_m * cameras.intrinsic_matrix(camera)[0, 0] / np.asarray(depth_m))


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
    # as wide again to the left, so that points near the left edge can be sought as far as all others
    grey = [
        cv2.cvtColor(np.clip(r.sharp_rgb * 255, 0, 255).astype(np.uint8), cv2.COLOR_RGB2GRAY) for r in (left, right)
    ]
    padded = [cv2.copyMakeBorder(g, 0, 0, count, 0, cv2.BORDER_CONSTANT, value=0) for g in grey]
    found = matcher.compute(*padded)[:, count:].astype(np.float64) / 16
    focal_px = cameras.intrinsic_matrix(camera)[0, 0]
    return np.where(found > 0, baseline_m * focal_px / np.maximum(found, 1e-9), np.nan)


def combined_m(result: Reconstruction, stereo_m: FloatArray, baseline_m: float) -> FloatArray:
    """Both depths weighted by their variances in dioptres; defocus alone where there is no match that agrees."""
    camera = result.camera
    focal_px = cameras.intrinsic_matrix(camera)[0, 0]
    per_level = float(
        cameras.level_blur_px(camera)[1] * camera.sensor.pixel_pitch_um * 1e-6
        / (cameras.aperture_m(camera) * cameras.image_distance_m(camera))
    )  # fmt: skip
    sigma = np.array([LEVEL_SIGMA * per_level, MATCH_PX / (baseline_m * focal_px)])
    weight = 1 / sigma**2
    defocus, stereo = 1 / result.depth_m.astype(np.float64), 1 / stereo_m
    agree = np.abs(defocus - stereo) <= AGREE_SIGMAS * np.hypot(*sigma)  # False where there is none
    both = (weight[0] * defocus + weight[1] * np.nan_to_num(stereo)) / weight.sum()
    return np.asarray(1 / np.where(agree, both, defocus))


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
    """Median absolute errors in dioptres of stereo and of both, how much is matched, how much is occluded."""
    stereo = stereo_depth_m(left, right, baseline_m, nearest_m)
    both = combined_m(left, stereo, baseline_m)
    near = truth.valid & (truth.level >= -0.5)
    hidden = occluded(truth, other, left.camera, baseline_m)

    def error(depth_m: FloatArray, where: NDArray[np.bool_]) -> float:
        known = where & np.isfinite(depth_m)
        exact = truth.depth_m[known].astype(np.float64)
        return float(np.median(np.abs(1 / depth_m[known] - 1 / exact))) if known.any() else math.nan

    return {
        "stereo-median": error(stereo, near & ~hidden),
        "stereo-coverage": float(np.isfinite(stereo[near]).mean()),
        "combined-median": error(both, near),
        "occluded-share": float(hidden[near].mean()),
        "occluded-median": error(both, near & hidden),
    }
