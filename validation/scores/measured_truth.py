"""Ground truth from a depth map that a user measured beside a photograph.

Tested in tests/recon/test_real_camera.py.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dasim.camera import geometry
from dasim.camera import sensor as sensors
from dasim.camera.specification import Camera
from dasim.files.truth import truth_of
from dasim.values import Reconstruction, Truth
from validation.scores.figures import Figure
from validation.scores.score import confidence_figures, depth_figures, depth_of_level


def truth_of_depth(depth_m: NDArray[Any], camera: Camera) -> Truth:
    """Levels and boundaries that follow from a depth map [h, w] in metres, NaN where nothing was measured.

    A gap in the map is not taken for a depth discontinuity.
    """
    blur = np.asarray(geometry.blur_px(camera, depth_m.astype(np.float64)))
    values = {
        "depth_m": depth_m.astype(np.float32),
        "blur_px": blur.astype(np.float32),
        "level": (blur / geometry.level_blur_px(camera)[1]).astype(np.float32),
        "channels": sensors.channels(camera.sensor),
    }
    return truth_of(values, camera, "measured depths")


def score_measured(result: Reconstruction, depth_m: NDArray[Any]) -> list[Figure]:
    """Depth figures of a reconstruction, raw and regularised, against a measured depth map of the same size.

    Texture is determined from the raw picture, which is not available here, so that the region ``inner`` holds
    everything away from boundaries.
    """
    truth = truth_of_depth(depth_m, result.camera)
    raw_m = np.where(np.isfinite(result.level_raw), depth_of_level(result.level_raw, result), np.nan)
    whole = np.ones(truth.depth_m.shape, bool)
    figures = []
    for name, estimate in (("raw", raw_m), ("regularised", result.depth_m)):
        for figure in depth_figures(name, estimate, truth, result.camera, whole):
            if f"{name}.untextured." not in figure.id:
                figures.append(replace(figure, id=figure.id.replace(f"{name}.textured.", f"{name}.inner.")))
    return [*figures, *confidence_figures("regularised", result.depth_m, result.confidence, truth, result.camera)]
