"""Scores of the captured and the all-in-focus picture against the pictures through a pinhole and in focus.

The pinhole's picture has no diffraction, which no lens can reach. The picture in focus has the same geometry with the
diffraction of the lens: the best that an all-in-focus picture can be without inventing detail.
PSNR is computed from linear light, without display curve or clipping. SSIM (Wang et al. 2004), colour difference
CIEDE2000 and the blur effect (Crete et al. 2007) are computed from sRGB pictures with a common matrix and exposure.

Tested in tests/validation/scores/test_score.py.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from dasim.camera.rings import at_pixels
from dasim.camera.specification import Camera
from dasim.spectra.colour import exposure_scale, to_srgb
from dasim.typing import BoolArray, FloatArray
from dasim.values import Reconstruction, Truth
from recon.picture import colour, field, infrared
from recon.settings import PAPER, Settings

VISIBLE_BLUR_PX = (3.0, 15.0)  # where sharpening is judged
PEAK_PERCENTILE = 99.9  # of the truth: a single highlight is no peak
SSIM_SIGMA_PX, SSIM_WINDOW_PX = 1.5, 11  # Wang et al. 2004

METRICS = {
    "psnr": ("dB", "10 log10(peak^2 / mean squared error), linear light"),
    "ssim": ("1", "mean structural similarity of sRGB, Gaussian window of 1.5 px"),
    "ciede2000": ("1", "mean colour difference CIEDE2000"),
}


# What pictures are scored against, by what the names of the figures end in.
REFERENCES = {"": "the sharp truth, through a pinhole", "-focus": "the truth in focus, with diffraction"}


class PictureScore(NamedTuple):
    """Scores of the captured and of the all-in-focus picture in one region.

    Keys are those of ``METRICS``, each followed by those of ``REFERENCES`` that the truth has.
    """

    region: str
    share: float  # of the pixels that see something
    captured: dict[str, float]
    sharpened: dict[str, float]


def regions(truth: Truth) -> dict[str, BoolArray]:
    """Regions in which pictures are scored: those with a blur of 3 to 15 px, and all; both away from boundaries."""
    inner = truth.valid & ~truth.boundary
    low, high = VISIBLE_BLUR_PX
    blur = np.abs(truth.blur_px)
    return {"blurred": inner & (blur >= low) & (blur <= high), "inner": inner}


def picture_scores(result: Reconstruction, truth: Truth) -> list[PictureScore]:
    """Scores of both pictures, region by region; NaN if a region is empty."""
    srgb = displayed(result, truth)
    pictures = (result.linear_e, srgb["captured"]), (result.sharp_e, srgb["all-in-focus"])
    total = max(float(truth.valid.sum()), 1.0)
    scores = []
    for name, where in regions(truth).items():
        pair: list[dict[str, float]] = [{}, {}]
        for suffix, exact in references(result, truth).items():
            for of_picture, (linear, picture) in zip(pair, pictures, strict=True):
                values = {"psnr": psnr(linear, exact, where)}
                values |= display_scores(picture, srgb[f"truth{suffix}"], where)
                of_picture |= {f"{key}{suffix}": value for key, value in values.items()}
        scores.append(PictureScore(name, float(where.sum()) / total, pair[0], pair[1]))
    return scores


def references(result: Reconstruction, truth: Truth) -> dict[str, FloatArray]:
    """Linear colours without infrared, [h, w, 3] electrons, that pictures are scored against; see ``REFERENCES``."""
    settings = Settings(**result.settings)
    exact = {"": infrared_free(truth.sharp_e, result.camera, result.light, settings)}
    if truth.focus_e is not None:
        exact["-focus"] = infrared_free(truth.focus_e, result.camera, result.light, settings)
    return exact


def displayed(result: Reconstruction, truth: Truth) -> dict[str, FloatArray]:
    """The captured, the all-in-focus and the true pictures in sRGB through one matrix and exposure, [h, w, 3] each.

    The true ones are ``truth``, through a pinhole, and ``truth-focus``, where the truth has it.
    """
    separation = infrared.separation(result.camera, result.light, Settings(**result.settings))
    matrix = colour.colour_matrix(result.camera, result.light, separation)
    scale = exposure_scale(result.linear_e, matrix)
    linear: dict[str, NDArray[Any]] = {"captured": result.linear_e, "all-in-focus": result.sharp_e}
    linear |= {f"truth{suffix}": exact for suffix, exact in references(result, truth).items()}
    return {name: to_srgb(e.astype(np.float32), matrix, scale).astype(np.float64) for name, e in linear.items()}


def infrared_free(image_e: NDArray[Any], camera: Camera, light: str, settings: Settings = PAPER) -> FloatArray:
    """Linear colours without infrared as the axis records them, [h, w, 3], from exact signals [h, w, channel].

    Infrared is removed as in ``settings``, by default by eq. (7); ``light`` is that for which white off the axis is
    balanced (:mod:`recon.picture.field`).
    """
    over_field = field.separation(camera, light, settings)
    planes = np.moveaxis(image_e, -1, 0).astype(np.float64)
    rows = [
        sum(at_pixels(column, over_field.place) * plane for column, plane in zip(colour_rows, planes, strict=True))
        for colour_rows in np.moveaxis(over_field.matrices, 0, -1)
    ]
    return np.stack(rows, axis=-1)


def psnr(image: NDArray[Any], exact: FloatArray, where: BoolArray) -> float:
    """Peak signal-to-noise ratio in dB over the pixels ``where`` and all channels, of linear light.

    10 log10(peak^2 / mean squared error); the peak is the 99.9th percentile of all of ``exact``. Infinite without any
    error; NaN for an empty mask, and for a picture with values that are not finite there.
    """
    if not where.any():
        return float("nan")
    error = float(np.mean((image[where].astype(np.float64) - exact[where]) ** 2))
    peak = float(np.percentile(exact, PEAK_PERCENTILE))
    if not np.isfinite(error) or not peak > 0:
        return float("nan")
    return float(10 * np.log10(peak**2 / error)) if error > 0 else float("inf")


def display_scores(image: NDArray[Any], exact: FloatArray, where: BoolArray) -> dict[str, float]:
    """Mean SSIM and CIEDE2000 over masked pixels of display pictures [h, w, 3], 0..1; NaN if the mask is empty.

    SSIM is also NaN if the picture is smaller than its window.
    """
    if not where.any():
        return {"ssim": float("nan"), "ciede2000": float("nan")}
    return {
        "ssim": float(likeness(image, exact)[where].mean()),
        "ciede2000": float(colour_difference(image[where], exact[where]).mean()),
    }


def likeness(image: NDArray[Any], exact: FloatArray) -> FloatArray:
    """SSIM of each pixel and channel of display pictures [h, w, 3], 0..1; NaN if they are smaller than its window."""
    from skimage.metrics import structural_similarity

    if min(image.shape[:2]) < SSIM_WINDOW_PX:
        return np.full(image.shape, np.nan)
    _, values = structural_similarity(
        exact, np.asarray(image, np.float64), channel_axis=-1, data_range=1.0, full=True, gaussian_weights=True,
        sigma=SSIM_SIGMA_PX, use_sample_covariance=False,
    )  # fmt: skip
    return np.asarray(values)


def colour_difference(image: NDArray[Any], exact: FloatArray) -> FloatArray:
    """CIEDE2000 of display pictures of any shape [..., 3], 0..1."""
    import colour as science

    lab = [science.XYZ_to_Lab(science.sRGB_to_XYZ(picture)) for picture in (image, exact)]
    return np.asarray(science.delta_E(*lab, method="CIE 2000"))


def blur_effect(image: NDArray[Any]) -> float:
    """Blur of a display picture [h, w, 3], 0 (sharp) to 1, measured by how little it changes when it is blurred
    further.

    Crete et al. 2007, as implemented in scikit-image; needs no reference. Noise counts as sharpness.
    """
    from skimage.measure import blur_effect as effect

    return float(effect(np.asarray(image, np.float64), channel_axis=-1))
