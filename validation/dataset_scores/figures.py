"""Figures of a depth map on one sample: by region, by depth and by blur.

Tested in tests/validation/test_dataset_scores.py.
"""

from __future__ import annotations

import itertools
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from dasim.camera import geometry
from dasim.camera.specification import Camera
from dasim.typing import BoolArray, FloatArray
from dasim.values import Capture, Truth
from recon.picture import mosaic
from validation.gates.claim import plain_value
from validation.scores import depth
from validation.scores.depth_edges import edge_score
from validation.scores.sharpness import BINS_PX

# Of validation.scores.depth.METRICS. The first one ranks.
METRICS = ("rmse-dioptre", "abs-rel", "delta-1.05", "delta-1.25", "level-median", "level-bias")
EDGE = "edge-f"
EDGE_TEXT = "F-score of depth edges within 3 px (validation/scores/depth_edges.py), on the near side"
DEPTH_EDGES_M = (0.0, 0.2, 0.4, 0.8, np.inf)
LIGHT_EDGES_E = (0.0, 100.0, 300.0, 1000.0, 3000.0, np.inf)  # of a sample, by the median of its green pixels
FEWEST_PX = 200  # of a part of a sample, for it to count

Figures = dict[str, dict[str, dict[str, Any]]]
"""Group (region, depth, blur), part, and value of each metric, None where it is unknown."""


def ranges(edges: tuple[float, ...], unit: str) -> dict[str, tuple[float, float]]:
    """Intervals between edges by their names, such as ``0.2-0.4 m`` and ``over 0.8 m``."""
    names = {}
    for low, high in itertools.pairwise(edges):
        name = f"over {low:g}" if np.isinf(high) else f"below {high:g}" if low == 0 else f"{low:g}-{high:g}"
        names[f"{name} {unit}"] = (low, high)
    return names


def parts(truth: Truth, texture: BoolArray) -> dict[str, dict[str, BoolArray]]:
    """Pixels [h, w] that are scored apart, by group and part; depths and blurs are those of the near side."""
    found = depth.regions(truth, texture)
    near, blur = found["all"], np.abs(truth.blur_px)
    by_depth = {
        name: near & (truth.depth_m >= low) & (truth.depth_m < high)
        for name, (low, high) in ranges(DEPTH_EDGES_M, "m").items()
    }
    by_blur = {
        f"{name.replace('over-', 'over ')} px": near & (blur >= low) & (blur < high)
        for name, (low, high) in BINS_PX.items()
    }
    return {"region": found, "depth": by_depth, "blur": by_blur}


def complete(depth_m: NDArray[Any], focus_m: float) -> FloatArray:
    """A depth map [h, w] whose gaps have the depth of the nearest pixel with an estimate.

    A map without any estimate is all in focus, which the camera knows without a picture.
    """
    known = np.isfinite(depth_m) & (depth_m > 0)
    if not known.any():
        return np.full(depth_m.shape, focus_m)
    rows, columns = ndimage.distance_transform_edt(~known, return_distances=False, return_indices=True)
    filled = np.asarray(depth_m, np.float64)[rows, columns]
    return np.clip(filled, depth.MIN_DEPTH_M, depth.MAX_DEPTH_M)


def map_figures(depth_m: FloatArray, truth: Truth, camera: Camera, texture: BoolArray) -> Figures:
    """Figures of a complete depth map [h, w] in metres; a part of fewer than ``FEWEST_PX`` pixels is left out."""
    figures: Figures = {}
    for group, own in parts(truth, texture).items():
        figures[group] = {}
        for name, where in own.items():
            if np.count_nonzero(where) < FEWEST_PX:
                continue
            errors = depth.errors_of(depth_m[where], truth.depth_m[where], camera)
            values: dict[str, Any] = {key: plain_value(depth.METRICS[key].of(errors)) for key in METRICS}
            figures[group][name] = {"pixels": int(np.count_nonzero(where)), **values}
    if "all" in figures["region"]:
        level = np.asarray(geometry.blur_px(camera, depth_m)) / float(geometry.level_blur_px(camera)[1])
        edges = edge_score(level, truth.level, depth.near_side(truth))
        figures["region"]["all"][EDGE] = plain_value(edges.f_score)
    return figures


def best_constant(truth: Truth, focus_m: float) -> FloatArray:
    """The constant depth map [h, w] with the least RMSE in dioptres on the near side: the mean of its dioptres."""
    near = truth.depth_m[depth.near_side(truth)].astype(np.float64)
    return np.full(truth.depth_m.shape, 1 / np.mean(1 / near) if near.size else focus_m)


def light_e(capture: Capture) -> float:
    """Median signal of the green pixels of a capture, electrons."""
    electrons, _ = mosaic.linearise(capture)
    block = np.array(capture.camera.sensor.mosaic)
    rows, columns = np.indices(electrons.shape)
    return float(np.median(electrons[block[rows % block.shape[0], columns % block.shape[1]] == "G"]))
