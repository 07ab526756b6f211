"""How much an all-in-focus picture gains on the capture, by blur and at silhouettes, and whether it has halos.

Signal-to-noise alone rewards a picture that is smooth, and edges alone one that is oversharpened: gains are measured in
PSNR of linear light, SSIM, CIEDE2000 and the width of edges (:func:`edge_width`), and halos apart (:func:`halo`).
A gain is positive where the all-in-focus picture is better than the captured one.
"""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from dasim.typing import BoolArray, FloatArray
from dasim.values import Reconstruction, Truth
from validation.scores import pictures
from validation.scores.depth_edges import NEIGHBOURS, edges
from validation.scores.edges import gradients

BINS_PX = {"0-1": (0.0, 1.0), "1-3": (1.0, 3.0), "3-8": (3.0, 8.0), "8-20": (8.0, 20.0), "over-20": (20.0, np.inf)}
REGIONS = ("all", *BINS_PX, "boundary")
LEAST_SHARE = 0.02  # of the frame's pixels in a region that counts
BOUNDARY_PX = 3  # on either side of a depth edge
AGAINST_FOCUS, AGAINST_PINHOLE = "-focus", ""  # names in ``pictures.REFERENCES``
GREEN = 1  # of R, G, B: the channel with the least noise, in which edges are measured

WIDTH_PER_SIGMA = 2.563  # 10-90 % width of a step that a Gaussian blurs, in its standard deviations
SIGMAS_PX = np.arange(0, 14.01, 0.25)  # of Gaussians that are tried; a disc of 56 px has 14
EDGE_SHARE = 0.1  # of the pixels, those with the steepest truth

HALO_PX = 8  # from a silhouette on either side
ALONG_PX = 16  # over which it is averaged, to either side
LEAST_STEP = 0.2  # of a silhouette in the truth, as a share of the truth's mean: fainter ones are not judged
LEAST_MEAN_PX = 4  # pixels of a mean at one distance from a silhouette
LEAST_DISTANCES = 2  # with a mean, on either side
HALO_PERCENTILE = 95.0

QUANTITIES = {
    "gain": ("dB", "gain in PSNR against the truth in focus"),
    "gain-sharp": ("dB", "gain in PSNR against the sharp truth, through a pinhole"),
    "ssim": ("1", "gain in SSIM against the truth in focus"),
    "ciede2000": ("1", "gain in CIEDE2000 against the truth in focus: by how much the difference is smaller"),
    "width": ("px", "gain in edge width against the truth in focus: by how much it is smaller"),
}  # each in every region of ``REGIONS``
HALO = "halo"
HALO_TEXT = f"percentile {HALO_PERCENTILE:g} of the overshoot at silhouettes over their step in the truth in focus"


def regions(truth: Truth) -> dict[str, BoolArray]:
    """Regions [h, w] by name: all pixels that see something, intervals of visible blur, and silhouettes.

    Intervals hold the pixels away from ``truth.boundary``, which is as wide as the blur. ``boundary`` holds those up to
    ``BOUNDARY_PX`` on either side of a depth edge (:func:`validation.scores.depth_edges.edges`), in which the pixels on
    both sides of the step are edge pixels.
    """
    inner, blur = truth.valid & ~truth.boundary, np.abs(truth.blur_px)
    edge = edges(truth.level, truth.valid)
    near_edge = ndimage.distance_transform_edt(~edge) <= BOUNDARY_PX - 1 if edge.any() else edge
    bins = {name: inner & (blur >= low) & (blur < high) for name, (low, high) in BINS_PX.items()}
    return {"all": truth.valid, **bins, "boundary": truth.valid & near_edge}


def counts(where: BoolArray) -> bool:
    """Whether a region is large enough to count in a capture."""
    return bool(where.mean() >= LEAST_SHARE)


class Sharpness(NamedTuple):
    """Scores of a reconstruction's pictures; keys are QUANTITY.REGION, and ``HALO``; NaN where a region is too small.

    ``gains`` are those of the all-in-focus picture over the captured one. ``captured`` and ``sharpened`` are the
    values of either picture, with PSNR in place of its gain.
    """

    gains: dict[str, float]
    captured: dict[str, float]
    sharpened: dict[str, float]


