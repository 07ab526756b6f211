"""Scores of a map of blur levels with a standard deviation at every pixel, against the truth of its capture.

All are on the near side of the focal plane, where a level corresponds to one depth. Errors are in levels (steps of 1 px
in the difference of both blurs) or in dioptres, which are proportional: 1/d = 1/d_f + l p c / (A s), with c px of
visible blur per level, aperture A, image distance s, pixel pitch p. Their ratio to the best constant map's is the same.
"""

from __future__ import annotations

import itertools
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from dasim.camera import geometry
from dasim.camera.specification import Camera
from dasim.typing import BoolArray, FloatArray
from dasim.values import Truth
from validation.scores.depth import OCCUPIED_SHARE, check_size, regions

REGIONS = {  # of validation.scores.depth.regions
    "all": "all pixels",
    "textured": "textured pixels away from boundaries",
    "untextured": "untextured pixels away from boundaries",
    "boundary": "pixels whose blur crosses a boundary",
}
FLAT_LEVELS = 1e-3  # a region with less spread than this has no best constant to compare with
NEAR_FOCUS_LEVELS = (0.0, 2.0)  # where blur hardly changes with depth
LARGEST_SD = 28.0  # levels: a standard deviation above the range of a bank says no more than one of this size
NORMAL_MEDIAN = 0.6744897501960817  # median of |x| of a standard normal x
BOUND_BLUR_PX = np.arange(3.0, 31.0, 3.0)  # edges of the intervals of visible blur in which errors meet their bound
FEWEST_PX = 200  # pixels of an interval, for it to count


class Meaning(NamedTuple):
    """Unit and description of a score."""

    unit: str
    text: str


IN_REGION = {
    "share": Meaning("1", "share of the near side"),
    "rmse": Meaning("1/m", "sqrt(mean (1/d - 1/d*)^2)"),
    "rmse-ratio": Meaning("1", "sqrt(mean (1/d - 1/d*)^2) over that of the best constant map"),
    "error": Meaning("level", "mean |l - l*|"),
    "error-constant": Meaning("level", "mean |l - l*| of the constant map with the least"),
    "error-median": Meaning("level", "median |l - l*|"),
    "within-sd": Meaning("1", "share with |l - l*| up to the stated standard deviation"),
}
MEANINGS = {
    **{
        f"{region}.{name}": Meaning(unit, f"{text}, {where}")
        for region, where in REGIONS.items()
        for name, (unit, text) in IN_REGION.items()
    },
    "half.error-median": Meaning("level", "median |l - l*| of the half with the least stated standard deviation"),
    "near-focus.share": Meaning("1", "share of the near side with a true level of 0 to 2"),
    "near-focus.bias": Meaning("level", "mean(l - l*) where the true level is 0 to 2"),
    "near-focus.abs-bias": Meaning("level", "|mean(l - l*)| where the true level is 0 to 2"),
    "near-focus.rms": Meaning("level", "sqrt(mean (l - l*)^2) where the true level is 0 to 2"),
    "near-focus.sd": Meaning("level", "mean stated standard deviation where the true level is 0 to 2"),
}


def map_scores(
    level: NDArray, sd: NDArray, truth: Truth, texture: BoolArray, dioptres_per_level: float
) -> dict[str, float]:
    """Every score of ``MEANINGS``; NaN where a region is empty, or a constant map needs no error at all.

    Args:
        level: estimated levels [h, w], finite.
        sd: their standard deviation [h, w] in levels, 0 to infinity.
        truth: the truth of the capture.
        texture: pixels [h, w] with texture, judged from the capture (:func:`validation.scores.texture.textured`).
        dioptres_per_level: :func:`level_dioptres` of the camera.
    """
    check_size(level, truth, "map of levels")
    error = level.astype(np.float64) - truth.level
    stated = np.minimum(np.asarray(sd, np.float64), LARGEST_SD)
    parts = regions(truth, texture)
    near = parts["all"]
    scores: dict[str, float] = {}
    for name in REGIONS:
        where = parts[name]
        values = _in_region(error[where], truth.level[where].astype(np.float64), stated[where], dioptres_per_level)
        values["share"] = _share(where, near)
        scores |= {f"{name}.{key}": value for key, value in values.items()}
    scores["half.error-median"] = half_coverage_error(error[near], stated[near])
    return scores | _near_focus(error, stated, truth.level, near)


