"""A second dual-aperture camera beside the first (sec. 6.3.1): its view, occlusion, and errors of depth."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from dasim.camera import geometry
from dasim.camera.specification import Camera
from dasim.scene.specification import Scene, world_to_camera
from dasim.typing import FloatArray
from dasim.values import Reconstruction, Truth
from recon import levels
from recon.depth.stereo_fusion import combined_m, stereo_depth_m
from validation.scores.depth import near_side

OCCLUDED = 0.02  # a point is occluded if the second camera sees a surface there that is nearer by this share of z


def other_view(scene: Scene, baseline_m: float) -> Scene:
    """The scene with a view from ``baseline_m`` to the right, parallel to the first."""
    right = world_to_camera(scene)[0, :3] * (100 * baseline_m)
    view = scene.view.model_copy(
        update={
            key: tuple(float(v) for v in np.add(getattr(scene.view, key), right))
            for key in ("position_cm", "look_at_cm")
        }
    )
    return scene.model_copy(update={"name": f"{scene.name}, {1e3 * baseline_m:g} mm to the right", "view": view})


def px_per_dioptre(camera: Camera, baseline_m: float) -> float:
    """Disparity x_left - x_right in pixels of a point at z = 1 m, b s / (p z), which is proportional to 1/z."""
    return float(baseline_m * geometry.intrinsic_matrix(camera)[0, 0])


def occluded(left: Truth, right: Truth, camera: Camera, baseline_m: float) -> NDArray[np.bool_]:
    """Mask [h, w] of pixels of the left picture whose point is hidden from the right camera or outside its frame."""
    height, width = left.depth_m.shape
    x = np.arange(width) - px_per_dioptre(camera, baseline_m) / left.depth_m.astype(np.float64)
    inside = np.isfinite(x) & (x >= 0) & (x <= width - 1)
    column = np.clip(np.rint(np.nan_to_num(x)), 0, width - 1).astype(int)
    nearer = right.depth_m[np.arange(height)[:, None], column] < (1 - OCCLUDED) * left.depth_m
    return np.asarray(left.valid & (~inside | nearer))


def errors(
    left: Reconstruction, right: Reconstruction, truth: Truth, other: Truth, baseline_m: float, level_depth_m: NDArray
) -> dict[str, float]:
    """Errors of 1/z in dioptres by defocus, by stereo and by both combined; shares of matched and occluded pixels.

    Errors of all three are computed over the pixels that both cameras see and that have a stereo match, so they are
    comparable; those of the combination also over all pixels in front of the focal plane and over the occluded ones.
    ``level_depth_m`` [level] are the depths of the PSF bank, ``other`` is the truth of the second camera.
    """
    scale = px_per_dioptre(left.camera, baseline_m)
    stereo = stereo_depth_m(left.sharp_rgb, right.sharp_rgb, scale, float(level_depth_m.min()))
    both = combined_m(left.depth_m, left.confidence, stereo, scale, levels.dioptres_per_level(level_depth_m))
    near = near_side(truth)
    hidden = occluded(truth, other, left.camera, baseline_m)
    matched = np.isfinite(stereo)

    def error(depth_m: NDArray, where: NDArray[np.bool_]) -> FloatArray:
        exact, estimated = (1 / a[where].astype(np.float64) for a in (truth.depth_m, depth_m))
        return np.asarray(np.abs(estimated - exact) if where.any() else [math.nan])

    visible, shade = near & ~hidden & matched, near & hidden
    return {
        "matched-defocus": float(np.median(error(left.depth_m, visible))),
        "stereo-median": float(np.median(error(stereo, visible))),
        "matched-combined": float(np.median(error(both, visible))),
        "stereo-coverage": float(matched[near].mean()),
        "combined-median": float(np.median(error(both, near))),
        "combined-rmse": float(np.sqrt(np.mean(error(both, near) ** 2))),
        "occluded-share": float(hidden[near].mean()),
        "occluded-median": float(np.median(error(both, shade))),
        "occluded-matched": float(matched[shade].mean()) if shade.any() else 0.0,
    }