def sharpness(result: Reconstruction, truth: Truth) -> Sharpness:
    """Scores of both pictures of a reconstruction; ``truth.focus_e`` must be there."""
    exact = pictures.references(result, truth)
    srgb = pictures.displayed(result, truth)
    where = {name: region for name, region in regions(truth).items() if counts(region)}
    in_focus = exact[AGAINST_FOCUS][..., GREEN]
    blurred = blurred_gradients(in_focus)
    both = []
    for linear, display in ((result.linear_e, srgb["captured"]), (result.sharp_e, srgb["all-in-focus"])):
        values = {f"{quantity}.{name}": float("nan") for quantity in QUANTITIES for name in REGIONS}
        likeness, difference = _maps(display, srgb[f"truth{AGAINST_FOCUS}"])
        for name, region in where.items():
            values[f"gain.{name}"] = pictures.psnr(linear, exact[AGAINST_FOCUS], region)
            values[f"gain-sharp.{name}"] = pictures.psnr(linear, exact[AGAINST_PINHOLE], region)
            values[f"ssim.{name}"] = float(likeness[region].mean())
            values[f"ciede2000.{name}"] = float(difference[region].mean())
            values[f"width.{name}"] = edge_width(linear[..., GREEN], blurred, region)
        values[HALO] = halo(linear[..., GREEN], in_focus, truth.level, truth.valid)
        both.append(values)
    captured, sharpened = both
    signs = {"ciede2000": -1.0, "width": -1.0}
    gains = {key: signs.get(key.partition(".")[0], 1.0) * (sharpened[key] - captured[key])
             for key in captured if key != HALO}  # fmt: skip
    return Sharpness(gains | {HALO: sharpened[HALO]}, captured, sharpened)


def _maps(display: NDArray, exact: FloatArray) -> tuple[FloatArray, FloatArray]:
    """SSIM and CIEDE2000 of each pixel of a display picture [h, w, 3], [h, w] each."""
    return pictures.likeness(display, exact).mean(axis=-1), pictures.colour_difference(display, exact)


# --- width of edges ------------------------------------------------------------------------------


def blurred_gradients(exact: NDArray) -> NDArray[np.float32]:
    """Gradients of an exact image [h, w] blurred by Gaussians of ``SIGMAS_PX``, [sigma, 2, h, w]."""
    image = exact.astype(np.float32)
    blurred = (image if sigma == 0 else cv2.GaussianBlur(image, (0, 0), sigma) for sigma in SIGMAS_PX)
    return np.stack([gradients(one).astype(np.float32) for one in blurred])


def edge_width(image: NDArray, blurred: NDArray[np.float32], where: BoolArray) -> float:
    """Edge-spread width in px that a picture [h, w] adds to the truth at the steepest edges of the truth in a mask.

    The Gaussian blur of the truth is sought whose gradients match those of the picture best, by least squares over the
    tenth of the pixels ``where`` with the steepest truth. This fits an edge-spread function erf of one common width to
    all edges. Noise of the picture adds the same amount to each sum of squares, so it does not count as sharpness. The
    result is the 10-90 % width of a step blurred by this Gaussian, 2.563 standard deviations, as for an edge-spread
    function (ISO 12233); it is 0 for the truth. At a step, the steep middle dominates the fit: a disc of diameter d
    gets the width of the Gaussian that is equally steep there, 0.80 d (its own width is 0.69 d). A picture without
    visible edges gets the width of the largest Gaussian, 36 px.

    ``blurred`` are :func:`blurred_gradients` of the truth; NaN for an empty mask, and for a picture whose values
    there are not finite.
    """
    if not where.any():
        return float("nan")
    steep = np.hypot(*blurred[0])
    edge = where & (steep >= np.quantile(steep[where], 1 - EDGE_SHARE))
    found = gradients(image)[:, edge]
    squares = np.array([np.square(found - one[:, edge]).mean() for one in blurred])
    if not np.isfinite(squares).all():
        return float("nan")
    best = int(np.argmin(squares))
    if 0 < best < len(squares) - 1:
        below, least, above = squares[best - 1 : best + 2]
        best += 0.5 * (below - above) / (below - 2 * least + above)  # vertex of the parabola through the three
    return float(WIDTH_PER_SIGMA * best * (SIGMAS_PX[1] - SIGMAS_PX[0]))


