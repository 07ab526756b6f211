"""Scores of a depth map from any source, against the ground truth of its capture.

Every score is stated with that of the best constant map, which uses one number of the truth and no picture: a method
that is not clearly better has not measured depth.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from dasim.base.errors import InputError
from dasim.camera import geometry
from dasim.camera.specification import Camera
from dasim.typing import BoolArray, FloatArray
from dasim.values import Truth

FAR_SIDE_LEVEL = -0.5  # below it a pixel lies behind the focal plane, where the same blur means another depth
MOST_PIXELS = 5_000  # of a region, evenly spaced, in which the best constant map is looked for
CONSTANTS = 200  # constant maps that are tried, evenly spaced in dioptres
SPARSIFICATION_STEPS = 50
OCCUPIED_SHARE = 0.02  # of the pixels, for a level to count
CONSTANT_STEP = 0.05  # levels between the constant maps that balanced_error tries
LEVEL_EDGES = (-0.5, 1.0, 3.0, 6.0, 12.0, np.inf)  # of true levels that are looked at apart
MIN_DEPTH_M, MAX_DEPTH_M = 1e-3, 1e6


def near_side(truth: Truth) -> BoolArray:
    """Pixels [h, w] on the near side of the focal plane, where a blur level corresponds to one depth."""
    return np.asarray(truth.valid & (truth.level >= FAR_SIDE_LEVEL))


class Metric(NamedTuple):
    """A score of estimated depths d against true depths d*, in one number; ``best`` is its value for a perfect map."""

    unit: str
    meaning: str
    of: Callable[[Errors], float]
    best: float = 0.0


class Errors(NamedTuple):
    """Estimates and truth at the scored pixels, [n] each."""

    level: FloatArray  # signed blur level of the estimate less that of the truth
    blur_px: FloatArray  # the same in pixels of visible blur diameter
    depth_m: FloatArray
    exact_m: FloatArray


def _delta(limit: float) -> Callable[[Errors], float]:
    return lambda e: float(np.mean(np.maximum(e.depth_m / e.exact_m, e.exact_m / e.depth_m) < limit))


# Levels are steps of 1 px in the difference of both blurs (paper, sec. 5.1), unless a camera sets ``levels``. AbsRel,
# RMSE and delta: Eigen, Puhrsch and Fergus 2014, sec. 4.1. bad-n: Scharstein and Szeliski 2002, eq. (2).
METRICS: dict[str, Metric] = {
    "level-bias": Metric("level", "mean(l - l*)", lambda e: float(e.level.mean())),
    "level-std": Metric("level", "standard deviation of l - l*", lambda e: float(e.level.std())),
    "level-median": Metric("level", "median |l - l*|", lambda e: float(np.median(np.abs(e.level)))),
    "level-bad-1": Metric("1", "share with |l - l*| > 1", lambda e: float(np.mean(np.abs(e.level) > 1))),
    "level-bad-2": Metric("1", "share with |l - l*| > 2", lambda e: float(np.mean(np.abs(e.level) > 2))),
    "blur-bias": Metric("px", "mean(b - b*), visible blur diameter", lambda e: float(e.blur_px.mean())),
    "blur-std": Metric("px", "standard deviation of b - b*", lambda e: float(e.blur_px.std())),
    "blur-median": Metric("px", "median |b - b*|", lambda e: float(np.median(np.abs(e.blur_px)))),
    "blur-bad-1": Metric("1", "share with |b - b*| > 1 px", lambda e: float(np.mean(np.abs(e.blur_px) > 1))),
    "blur-bad-2": Metric("1", "share with |b - b*| > 2 px", lambda e: float(np.mean(np.abs(e.blur_px) > 2))),
    "rmse-dioptre": Metric("1/m", "sqrt(mean (1/d - 1/d*)^2)", lambda e: _rms(1 / e.depth_m - 1 / e.exact_m)),
    "abs-rel": Metric("1", "mean |d - d*| / d*", lambda e: float(np.mean(np.abs(e.depth_m / e.exact_m - 1)))),
    "rmse": Metric("m", "sqrt(mean (d - d*)^2)", lambda e: _rms(e.depth_m - e.exact_m)),
    "delta-1.05": Metric("1", "share with max(d/d*, d*/d) < 1.05", _delta(1.05), best=1.0),
    "delta-1.10": Metric("1", "share with max(d/d*, d*/d) < 1.10", _delta(1.10), best=1.0),
    "delta-1.25": Metric("1", "share with max(d/d*, d*/d) < 1.25", _delta(1.25), best=1.0),
}


class RegionScore(NamedTuple):
    """Scores of the map in one region, and for each score that of the best constant map."""

    region: str
    share: float  # of the pixels that see something
    coverage: float  # of the region's pixels with an estimate
    values: dict[str, float]
    constant: dict[str, float]


def regions(truth: Truth, texture: BoolArray) -> dict[str, BoolArray]:
    """Regions that are scored separately: the near side, its parts, and what lies behind the focus.

    ``texture`` [h, w] comes from the capture (:func:`validation.scores.texture.textured`), never from the truth.
    """
    near = near_side(truth)
    inner = near & ~truth.boundary
    return {
        "all": near,
        "textured": inner & texture,
        "untextured": inner & ~texture,
        "boundary": near & truth.boundary,
        "far-side": truth.valid & ~near,
    }


def depth_scores(depth_m: NDArray[Any], truth: Truth, camera: Camera, texture: BoolArray) -> list[RegionScore]:
    """Score a depth map [h, w] in metres, region by region; NaN or values up to 0 are pixels without an estimate.

    Only pixels with an estimate are scored, and ``coverage`` is their share. Raises InputError if the sizes differ.
    """
    check_size(depth_m, truth)
    estimated = np.isfinite(depth_m) & (depth_m > 0)
    scores = []
    for name, region in regions(truth, texture).items():
        where = region & estimated
        errors = errors_of(np.clip(depth_m[where], MIN_DEPTH_M, MAX_DEPTH_M), truth.depth_m[where], camera)
        values = {key: metric.of(errors) if where.any() else float("nan") for key, metric in METRICS.items()}
        constant = _best_constants(truth.depth_m[where].astype(np.float64), camera)
        scores.append(RegionScore(name, _share(region, truth.valid), _share(where, region), values, constant))
    return scores


def by_level(
    depth_m: NDArray[Any], truth: Truth, camera: Camera, texture: BoolArray
) -> list[tuple[float, float, float]]:
    """Median absolute error and bias in levels by true level, because figures over all levels hide where a map fails.

    Covers the region "textured". For each interval of ``LEVEL_EDGES``: its lower end, the median error and the bias
    (the mean error, as in ``METRICS``), both NaN if the truth has no such level or the map no estimate.
    """
    where = regions(truth, texture)["textured"] & np.isfinite(depth_m) & (depth_m > 0)
    error = errors_of(np.clip(depth_m[where], MIN_DEPTH_M, MAX_DEPTH_M), truth.depth_m[where], camera).level
    rows = []
    for low, high in itertools.pairwise(LEVEL_EDGES):
        part = error[(truth.level[where] >= low) & (truth.level[where] < high)]
        median, bias = (float(np.median(np.abs(part))), float(part.mean())) if part.size else (np.nan, np.nan)
        rows.append((max(low, 0.0), median, bias))
    return rows


def sparsification(
    depth_m: NDArray[Any], confidence: NDArray[Any], truth: Truth, camera: Camera
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Mean absolute level error of the most confident pixels: shares of the pixels, the error by confidence, and the
    oracle's.

    Pixels on the near side with an estimate are removed in order of increasing confidence; the oracle removes those
    with the largest error first (Ilg et al. 2018, sec. 5.1). Pixels of equal confidence are removed in an order that
    does not depend on the error.
    """
    check_size(depth_m, truth)
    where = near_side(truth) & np.isfinite(depth_m) & (depth_m > 0)
    if not where.any():
        return np.ones(1), np.full(1, np.nan), np.full(1, np.nan)
    error = np.abs(errors_of(depth_m[where], truth.depth_m[where], camera).level)
    trust = np.nan_to_num(confidence[where].astype(np.float64), nan=-np.inf)
    shuffle = np.random.default_rng(0).permutation(error.size)
    by_trust = error[shuffle][np.argsort(-trust[shuffle], kind="stable")]
    share = np.linspace(1, 1 / SPARSIFICATION_STEPS, SPARSIFICATION_STEPS)
    count = np.maximum((share * error.size).astype(int), 1)
    mean_of_first = [np.cumsum(order)[count - 1] / count for order in (by_trust, np.sort(error))]
    return share, mean_of_first[0], mean_of_first[1]


