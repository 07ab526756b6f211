"""Claim on sec. 6.2: depth under four illuminants, from 10 to 10,000 lux."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.stats import spearmanr

import dasim
import recon
from dasim.scene.loading import load_scene
from dasim.simulation.exposure import Shot
from dasim.simulation.relight import exposed, lit_by
from dasim.typing import FloatArray, ShareDone
from recon.settings import DEFAULT_PRESET
from validation.gates.claim import Evidence
from validation.methods import NamedMethod, bundled, prefix, reconstructed
from validation.reports.plots import plot
from validation.scores.depth import near_side
from validation.scores.figures import Figure
from validation.subjects import rendering
from validation.subjects.shots import photographed

METHODS = bundled(DEFAULT_PRESET)
SCENE = "desk"
SIZE_PX = (256, 192)
SPP = 160
LIGHTS = ("D65", "A", "energy-saving-3500K", "LED-B3")
LEVELS_LUX = (10.0, 30.0, 100.0, 300.0, 1000.0, 3000.0, 10000.0)
ENOUGH = 0.5  # of the best constant map's error: usable depth
TICKS = (0.2, 0.5, 1, 2, 5, 10)
COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7")


def light_levels(progress: ShareDone, seed: int = 0, methods: Sequence[NamedMethod] = METHODS) -> Evidence:
    """Depth is estimated under all four lights; its error falls with illuminance until the scene limits it.

    Rationale: sec. 6.2 names outdoor shade, energy-saving lamps and incandescent light. With lamps that emit little
    near-infrared the camera fails in dim light, and users need to know at which level.

    Set-up: the scene desk, 256 x 192 px of da-mobile, rendered once under each light (D65, A, energy-saving lamps of
    3500 K, a white LED). Its mean electrons are scaled to 10 to 10,000 lux (lamp and dome together) and exposed by the
    sensor model: automatic exposure up to 1/30 s, then analogue gain up to 16. Default preset; the bank holds D65, D55,
    A and 3500 K, of which white balance chooses one, also for the LED, which the bank lacks. Pixels behind the focus
    are excluded.

    Expectation: the figures are the median absolute error of the regularised level of all pixels, that of the raw
    levels, the share of pixels with a raw level, and the error of the best constant map. Lamps have less near-infrared
    than daylight, and thus a larger error in dim light. The error stays below half that of the best constant map (0.6
    of 1.2 levels) from some illuminance on. Above about 3,000 lux only the exposure time changes.

    Limit: below half of the constant map's error from 1,000 lux on under D65 and A, and from 3,000 lux on under the
    lamps; at 100 lux at least 1.5 times the error of daylight under lamps; a rank correlation of error and illuminance
    of -0.85 or less.

    Source: sec. 6.2; the light levels and limits are the project's own.
    """
    rendering.needs_wave()
    scene = load_scene(SCENE)
    camera = dasim.focused(dasim.cropped(dasim.load_camera("da-mobile"), *SIZE_PX), scene)
    scene_lux = sum(light.lux for light in scene.lights)
    figures: list[Figure] = []
    rows, curves = [], {}
    for number, light in enumerate(LIGHTS):
        shot = photographed(lit_by(scene, light), camera, seed, spp=SPP)
        bank = recon.calibrate(dasim.calibration_captures(camera, diffraction=shot.capture.provenance["diffraction"]))
        errors: dict[str, list[float]] = {prefix(method, METHODS): [] for method in methods}
        for part, level_lux in enumerate(LEVELS_LUX):
            capture = exposed(shot, level_lux / scene_lux, seed * len(LEVELS_LUX) + part)
            for method in methods:
                result = reconstructed(capture, bank, method)
                result_figures = errors_of(result.level, result.level_raw, shot)
                label = f"{prefix(method, METHODS)}{light}"
                errors[prefix(method, METHODS)].append(result_figures[0])
                figures += _level_figures(f"{label}.{level_lux:g}lux", f"{label}, {level_lux:g} lux", result_figures)
                exposure = f"1/{1 / capture.exposure_s:.0f}, gain {capture.gain:.3g}"
                rows.append([label, f"{level_lux:g}", exposure, result.light, *(f"{v:.2f}" for v in result_figures)])
            progress((number + (part + 1) / len(LEVELS_LUX)) / len(LIGHTS))
        constant = _constant(shot)
        for label, one in errors.items():
            curves[f"{label}{light}"] = np.array(one)
            figures += summary(f"{label}{light}", np.array(one), constant)
    for method in methods:
        label = prefix(method, METHODS)
        lamps = curves[f"{label}energy-saving-3500K"] / curves[f"{label}D65"]
        text = "100 lux: error under energy-saving lamps over that under D65"
        figures.append(Figure(f"{label}lamps-over-daylight", float(lamps[LEVELS_LUX.index(100.0)]), "1", text))
    head = ["light", "lux", "exposure, s", "light chosen", "error, levels", "raw error, levels", "raw share"]
    caption = (
        "Median absolute error of the level against the light's level; dashed: the best constant map, grey: half of it"
    )
    return Evidence(
        figures, pictures=[(caption, _picture(curves, constant))], tables=[("Depth against light", head, rows)]
    )


def _level_figures(label: str, where: str, errors: tuple[float, float, float]) -> list[Figure]:
    """Figures of one light and level, from :func:`errors_of`."""
    return [
        Figure(f"{label}.error", errors[0], "level", f"{where}: median absolute error, regularised, all pixels"),
        Figure(f"{label}.raw", errors[1], "level", f"{where}: median absolute error, raw"),
        Figure(f"{label}.share", errors[2], "1", f"{where}: share of pixels with a raw level"),
    ]


def errors_of(level: NDArray, raw: NDArray, shot: Shot) -> tuple[float, float, float]:
    """Median absolute errors of the regularised levels and of the raw ones, and the share of pixels with
    a raw level.
    """
    near = near_side(shot.truth)
    error = np.abs(level[near].astype(np.float64) - shot.truth.level[near])
    judged = near & np.isfinite(raw)
    raw_error = np.abs(raw[judged].astype(np.float64) - shot.truth.level[judged])
    return (
        float(np.median(error)),
        float(np.median(raw_error)) if judged.any() else float("nan"),
        judged.sum() / near.sum(),
    )


def summary(light: str, errors: FloatArray, constant: float) -> list[Figure]:
    """Figures that summarise the curve of one light."""
    order = float(spearmanr(LEVELS_LUX, errors).statistic)
    bad = np.flatnonzero(~(errors <= ENOUGH * constant))
    enough = LEVELS_LUX[0] if not bad.size else LEVELS_LUX[bad[-1] + 1] if bad[-1] + 1 < len(errors) else float("inf")
    return [
        Figure(
            f"{light}.enough-lux",
            enough,
            "lux",
            f"{light}: light from which on the error is half the best constant map's",
        ),
        Figure(f"{light}.order", order, "1", f"{light}: rank correlation of error and light, -1 where it only falls"),
        Figure(f"{light}.bright", float(errors[-1] / constant), "1", f"{light}, 10,000 lux: error over the constant's"),
        Figure(f"{light}.dark", float(errors[0] / errors[-1]), "1", f"{light}: error at 10 lux over that at 10,000"),
    ]


def _constant(shot: Shot) -> float:
    """Median absolute error of the best constant map, which is the median level everywhere."""
    level = shot.truth.level[near_side(shot.truth)].astype(np.float64)
    return min(float(np.median(np.abs(level - c))) for c in np.linspace(level.min(), level.max(), 200))


def _picture(curves: dict[str, FloatArray], constant: float) -> str:
    def draw(axes: Any) -> None:
        for colour, (light, errors) in zip(itertools.cycle(COLOURS), curves.items(), strict=False):
            axes.loglog(LEVELS_LUX, errors, "o-", color=colour, markersize=4, label=light)
        axes.axhline(constant, color="black", linestyle="--", linewidth=0.8)
        axes.axhline(ENOUGH * constant, color="#888888", linewidth=0.8)
        axes.set(xlabel="lux", ylabel="median absolute error, levels")
        axes.set_xticks(LEVELS_LUX, [f"{level_lux:,g}" for level_lux in LEVELS_LUX])
        axes.set_yticks(TICKS, [f"{tick:g}" for tick in TICKS])
        axes.minorticks_off()
        axes.legend()

    return plot(draw)