def level_dioptres(camera: Camera) -> float:
    """Dioptres between neighbouring levels of a camera."""
    near_m = float(geometry.depth_of_blur_m(camera, float(geometry.level_blur_px(camera)[1])))
    return 1 / near_m - 1 / camera.lens.focus_distance_m


def _in_region(error: FloatArray, true: FloatArray, sd: FloatArray, dioptres_per_level: float) -> dict[str, float]:
    if not error.size:
        return dict.fromkeys(IN_REGION, float("nan"))
    size = np.abs(error)
    rms, spread = float(np.sqrt(np.mean(error**2))), float(true.std())  # of the mean of all dioptres, the best constant
    return {
        "rmse": rms * dioptres_per_level,
        "rmse-ratio": rms / spread if spread > FLAT_LEVELS else float("nan"),
        "error": float(size.mean()),
        "error-constant": float(np.abs(true - np.median(true)).mean()),
        "error-median": float(np.median(size)),
        "within-sd": float(np.mean(size <= sd)),
    }


def half_coverage_error(error: FloatArray, sd: FloatArray) -> float:
    """Median absolute error of the half of the pixels [n] with the least standard deviation; NaN without pixels.

    Pixels of equal standard deviation are taken in an order that does not depend on the error.
    """
    shuffle = np.random.default_rng(0).permutation(error.size)
    surest = shuffle[np.argsort(sd[shuffle], kind="stable")][: (error.size + 1) // 2]
    return float(np.median(np.abs(error[surest]))) if surest.size else float("nan")


def _near_focus(error: FloatArray, sd: FloatArray, true: NDArray, near: BoolArray) -> dict[str, float]:
    """Bias and standard deviation where blur hardly changes with depth; NaN if there are few such pixels."""
    low, high = NEAR_FOCUS_LEVELS
    where = near & (true >= low) & (true < high)
    share = _share(where, near)
    bias = rms = stated = float("nan")
    if share >= OCCUPIED_SHARE:
        bias, rms = float(error[where].mean()), float(np.sqrt(np.mean(error[where] ** 2)))
        stated = float(sd[where].mean())
    values = {"share": share, "bias": bias, "abs-bias": abs(bias), "rms": rms, "sd": stated}
    return {f"near-focus.{name}": value for name, value in values.items()}


def bound_ratios(error: FloatArray, bound: FloatArray, blur_px: FloatArray) -> list[tuple[float, float, float]]:
    """Errors over their Cramer-Rao bound in each interval of visible blur: its middle, a robust ratio, and that of rms.

    The robust ratio is the median of |error| / bound over that of a standard normal variable, so that normal errors at
    the bound have a ratio of 1 in both. Intervals with fewer than ``FEWEST_PX`` pixels are left out.

    Args:
        error: errors in levels, [n].
        bound: bound of each, in levels, [n].
        blur_px: true visible blur, [n].
    """
    rows = []
    for low, high in itertools.pairwise(BOUND_BLUR_PX):
        part = (blur_px >= low) & (blur_px < high)
        if np.count_nonzero(part) >= FEWEST_PX:
            robust = float(np.median(np.abs(error[part]) / bound[part])) / NORMAL_MEDIAN
            rms = float(np.sqrt(np.mean(error[part] ** 2) / np.mean(bound[part] ** 2)))
            rows.append((float(low + high) / 2, robust, rms))
    return rows


def _share(part: BoolArray, whole: BoolArray) -> float:
    return float(part.sum()) / float(whole.sum()) if whole.any() else float("nan")