def sparsification_area(share: FloatArray, error: FloatArray, oracle: FloatArray) -> float:
    """AUSE, the area between both curves over the removed share, in levels (Ilg et al. 2018); 0 for a perfect
    confidence.
    """
    return float(np.trapezoid((error - oracle)[::-1], share[::-1]))


def level_error(level: NDArray[Any], truth: Truth) -> FloatArray:
    """Signed error in blur levels, NaN where either is unknown, [h, w]."""
    return np.where(truth.valid, level.astype(np.float64) - truth.level, np.nan)


def balanced_error(error: FloatArray, true: FloatArray) -> tuple[float, float, list[tuple[int, float, float]]]:
    """Median absolute error with equal weight for every occupied level, that of the best constant map, and the bins.

    ``error`` and ``true`` levels are [n]. A bin is one level of the bank, k - 1/2 to k + 1/2, and occupied if it holds
    OCCUPIED_SHARE of the pixels; each entry is (k, its share, its median error). NaN without an occupied bin.
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
    """The value below which half of the weight lies."""
    order = np.argsort(values)
    total = np.cumsum(weights[order])
    return float(values[order][np.searchsorted(total, total[-1] / 2)])


def check_size(image: NDArray[Any], truth: Truth, what: str = "depth map") -> None:
    """Raise InputError if a map has another size than the truth."""
    if image.shape != truth.depth_m.shape:
        mine, exact = (" x ".join(map(str, a.shape[::-1])) for a in (image, truth.depth_m))
        raise InputError(f"{what}: is {mine} pixels, the ground truth {exact}; score it at the capture's own size")


def errors_of(depth_m: NDArray[Any], exact_m: NDArray[Any], camera: Camera) -> Errors:
    """Errors of depths in metres [n], finite and above 0, against true ones."""
    estimate, exact = depth_m.astype(np.float64), exact_m.astype(np.float64)
    blur = np.asarray(geometry.blur_px(camera, estimate) - geometry.blur_px(camera, exact))
    return Errors(blur / geometry.level_blur_px(camera)[1], blur, estimate, exact)


def _best_constants(exact_m: FloatArray, camera: Camera) -> dict[str, float]:
    """Score of the best constant map in each metric; NaN for an empty region."""
    if not exact_m.size:
        return dict.fromkeys(METRICS, float("nan"))
    some = exact_m[:: max(exact_m.size // MOST_PIXELS, 1)]
    best = {key: float("inf") for key in METRICS}
    for dioptre in np.linspace(1 / some.max(), 1 / some.min(), CONSTANTS):
        errors = errors_of(np.full_like(some, 1 / dioptre), some, camera)
        for key, metric in METRICS.items():
            value = metric.of(errors)
            if abs(value - metric.best) < abs(best[key] - metric.best):
                best[key] = value
    return best


def _rms(error: FloatArray) -> float:
    return float(np.sqrt(np.mean(error**2)))


def _share(part: BoolArray, whole: BoolArray) -> float:
    return float(part.sum()) / float(whole.sum()) if whole.any() else float("nan")
