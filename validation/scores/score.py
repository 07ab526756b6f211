"""Scores of a reconstruction or any depth map against the ground truth, as figures and as tables."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dasim.base.errors import InputError, kind_of
from dasim.camera import geometry
from dasim.camera.specification import Camera
from dasim.typing import BoolArray, FloatArray
from dasim.values import Capture, Reconstruction, Truth
from validation.scores import depth, pictures, texture
from validation.scores.depth import METRICS as DEPTH_METRICS
from validation.scores.depth import check_size
from validation.scores.figures import Figure
from validation.scores.margin import central, is_inside, within
from validation.scores.metrics import Metric, metric_figures

PICTURES = ("captured", "all-in-focus")
LEVEL_KEYS = ("level-median", "level-bias")
DEPTH_NEEDS = ("depth_m", "valid", "level", "boundary")  # fields of the truth; all follow from its depth
FLAT_LEVELS = 1e-3  # a scene with less depth than this has no best constant to compare with
LEAST_RANGE = 0.01  # levels of a map from which the relation of level and depth is read
FARTHEST_M = 1e4


def score(result: Reconstruction, capture: Capture, truth: Truth, *, metrics: Sequence[Metric] = ()) -> list[Figure]:
    """Figures of a reconstruction: raw and regularised depth, confidence, and pictures against the sharp truth.

    ``result``, ``capture`` and ``truth`` belong to one picture [h, w]; the capture determines which regions have
    texture. A truth that lacks a margin of the frame is scored where it is. Depth figures are named MAP.REGION.METRIC
    (:mod:`validation.scores.depth`), picture figures PICTURE.REGION.METRIC (:mod:`validation.scores.pictures`).
    ``metrics`` are a user's functions of a depth map in metres and the truth; their figures are named MAP.NAME. A truth
    without the part ``sharp_e`` has no figures of pictures. Raises InputError if the sizes differ, or if the truth
    lacks ``depth``.
    """
    _check_kinds((result, Reconstruction), (capture, Capture), (truth, Truth))
    truth.require(*DEPTH_NEEDS)
    result = within(result, truth)
    camera, textured = result.camera, central(texture.textured(capture), truth.depth_m.shape)
    check_size(result.level, truth, "reconstruction")
    raw_m = np.where(np.isfinite(result.level_raw), depth_of_level(result.level_raw, result), np.nan)
    figures = []
    for name, depth_m in (("raw", raw_m), ("regularised", result.depth_m)):
        figures += depth_figures(name, depth_m, truth, camera, textured)
        figures += metric_figures(name, depth_m, truth, metrics)
    figures += level_figures("raw", raw_m, truth, camera, textured)
    figures += confidence_figures("regularised", result.depth_m, result.confidence, truth, camera)
    return [*figures, *picture_figures(result, truth)] if truth.has("sharp_e") else figures


def score_map(
    depth_m: NDArray[Any],
    capture: Capture,
    truth: Truth,
    confidence: NDArray[Any] | None = None,
    *,
    metrics: Sequence[Metric] = (),
) -> list[Figure]:
    """Figures of any depth map [h, w] in metres, NaN where there is no estimate, and of its confidence.

    ``depth_m`` is z from the lens plane, in the size of the capture or of a truth that lacks a margin of it;
    ``confidence`` [h, w] is on any increasing scale. Raises InputError if the
    sizes differ, if the map has no depth in any pixel, or if the truth lacks ``depth``.
    """
    _check_kinds((capture, Capture), (truth, Truth))
    truth.require(*DEPTH_NEEDS)
    depth_m, shape = _checked(depth_m), truth.depth_m.shape
    if depth_m.shape == capture.raw_dn.shape and is_inside(shape, depth_m.shape):
        depth_m = central(depth_m, shape)
        confidence = None if confidence is None else central(np.asarray(confidence), shape)
    textured = central(texture.textured(capture), shape)
    figures = depth_figures("depth", depth_m, truth, capture.camera, textured)
    figures += metric_figures("depth", depth_m, truth, metrics)
    if confidence is not None:
        figures += confidence_figures("depth", depth_m, confidence, truth, capture.camera)
    return figures


def _checked(depth_m: NDArray[Any]) -> NDArray[Any]:
    """A depth map as an array of numbers; raises InputError if it holds no depth."""
    depth_m = np.asarray(depth_m)
    if depth_m.dtype.kind not in "fiu":
        raise InputError(f"score: must be a depth map of numbers, not of {depth_m.dtype}")
    if not (np.isfinite(depth_m) & (depth_m > 0)).any():
        raise InputError("score: the depth map has no depth in any pixel; depths are metres above 0")
    return depth_m


def _check_kinds(*pairs: tuple[object, type]) -> None:
    """Raise InputError if an argument has the wrong type, for example because two are swapped."""
    for value, kind in pairs:
        if not isinstance(value, kind):
            raise InputError(f"score: must be a {kind.__name__}, not {kind_of(value)}; see help(validation.score)")


def depth_of_level(level: NDArray[Any], result: Reconstruction) -> FloatArray:
    """Depth in metres of raw levels, NaN where there is none, from the regularised map's levels and depths.

    Levels are linear in dioptres. Beyond the map's own levels, the line through its smallest and its largest continues;
    for a map of a single level, the line of the camera's geometry. Levels beyond infinity are at ``FARTHEST_M``.
    """
    levels, first = np.unique(result.level, return_index=True)
    levels = levels.astype(np.float64)
    vergence = 1 / result.depth_m.ravel()[first].astype(np.float64)
    if levels[-1] - levels[0] > LEAST_RANGE:
        slope = (vergence[-1] - vergence[0]) / (levels[-1] - levels[0])
    else:
        step_px = geometry.level_blur_px(result.camera)[1]
        slope = float(np.diff(1 / geometry.depth_of_blur_m(result.camera, step_px * np.arange(2)))[0])
    inside = np.clip(level, levels[0], levels[-1])
    found = np.interp(inside, levels, vergence) + slope * (level - inside)
    return np.asarray(1 / np.maximum(found, 1 / FARTHEST_M))


def depth_figures(name: str, depth_m: NDArray[Any], truth: Truth, camera: Camera, textured: BoolArray) -> list[Figure]:
    """Scores of a depth map, named NAME.REGION.METRIC, and of the best constant map, NAME.REGION.METRIC.constant."""
    figures = []
    for score_of_region in depth.depth_scores(depth_m, truth, camera, textured):
        where = f"{name}.{score_of_region.region}"
        figures.append(Figure(f"{where}.share", score_of_region.share, "1", "the region's share of the pixels"))
        figures.append(
            Figure(f"{where}.coverage", score_of_region.coverage, "1", "share of the region with an estimate")
        )
        for key, metric in DEPTH_METRICS.items():
            figures.append(Figure(f"{where}.{key}", score_of_region.values[key], metric.unit, metric.meaning))
            best = f"best constant map: {metric.meaning}"
            figures.append(Figure(f"{where}.{key}.constant", score_of_region.constant[key], metric.unit, best))
        text = "median |l - l*| over that of the best constant map"
        constant = score_of_region.constant["level-median"]
        ratio = score_of_region.values["level-median"] / constant if constant > FLAT_LEVELS else float("nan")
        figures.append(Figure(f"{where}.level-ratio", ratio, "1", text))
    return figures


def level_figures(name: str, depth_m: NDArray[Any], truth: Truth, camera: Camera, textured: BoolArray) -> list[Figure]:
    """Errors of textured pixels by true level, from LEVEL to the next: NAME.at-LEVEL.level-median and .level-bias."""
    figures = []
    for low, median, bias in depth.by_level(depth_m, truth, camera, textured):
        where = f"textured pixels of true levels from {low:g}"
        figures.append(Figure(f"{name}.at-{low:g}.level-median", median, "level", f"{where}: median |l - l*|"))
        figures.append(Figure(f"{name}.at-{low:g}.level-bias", bias, "level", f"{where}: mean(l - l*)"))
    return figures


def picture_figures(result: Reconstruction, truth: Truth) -> list[Figure]:
    """Scores of the captured and the all-in-focus picture, PICTURE.REGION.METRIC, with gains and the blur of each
    picture and of the truth.
    """
    figures = []
    suffixes = pictures.references(result, truth)
    for one in pictures.picture_scores(result, truth):
        for suffix in suffixes:
            against = f", against {pictures.REFERENCES[suffix]}" if suffix else ""
            for key, (unit, meaning) in pictures.METRICS.items():
                for name, values in (("captured", one.captured), ("all-in-focus", one.sharpened)):
                    value = values[f"{key}{suffix}"]
                    figures.append(Figure(f"{name}.{one.region}.{key}{suffix}", value, unit, meaning + against))
            gain = one.sharpened[f"psnr{suffix}"] - one.captured[f"psnr{suffix}"]
            text = f"PSNR of the all-in-focus picture less that of the captured one{against}"
            figures.append(Figure(f"all-in-focus.{one.region}.psnr-gain{suffix}", gain, "dB", text))
    for name, picture in pictures.displayed(result, truth).items():
        text = "blur effect, 0 sharp to 1, without reference"
        figures.append(Figure(f"{name}.blur-effect", pictures.blur_effect(picture), "1", text))
    return figures


def confidence_figures(
    name: str, depth_m: NDArray[Any], confidence: NDArray[Any], truth: Truth, camera: Camera
) -> list[Figure]:
    """How well a confidence map identifies wrong estimates."""
    check_size(confidence, truth, "confidence")
    curve = depth.sparsification(depth_m, confidence, truth, camera)
    area = depth.sparsification_area(*curve)
    half = len(curve[0]) // 2
    return [
        Figure(f"{name}.sparsification", area, "level", "AUSE: area between sparsification curve and oracle's"),
        Figure(f"{name}.error-all", float(curve[1][0]), "level", "mean |l - l*|"),
        Figure(
            f"{name}.error-surer-half",
            float(curve[1][half]),
            "level",
            "mean |l - l*| of the half of the pixels with the higher confidence",
        ),
    ]


def table(figures: list[Figure]) -> str:
    """Tables for the terminal: depth maps by region, with the best constant map in brackets, by true level, and
    pictures.
    """
    values = {figure.id: figure.value for figure in figures}
    lines = [f"{f.id:<28}{f.value:>9.3f} {f.unit:<6}{f.meaning}" for f in figures if f.id.count(".") == 1]
    maps = dict.fromkeys(name.split(".")[0] for name in values if name.endswith(".constant"))
    for name in maps:
        regions = _second(values, f"{name}.", ".coverage")

        def cell(key: str, name: str = name) -> str:
            best = values.get(f"{name}.{key}.constant")
            return f"{values[f'{name}.{key}']:.3f}" + ("" if best is None else f" ({best:.3f})")

        units = {"share": "1", "coverage": "1", "level-ratio": "1"}
        units |= {key: metric.unit for key, metric in DEPTH_METRICS.items()}
        lines += ["", f"{name} depth (in brackets: the best constant map)"]
        lines += _table(regions, {f"{k:<15}{u}": [cell(f"{r}.{k}") for r in regions] for k, u in units.items()})
    for name in maps:
        if levels := [key for key in _second(values, f"{name}.", ".level-bias") if key.startswith("at-")]:
            rows = {f"{k:<15}level": [f"{values[f'{name}.{a}.{k}']:.3f}" for a in levels] for k in LEVEL_KEYS}
            lines += [
                "",
                f"{name} depth of textured pixels by true level, from",
                *_table([a[3:] for a in levels], rows),
            ]
    for suffix, against in pictures.REFERENCES.items():
        regions = _second(values, "captured.", f".psnr{suffix}")
        if not regions:
            continue
        rows = {
            f"{key:<15}{unit}": [
                f"{values[f'{name}.{region}.{key}{suffix}']:.3f}" for region in regions for name in PICTURES
            ]
            for key, (unit, _) in pictures.METRICS.items()
        }
        gains = [f"{values[f'all-in-focus.{region}.psnr-gain{suffix}']:+.3f}" for region in regions]
        rows[f"{'psnr-gain':<15}dB"] = [cell for gain in gains for cell in ("", gain)]
        lines += ["", f"pictures against {against}, away from boundaries"]
        lines += _table([f"{region} {name}" for region in regions for name in ("captured", "sharpened")], rows)
    return "\n".join(lines)


def _second(values: dict[str, float], start: str, end: str) -> list[str]:
    """Middle parts of the ids of three parts that begin with ``start`` and end with ``end``."""
    keys = [key for key in values if key.startswith(start) and key.endswith(end) and key.count(".") == 2]
    return [key.split(".")[1] for key in keys]


def _table(head: list[str], rows: dict[str, list[str]]) -> list[str]:
    lines = [f"{'':<22}" + "".join(f"{name:>20}" for name in head)]
    return lines + [f"{name:<22}" + "".join(f"{value:>20}" for value in row) for name, row in rows.items()]
