"""Claim on depth maps (Fig. 8): raw and regularised levels compared, and surfaces in oblique view."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

import dasim
import recon
from dasim.camera.geometry import intrinsic_matrix
from dasim.simulation.exposure import Shot
from dasim.typing import BoolArray, ShareDone
from dasim.values import Reconstruction, Truth
from recon.views.surface import SMALLEST_PIECE, surface
from validation.gates.claim import Evidence
from validation.methods import NamedMethod, bundled, reconstructed
from validation.reports import pictures
from validation.scores.depth import balanced_error, level_error, near_side
from validation.scores.figures import Figure
from validation.scores.score import depth_of_level
from validation.subjects import rendering, scene_set
from validation.subjects.shots import photographed

METHODS = bundled("bands", "paper")  # the first has limits and pictures, the second is reported
APART_LEVELS = 2.0  # true levels of two pixels whose order is judged: neighbouring levels are not distinguished
PAIRS = 200_000  # drawn at random: the share of right ones is known to 0.1 %
YAWS_DEG = (-9.0, 0.0, 9.0)
STRIDE_PX = 2  # of the surfaces: the levels' own grid


def depth_maps(progress: ShareDone, seed: int = 0, methods: Sequence[NamedMethod] = METHODS) -> Evidence:
    """Regularised depth is smoother than raw depth, at least as accurate, and orders near and far.

    Rationale: Fig. 8 shows a noisy raw map with gaps, a regularised map without, and oblique views of surfaces. Claim
    ``depth`` measures the errors of both maps; this claim measures the effect of regularisation.

    Set-up: the photographs of claim ``depth``: desk, flowers and adam, 512 x 384 px, da-mobile; preset bands (limits
    and pictures), preset paper beside. Order: random pairs of pixels at least 2 true levels apart. Roughness: the rms
    step between neighbouring samples of a map, over pairs that both have a raw level and lie on one object away from
    boundaries. Maps share one scale, linear in dioptres. Surfaces are drawn in (x/z, y/z, 1/z), where planes remain
    planes; in metres the view of a lens of 14 degrees would be a spike.

    Expectation: where raw levels exist, median and rms errors are not larger than theirs, since averaging over similar
    pixels reduces noise without bias. The error at pixels without a raw level is reported beside that of the best
    constant map of those pixels. They have no texture and take depths from neighbours; in flowers and adam they are
    worse than the constant map.

    Limit: both errors at most raw's; roughness at most 0.7 of raw's; at least 0.75 of the pairs in order.

    Source: sec. 5.2, eq. (13)-(14), Fig. 8.
    """
    rendering.needs_wave()
    figures: list[Figure] = []
    maps: list[tuple[str, str]] = []
    views: list[tuple[str, str]] = []
    for number, name in enumerate(scene_set.SCENES):
        scene = dasim.load_scene(name)
        camera = dasim.focused(dasim.cropped(dasim.load_camera("da-mobile"), *scene_set.SIZE_PX), scene)
        shot = photographed(scene, camera, seed, spp=scene_set.SPP)
        bank = recon.calibrate(dasim.calibration_captures(camera, diffraction=shot.capture.provenance["diffraction"]))
        for method in methods:
            result = reconstructed(shot.capture, bank, method)
            figures += figures_of(f"{method}.{name}", f"{name}, {method}", result, shot.truth, seed)
            if method == methods[0]:
                maps.append(_maps(f"{name}, {method}", result, shot))
                views.append(_aside(f"{name}, {method},", result, shot))
        progress((number + 1) / len(scene_set.SCENES))
    return Evidence(figures, pictures=[*maps, *views])


def figures_of(name: str, case: str, result: Reconstruction, truth: Truth, seed: int = 0) -> list[Figure]:
    """The figures of one reconstruction."""
    near = near_side(truth)
    known = np.isfinite(result.level_raw)
    gaps, rest = near & ~known, near & known
    smooth, raw = (level_error(level, truth) for level in (result.level, result.level_raw))
    filled, constant, _ = balanced_error(smooth[gaps], truth.level[gaps].astype(np.float64))
    medians = [float(np.median(np.abs(error[rest]))) for error in (smooth, raw)]
    rms = [float(np.sqrt(np.mean(error[rest] ** 2))) for error in (smooth, raw)]
    steps = [roughness(level, rest & ~truth.boundary, truth) for level in (result.level, result.level_raw)]
    share = float(gaps.sum()) / max(float(near.sum()), 1.0)
    order = in_order(result.level, truth.level, near, seed)
    text = "error of regularised levels where there are raw ones, over theirs"
    gap = "median absolute error where raw levels were left out, bins balanced"
    return [
        Figure(f"{name}.kept-median", medians[0] / medians[1], "1", f"{case}: median absolute {text}"),
        Figure(f"{name}.kept-rms", rms[0] / rms[1], "1", f"{case}: rms {text}"),
        Figure(f"{name}.roughness", steps[0] / steps[1], "1", f"{case}: rms step between samples, over that of raw"),
        Figure(f"{name}.order", order, "1", f"{case}: share of pairs {APART_LEVELS:g} levels apart in the right order"),
        Figure(f"{name}.left-out", share, "1", f"{case}: share of pixels without a raw level"),
        Figure(f"{name}.filled", filled, "level", f"{case}: {gap}"),
        Figure(f"{name}.filled-constant", constant, "level", f"{case}: {gap}, of the best constant map"),
    ]


def in_order(level: NDArray, true: NDArray, where: BoolArray, seed: int = 0) -> float:
    """Share of random pairs of pixels whose true levels are APART_LEVELS apart that a map has in the same order."""
    pairs = np.random.default_rng(seed).choice(np.flatnonzero(where), (2, PAIRS))
    difference = np.diff(true.ravel()[pairs].astype(np.float64), axis=0)[0]
    level_difference = np.diff(level.ravel()[pairs].astype(np.float64), axis=0)[0]
    apart = np.abs(difference) >= APART_LEVELS
    return float(np.mean(difference[apart] * level_difference[apart] > 0)) if apart.any() else float("nan")


def roughness(level: NDArray, where: BoolArray, truth: Truth) -> float:
    """Root mean square step in levels between samples 2 px apart on one object."""
    values, objects, inside = (a[::2, ::2] for a in (level.astype(np.float64), truth.object_id, where))
    steps = []
    for axis in (0, 1):
        size = values.shape[axis]
        a, b = (np.take(np.arange(size), np.arange(start, size - 1 + start)) for start in (0, 1))
        both = (
            np.take(inside, a, axis)
            & np.take(inside, b, axis)
            & (np.take(objects, a, axis) == np.take(objects, b, axis))
        )
        steps.append((np.take(values, b, axis) - np.take(values, a, axis))[both])
    return float(np.sqrt(np.mean(np.concatenate(steps) ** 2)))


def _maps(name: str, result: Reconstruction, shot: Shot) -> tuple[str, str]:
    """True, raw and regularised depth, with a caption."""
    truth = shot.truth
    near_only = np.where(near_side(truth), 1.0, np.nan)  # not behind the focus
    raw = depth_of_level(result.level_raw, result)
    maps = [("true", truth.depth_m), ("raw", raw), ("regularised", result.depth_m)]
    address = pictures.depth_panels([(title, depth_m * near_only) for title, depth_m in maps], *_range_m(truth))
    return f"{name}: true, raw and regularised depth on one scale, linear in dioptres; grey: no estimate", address


def _aside(name: str, result: Reconstruction, shot: Shot) -> tuple[str, str]:
    """The true surface above the reconstructed one, seen from three sides, with a caption."""
    truth, intrinsic = shot.truth, intrinsic_matrix(shot.capture.camera)
    shape = (truth.depth_m.shape[0], truth.depth_m.shape[1])
    nearest_m, farthest_m = _range_m(truth)
    pivot_m = 2 / (1 / nearest_m + 1 / farthest_m)
    rows = []
    for image, depth_m, confidence in (
        (truth.sharp_srgb, truth.depth_m, None),
        (result.sharp_rgb, result.depth_m, result.confidence),
    ):
        body = surface(
            image, depth_m, intrinsic, confidence=confidence, stride_px=STRIDE_PX, smallest_piece=SMALLEST_PIECE
        )
        rows.append(np.hstack([pictures.in_perspective(body, intrinsic, shape, pivot_m, yaw) for yaw in YAWS_DEG]))
    caption = (
        f"{name} in three dimensions, from the left, the front and the right: true surface with the sharp truth (top), "
        "regularised depth with the all-in-focus picture (bottom); cut at jumps and at low confidence"
    )
    return caption, pictures.photo_address(np.vstack(rows))


def _range_m(truth: Truth) -> tuple[float, float]:
    return float(np.nanmin(truth.depth_m)), float(np.nanmax(truth.depth_m))
