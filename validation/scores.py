"""All scores of a reconstruction or of a foreign depth map, as figures and as a table for people."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from dasim.camera import Camera
from dasim.values import Capture, Reconstruction, Truth
from validation import depth_scores, metrics, texture
from validation.depth_scores import METRICS
from validation.metrics import Figure

Mask = NDArray[np.bool_]


def score_reconstruction(found: Reconstruction, capture: Capture, truth: Truth) -> list[Figure]:
    """Figures of a reconstruction: raw and regularised depth, confidence, pictures."""
    figures = metrics.score(found, truth)
    textured = texture.textured(capture)
    raw_m = np.where(np.isfinite(found.level_raw), metrics.depth_of_level(found.level_raw, found), np.nan)
    figures += depth_figures("raw", raw_m, truth, found.camera, textured)
    figures += depth_figures("regularised", found.depth_m, truth, found.camera, textured)
    return [*figures, *confidence_figures("regularised", found.depth_m, found.confidence, truth, found.camera)]


def score_map(depth_m: NDArray[Any], confidence: NDArray[Any] | None, capture: Capture, truth: Truth) -> list[Figure]:
    """Figures of anybody's depth map [h, w] in metres, NaN where there is no estimate, and of its confidence."""
    figures = depth_figures("depth", depth_m, truth, capture.camera, texture.textured(capture))
    if confidence is not None:
        figures += confidence_figures("depth", depth_m, confidence, truth, capture.camera)
    return figures


def depth_figures(name: str, depth_m: NDArray[Any], truth: Truth, camera: Camera, textured: Mask) -> list[Figure]:
    """Scores of a depth map: NAME.REGION.METRIC, and the same of the best constant map: NAME.REGION.METRIC.constant."""
    figures = []
    for found in depth_scores.depth_scores(depth_m, truth, camera, textured):
        where = f"{name}.{found.region}"
        figures.append(Figure(f"{where}.share", found.share, "1", "the region's share of the pixels"))
        figures.append(Figure(f"{where}.coverage", found.coverage, "1", "share of the region with an estimate"))
        for key, metric in METRICS.items():
            figures.append(Figure(f"{where}.{key}", found.values[key], metric.unit, metric.meaning))
            best = f"best constant map: {metric.meaning}"
            figures.append(Figure(f"{where}.{key}.constant", found.constant[key], metric.unit, best))
    return figures


def confidence_figures(
    name: str, depth_m: NDArray[Any], confidence: NDArray[Any], truth: Truth, camera: Camera
) -> list[Figure]:
    """How well a confidence tells which estimates are wrong."""
    depth_scores.check_size(confidence, truth, "confidence")
    curve = depth_scores.sparsification(depth_m, confidence, truth, camera)
    area = depth_scores.sparsification_area(*curve)
    half = len(curve[0]) // 2
    return [
        Figure(f"{name}.sparsification", area, "level", "AUSE: area between sparsification curve and oracle's"),
        Figure(f"{name}.error-all", float(curve[1][0]), "level", "mean |l - l*|"),
        Figure(f"{name}.error-surer-half", float(curve[1][half]), "level", "mean |l - l*|, the surer half"),
    ]


def shown(figures: list[Figure]) -> str:
    """A table a map, regions across, the best constant map's score in brackets; other figures one a line."""
    values = {figure.id: figure for figure in figures}
    maps = dict.fromkeys(name.split(".")[0] for name in values if name.endswith(".constant"))
    lines = [
        f"{figure.id:<28}{figure.value:>9.3f} {figure.unit:<6}{figure.meaning}"
        for figure in figures
        if figure.id.count(".") < 2
    ]
    for name in maps:
        regions = dict.fromkeys(
            key.split(".")[1] for key in values if key.startswith(f"{name}.") and key.count(".") > 1
        )
        lines += ["", f"{name} depth (in brackets: the best constant map)"]
        lines.append(f"{'':<15}{'':<7}" + "".join(f"{region:>18}" for region in regions))
        for key in ("share", "coverage", *METRICS):
            unit = METRICS[key].unit if key in METRICS else "1"
            cells = []
            for region in regions:
                cell = f"{values[f'{name}.{region}.{key}'].value:.3f}"
                if key in METRICS:
                    cell += f" ({values[f'{name}.{region}.{key}.constant'].value:.3f})"
                cells.append(f"{cell:>18}")
            lines.append(f"{key:<15}{unit:<7}" + "".join(cells))
    return "\n".join(lines)
