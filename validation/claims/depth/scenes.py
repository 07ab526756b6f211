"""Claim on depth in the bundled scenes: raw and regularised levels against the truth and the best constant map."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib import colormaps
from numpy.typing import NDArray

import dasim
import recon
from dasim.simulation.exposure import Shot
from dasim.typing import ShareDone
from dasim.values import Reconstruction
from validation.gates.claim import Evidence
from validation.methods import NamedMethod, bundled, reconstructed
from validation.reports import page
from validation.scores import depth as depth_scores
from validation.scores.depth import near_side
from validation.scores.figures import Figure
from validation.subjects import rendering
from validation.subjects.scene_set import SCENES, SIZE_PX, SPP
from validation.subjects.shots import photographed

METHODS = bundled("best", "bands", "paper", "chakrabarti-zickler")  # the first has limits, the others are reported
COLOURS = "turbo"


def depth(progress: ShareDone, seed: int = 0, methods: Sequence[NamedMethod] = METHODS) -> Evidence:
    """On scenes, blur levels are estimated to about one level, much better than by any constant map.

    Rationale: Fig. 1(b), 8(c,d) and 11(c). The staircase has one texture and no depth boundaries; scenes have many.

    Set-up: the bundled scenes desk, flowers and adam, 512 x 384 px, da-mobile focused as the scene proposes,
    160 samples per pixel and stop. Reconstructed with a bank calibrated for the camera and focus; presets best (with
    limits), bands, paper and chakrabarti-zickler (reported). Pixels behind the focal plane are excluded, since one
    picture cannot distinguish them from pixels in front of it. Textured pixels are those with a raw level; their share
    is reported.

    Expectation: median absolute error of the raw levels of textured pixels away from boundaries, and of the regularised
    levels of all pixels. The ratio to the best constant map weights every bin of one level with at least
    2 % of the pixels equally.

    Limit: 0.8 levels raw, 1.2 levels regularised, each at most half the error of the best constant map;
    a raw level for at least 0.6 of the pixels away from boundaries.

    Source: the project's own.
    """
    rendering.needs_wave()
    figures: list[Figure] = []
    pictures, tables = [], []
    for number, name in enumerate(SCENES):
        scene = dasim.load_scene(name)
        camera = dasim.focused(dasim.cropped(dasim.load_camera("da-mobile"), *SIZE_PX), scene)
        shot = photographed(scene, camera, seed, spp=SPP)
        bank = recon.calibrate(dasim.calibration_captures(camera, diffraction=shot.capture.provenance["diffraction"]))
        for step, method in enumerate(methods):
            result = reconstructed(shot.capture, bank, method)
            figures_of_scene, rows = _figures(name, method.name, result, shot)
            figures += figures_of_scene
            tables.append((f"{name}, {method}: raw levels by true level", ["level", "share", "median error"], rows))
            if method == methods[0]:
                caption = f"{name}, {method}: all in focus, true level, raw and regularised level"
                pictures.append((caption, page.png_address(_picture(result, shot))))
            progress((number + (step + 1) / len(methods)) / len(SCENES))
    return Evidence(figures, pictures, tables)


def _figures(name: str, method: str, result: Reconstruction, shot: Shot) -> tuple[list[Figure], list[list[str]]]:
    truth = shot.truth
    near = near_side(truth)
    inner = near & np.isfinite(result.level_raw) & ~truth.boundary
    away = near & ~truth.boundary
    label, case = f"{method}.{name}", f"{name}, {method}:"
    share = float(inner.sum()) / max(float(away.sum()), 1.0)
    figures = [Figure(f"{label}.textured", share, "1", f"{case} share of pixels away from boundaries with a raw level")]
    rows: list[list[str]] = []
    for what, level, where, text in (
        ("raw", result.level_raw, inner, "raw level, textured pixels away from boundaries"),
        ("regularised", result.level, near, "regularised level, all pixels"),
    ):
        true = truth.level[where].astype(np.float64)
        error = level[where].astype(np.float64) - true
        map_error, constant, bins = depth_scores.balanced_error(error, true)
        figures += [
            Figure(
                f"{label}.{what}", float(np.median(np.abs(error))), "level", f"{case} {text}, median absolute error"
            ),
            Figure(
                f"{label}.{what}-balanced", map_error, "level", f"{case} {text}, the same with occupied bins balanced"
            ),
            Figure(f"{label}.{what}-constant", constant, "level", f"{case} {text}, the same of the best constant map"),
            Figure(f"{label}.{what}-ratio", map_error / constant, "1", f"{case} {text}, ratio of both, bins balanced"),
        ]
        if what == "raw":
            rows = [[str(k), f"{part:.3f}", f"{bias:+.2f}"] for k, part, bias in bins]
    return figures, rows


def _picture(result: Reconstruction, shot: Shot) -> NDArray[np.float64]:
    """Sharp truth, true level, raw and regularised level side by side, 0..1; black pixels are not scored or have no
    estimate.
    """
    truth = shot.truth
    near = near_side(truth)
    top = max(float(truth.level[near].max()), 1.0)
    parts = [np.asarray(truth.sharp_srgb, np.float64)]
    for level in (np.where(near, truth.level, np.nan), result.level_raw, result.level):
        known = np.isfinite(level)
        colour = colormaps[COLOURS](np.clip(np.where(known, level, 0) / top, 0, 1))[..., :3]
        parts.append(colour * known[..., None])
    return np.hstack(parts)