# --- halos ---------------------------------------------------------------------------------------


def halo(image: NDArray, exact: NDArray, level: NDArray, where: BoolArray) -> float:
    """Overshoot of a picture at silhouettes beyond the range of the truth, as a share of the step there.

    For each edge pixel of the true levels, both pictures are averaged along the silhouette: over the pixels of the
    square of 33 px about it that have the same distance (0 to 7 px) to an edge pixel and lie on the same side of it.
    The overshoot is the amount by which the largest mean of the picture exceeds the largest of the truth, or by which
    its smallest mean falls below the smallest of the truth, whichever is larger; it is at least 0. The step is the
    difference of the truth's means over the distances on either side. Silhouettes count if the step is at least
    ``LEAST_STEP`` of the truth's mean. The result is the 95th percentile over their edge pixels, NaN without any.
    Residual noise of the picture adds about a third of its standard deviation, because means are over some 33 px. Light
    that blur carries across the silhouette from farther away also counts if it lies beyond the range of the truth.

    Args:
        image: the picture, [h, w].
        exact: the truth, [h, w], in the same unit.
        level: true blur levels [h, w], larger nearer.
        where: pixels [h, w] that see something.
    """
    edge = edges(level, where)
    if not edge.any():
        return float("nan")
    places = _silhouette_means(np.stack([image, exact], axis=-1).astype(np.float64), level, edge, where)
    known = ~np.isnan(places[..., 0])  # [2, distance, edge pixel]
    judged = (known.sum(axis=1) >= LEAST_DISTANCES).all(axis=0)
    places = places[:, :, judged]
    far, near = np.nanmean(places[..., 1], axis=1)
    step = np.abs(near - far)
    strong = step >= LEAST_STEP * exact[where].mean()
    if not strong.any():
        return float("nan")
    means = places[:, :, strong].reshape(-1, int(strong.sum()), 2)
    above, below = (np.diff(of(means, axis=0), axis=-1)[:, 0] for of in (np.nanmax, np.nanmin))
    overshoot = np.maximum(np.maximum(-above, below), 0) / step[strong]
    return float(np.percentile(overshoot, HALO_PERCENTILE))


def _silhouette_means(images: FloatArray, level: NDArray, edge: BoolArray, where: BoolArray) -> FloatArray:
    """Means of images [h, w, n] about each edge pixel by side (far, near) and distance, [2, HALO_PX, edge pixel, n].

    NaN where fewer than ``LEAST_MEAN_PX`` pixels have that side and distance. A pixel is on the near side if its level
    is above the middle of those about the nearest edge pixel.
    """
    values = np.where(where, level, 0).astype(np.float32)
    middle = (cv2.dilate(values, NEIGHBOURS) + cv2.erode(values, NEIGHBOURS)) / 2
    distance, (rows, columns) = ndimage.distance_transform_edt(~edge, return_indices=True)
    near = values > middle[rows, columns]
    square = (2 * ALONG_PX + 1,) * 2
    means = np.full((2, HALO_PX, int(edge.sum()), images.shape[-1]), np.nan)
    for side in (0, 1):
        for step in range(HALO_PX):
            here = where & (near == bool(side)) & (distance >= step) & (distance < step + 1)
            sums = cv2.boxFilter(
                np.dstack([here[..., None], images * here[..., None]]), -1, square, normalize=False,
                borderType=cv2.BORDER_CONSTANT,
            )[edge]  # fmt: skip
            enough = sums[:, 0] > LEAST_MEAN_PX - 0.5
            means[side, step, enough] = sums[enough, 1:] / sums[enough, :1]
    return means
