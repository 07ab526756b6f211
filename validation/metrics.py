"""Scores of a reconstruction against the ground truth of its capture."""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dasim import spectra
from dasim.camera import Camera, quantum_efficiency
from dasim.errors import InputError
from dasim.values import Reconstruction, Truth

FloatArray = NDArray[np.float64]
Mask = NDArray[np.bool_]

VISIBLE_BLUR_PX = (3.0, 15.0)  # where sharpening is judged
LEVEL_BINS = (-0.5, 0.5, 2.0, 6.0, 12.0, 29.0)
FLAT_LEVELS = 1e-3  # a scene with less depth than this has no best constant to compare with
OCCUPIED_SHARE = 0.02  # of the pixels, for a level to count
CONSTANT_STEP = 0.05  # levels between the constant maps that are tried


@dataclass(frozen=True)
class Figure:
    """One named figure of a score."""

    id: str
    value: float
    unit: str
    meaning: str
    spread: float | None = None  # standard deviation over seeds, where it was measured


def score(result: Reconstruction, truth: Truth) -> list[Figure]:
    """Figures of a reconstruction: depth in levels, the all-in-focus picture in dB.

    Depth is judged on the near side of the focus (the settings' assumption), pixels on the far side are only
    counted. "Textured" pixels are those to which the reconstruction itself gave a raw estimate: chosen
    from the capture, never from the truth. Raises InputError where the sizes differ.
    """
    if result.level.shape != truth.level.shape:
        raise InputError(
            f"reconstruction of {_size(result.level)} pixels does not fit a ground truth of {_size(truth.level)}"
        )
    near = truth.valid & (truth.level >= -0.5)
    textured = near & np.isfinite(result.level_raw)
    inner = textured & ~truth.boundary
    figures = [
        Figure("pixels-textured", _share(textured, truth.valid), "1", "share of pixels with a raw estimate"),
        Figure("pixels-far-side", _share(~near & truth.valid, truth.valid), "1", "share behind the focal plane"),
        *_level_figures("raw", "raw depth, textured pixels", result.level_raw, truth, textured),
        *_level_figures("raw-inner", "raw depth, textured, away from boundaries", result.level_raw, truth, inner),
        *_level_figures("regularised", "regularised depth, all pixels", result.level, truth, near),
        *_bin_figures(result, truth, inner),
        *_depth_figures(result, truth, near),
        *_sharpness_figures(result, truth),
    ]
    return figures


def level_error(level: NDArray[Any], truth: Truth) -> FloatArray:
    """Signed error in blur levels, NaN where either is unknown, [h, w]."""
    return np.where(truth.valid, level.astype(np.float64) - truth.level, np.nan)


def depth_of_level(level: NDArray[Any], result: Reconstruction) -> FloatArray:
    """Depth of raw levels, by the relation of level and depth that the regularised map shows."""
    order = np.argsort(result.level, axis=None)
    levels, depths = result.level.ravel()[order], result.depth_m.ravel()[order]
    return np.interp(level, levels, depths, left=depths[0], right=depths[-1])


def best_constant_error(level: FloatArray) -> float:
    """Median absolute error of the best constant map: the smallest over all constants, [n] true levels."""
    constants = np.arange(level.min(), level.max() + CONSTANT_STEP, CONSTANT_STEP)
    return min(float(np.median(np.abs(level - constant))) for constant in constants)


def balanced_error(error: FloatArray, true: FloatArray) -> tuple[float, float, list[tuple[int, float, float]]]:
    """Median absolute error with every occupied level counting the same; the best constant map's; the bins.

    ``error`` and ``true`` levels are [n]. A bin is one level of the bank, k - 1/2 to k + 1/2, occupied where it holds
    OCCUPIED_SHARE of the pixels; each is (k, its share, its median error). NaN where no bin is.
    """
    level = np.rint(true).astype(int)
    count = np.bincount(np.maximum(level, 0))
    occupied = count >= max(OCCUPIED_SHARE * len(true), 1)
    if not occupied.any():
        return float("nan"), float("nan"), []
    level = np.maximum(level, 0)
    inside = occupied[level]
    weight = 1 / count[level[inside]]
    bins = [
        (int(k), float(count[k] / len(true)), float(np.median(error[level == k]))) for k in np.flatnonzero(occupied)
    ]
    constants = np.arange(true[inside].min(), true[inside].max() + CONSTANT_STEP, CONSTANT_STEP)
    best = min(weighted_median(np.abs(true[inside] - constant), weight) for constant in constants)
    return weighted_median(np.abs(error[inside]), weight), best, bins


def weighted_median(values: FloatArray, weights: FloatArray) -> float:
    """The value up to which half of the weight lies."""
    order = np.argsort(values)
    total = np.cumsum(weights[order])
    return float(values[order][np.searchsorted(total, total[-1] / 2)])


def _level_figures(name: str, what: str, level: NDArray[Any], truth: Truth, where: Mask) -> list[Figure]:
    median = bias = bad = constant = ratio = float("nan")
    if where.any():
        error = level_error(level, truth)[where]
        median, bias = float(np.median(np.abs(error))), float(np.median(error))
        bad = float(np.mean(np.abs(error) > 2))
        constant = best_constant_error(truth.level[where].astype(np.float64))
        ratio = median / constant if constant > FLAT_LEVELS else float("nan")
    return [
        Figure(f"level-{name}-median", median, "level", f"{what}: median absolute error"),
        Figure(f"level-{name}-bias", bias, "level", f"{what}: median error"),
        Figure(f"level-{name}-bad2", bad, "1", f"{what}: share off by over 2 levels"),
        Figure(f"level-{name}-constant", constant, "level", f"{what}: the same for the best constant map"),
        Figure(f"level-{name}-ratio", ratio, "1", f"{what}: ratio of both"),
    ]


def _bin_figures(result: Reconstruction, truth: Truth, where: Mask) -> list[Figure]:
    """Raw depth by true level, since a median over all hides where it fails."""
    figures = []
    for low, high in itertools.pairwise(LEVEL_BINS):
        inside = where & (truth.level >= low) & (truth.level < high)
        error = level_error(result.level_raw, truth)[inside]
        median = float(np.median(np.abs(error))) if error.size else float("nan")
        bias = float(np.median(error)) if error.size else float("nan")
        what = f"raw depth, inner textured pixels at true levels {low:g} to {high:g}"
        name = f"level-raw-at-{max(low, 0):g}"
        figures += [
            Figure(f"{name}-median", median, "level", f"{what}: median absolute error"),
            Figure(f"{name}-bias", bias, "level", f"{what}: median error"),
        ]
    return figures


def _depth_figures(result: Reconstruction, truth: Truth, where: Mask) -> list[Figure]:
    """Metric errors of the regularised map: AbsRel = mean |d - d*| / d*, RMSE of 1/d (Eigen et al. 2014)."""
    if not where.any():
        return []
    found, exact = result.depth_m[where].astype(np.float64), truth.depth_m[where].astype(np.float64)
    dioptres = float(np.sqrt(np.mean((1 / found - 1 / exact) ** 2)))
    relative = float(np.mean(np.abs(found - exact) / exact))
    return [
        Figure("depth-rmse-dioptre", dioptres, "1/m", "regularised depth: RMSE of 1/z"),
        Figure("depth-abs-rel", relative, "1", "regularised depth: mean relative error"),
    ]


def _sharpness_figures(result: Reconstruction, truth: Truth) -> list[Figure]:
    exact = infrared_free(truth.sharp_e, result.camera)
    where = truth.valid & ~truth.boundary
    low, high = VISIBLE_BLUR_PX
    judged = where & (np.abs(truth.blur_px) >= low) & (np.abs(truth.blur_px) <= high)
    figures = []
    for name, mask, what in (
        ("blurred", judged, f"visible blur {low:g} to {high:g} px, away from boundaries"),
        ("inner", where, "all pixels away from boundaries"),
    ):
        before, after = psnr(result.linear_e, exact, mask), psnr(result.sharp_e, exact, mask)
        figures += [
            Figure(f"psnr-capture-{name}", before, "dB", f"captured picture against the sharp truth, {what}"),
            Figure(f"psnr-sharp-{name}", after, "dB", f"all-in-focus picture against the sharp truth, {what}"),
            Figure(f"psnr-gain-{name}", after - before, "dB", f"gain of the all-in-focus picture, {what}"),
        ]
    return figures


def infrared_free(image_e: NDArray[Any], camera: Camera) -> FloatArray:
    """Linear colours without infrared, eq. (7) on exact signals: [h, w, 4] -> [h, w, 3] electrons."""
    sensor = camera.sensor
    response = quantum_efficiency(sensor) * spectra.short_pass(sensor.cutoff_nm, sensor.cutoff_width_nm)
    return image_e[..., :3].astype(np.float64) - spectra.ir_crosstalk(response) * image_e[..., 3:]


def psnr(image: NDArray[Any], exact: FloatArray, where: Mask) -> float:
    """Peak signal-to-noise ratio in dB over masked pixels and all channels; the peak is the truth's 99.9th percentile.

    10 log10(peak^2 / mean squared error), linear light.
    """
    if not where.any():
        return float("nan")
    error = float(np.mean((image[where].astype(np.float64) - exact[where]) ** 2))
    peak = float(np.percentile(exact, 99.9))
    return float(10 * np.log10(peak**2 / error)) if error > 0 and peak > 0 else float("inf")


def _share(part: Mask, whole: Mask) -> float:
    return float(part.sum()) / max(float(whole.sum()), 1.0)


def _size(image: NDArray[Any]) -> str:
    return f"{image.shape[1]} x {image.shape[0]}"
