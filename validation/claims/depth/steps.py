"""Claim on measured depth resolution: the smallest depth step that the pipeline resolves (sec. 6.3, Fig. 13)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

import dasim
import recon
from dasim.camera import geometry
from dasim.camera import specification as cameras
from dasim.camera.specification import Camera
from dasim.scene.targets import depth_steps as steps_scene
from dasim.typing import ShareDone
from recon.settings import DEFAULT_PRESET
from validation.gates.claim import Evidence
from validation.methods import NamedMethod, bundled, reconstructed
from validation.references.depth_from_blur import first_order_m
from validation.reports.plots import plot
from validation.scores.figures import Figure
from validation.subjects import rendering
from validation.subjects.shots import photographed

FOCUS_M = 100.0  # as scenes/depth-steps.toml proposes
DEPTHS_CM = {"da-mobile": (10.0, 20.0, 40.0, 80.0), "da-8mm": (40.0, 80.0, 160.0)}  # within each lens's bank
LENSES = {"da-mobile": "3.6mm", "da-8mm": "8mm"}
STEPS = (0.2, 0.4, 0.8, 1.6)  # of a blur level
SIZE_PX = (256, 192)
SPP = 120
METHODS = bundled(DEFAULT_PRESET, "paper")
RIGHT_SHARE = 0.75  # of pixels: half way between guessing and certainty
WINDOW_PX = 35  # the widest patch of the presets
COLOURS = ("#0072b2", "#d55e00")


class Assignment(NamedTuple):
    """How well a preset distinguishes two planes."""

    step_levels: float
    right: float  # share of pixels assigned to their plane
    ordered: float  # share of pairs, a pixel of each plane, in the right order
    textured: float  # share of pixels with a raw level


def measured_steps(progress: ShareDone, seed: int = 0, methods: Sequence[NamedMethod] = METHODS) -> Evidence:
    """Two planes a fraction of a blur level apart are distinguished: the paper's method resolves finer steps than its
    levels.

    Rationale: Fig. 13 states what levels can distinguish; whether the reconstruction achieves it is another question.

    Set-up: the scene depth-steps (gravel, two halves), 256 x 192 px of da-mobile and da-8mm focused at 100 m, at
    distances within each lens's bank, with steps of 0.2, 0.4, 0.8 and 1.6 blur levels. Raw levels of the presets paper
    and bands are scored at pixels whose patch and blur contain one plane only. Each pixel is assigned to that of the
    two known planes whose level is nearer to its estimate: a two-alternative forced choice with the threshold halfway,
    so that bias counts. Guessing gives one half. The measured step is the one at which three quarters of the textured
    pixels (those with a raw level) are right, with equal weight for both planes, by linear interpolation over the
    logarithm of the step. "In order" is the step at which three quarters of all pairs, one pixel of each plane, are in
    the right order; bias does not affect it.

    Expectation: the measured step is compared with the half pixel of blur of Fig. 13 (d^2 N p / 2 f^2); with half a
    level, which is 1.85 times coarser and the definition for a measured resolution; and with one level, the spacing of
    the bank. Preset bands is biased here towards less blur (0.4 levels at level 3.7; at level 1.8 it returns focus),
    and few pixels have a level at 40 cm with the 8 mm lens: it orders the planes but assigns them wrongly. It is
    reported without limit.

    Limit: for preset paper at most one level at each distance, and half a level in the median over lenses and
    distances. At 80 cm with the 3.6 mm lens the far plane of the largest step is in focus, where levels are unreliable;
    it is reported without limit.

    Source: Fig. 13, sec. 6.3; 75 % of a two-alternative choice is the usual threshold of psychophysics.
    """
    rendering.needs_wave()
    figures: list[Figure] = []
    rows, curves = [], {}
    jobs = [(name, depth_cm) for name, depths in DEPTHS_CM.items() for depth_cm in depths]
    ratios: dict[str, list[float]] = {method.name: [] for method in methods}
    for number, (name, depth_cm) in enumerate(jobs):
        camera = cameras.refocused(dasim.cropped(dasim.load_camera(name), *SIZE_PX), FOCUS_M)
        assignments: dict[str, list[Assignment]] = {method.name: [] for method in methods}
        for part, step in enumerate(STEPS):
            for preset, one in _photographed(camera, depth_cm / 100, step, seed, methods).items():
                assignments[preset].append(one)
            progress((number + (part + 1) / len(STEPS)) / len(jobs))
        half_px, ladder = 100 * first_order_m(camera, depth_cm / 100), 100 * step_m(camera, depth_cm / 100, 1.0)
        cells = []
        for preset, by_step in assignments.items():
            levels = threshold(STEPS, [one.right for one in by_step])
            measured = 100 * step_m(camera, depth_cm / 100, levels)
            label, case = f"{preset}.{LENSES[name]}.{depth_cm:g}cm", f"{LENSES[name]} lens at {depth_cm:g} cm, {preset}"
            ratios[preset].append(levels)
            by_order = threshold(STEPS, [one.ordered for one in by_step])
            figures += [
                Figure(f"{label}.ordered", by_order, "level", f"{case}: step at which 75 % of pairs are in order"),
                Figure(f"{label}.step", measured, "cm", f"{case}: step resolved at 75 % of textured pixels"),
                Figure(f"{label}.levels", levels, "level", f"{case}: that step in blur levels"),
                Figure(
                    f"{label}.textured", min(one.textured for one in by_step), "1", f"{case}: pixels with raw level"
                ),
            ]
            cells += [_cell(levels, measured), _cell(by_order, 100 * step_m(camera, depth_cm / 100, by_order))]
            curves[label] = [one.right for one in by_step]
        by_level = half_px / (1 - geometry.hole_ratio(camera))
        rows.append([LENSES[name], f"{depth_cm:g}", f"{half_px:.3g}", f"{by_level:.3g}", f"{ladder:.3g}", *cells])
    for preset, all_levels in ratios.items():
        known = np.nan_to_num(all_levels, nan=np.inf)  # none up to the largest step
        text = f"{preset}: measured step in blur levels, median over lenses and distances"
        figures.append(Figure(f"{preset}.median-levels", float(np.median(known)), "level", text))
    head = ["lens", "distance, cm", "half a pixel, cm", "half a level, cm", "one level, cm"]
    head += [f"{method}, {how}, cm" for method in methods for how in ("assigned", "in order")]
    caption = "Share of textured pixels assigned to the right one of two planes; 75 % is the threshold"
    return Evidence(
        figures, pictures=[(caption, _picture(curves, methods))], tables=[("Resolved depth steps", head, rows)]
    )


def _cell(levels: float, step_cm: float) -> str:
    if np.isnan(levels):
        return "none tried"
    return f"<= {step_cm:.3g}" if levels <= STEPS[0] else f"{step_cm:.3g}"


def step_m(camera: Camera, depth_m: float, levels: float) -> float:
    """Distance behind ``depth_m`` at which the blur is ``levels`` levels less; NaN beyond the focus."""
    blur = float(geometry.blur_px(camera, depth_m)) - levels * float(geometry.level_blur_px(camera)[1])
    return float(geometry.depth_of_blur_m(camera, blur)) - depth_m if blur > 0 else float("nan")


def assigned(level: NDArray, near: NDArray[np.bool_], far: NDArray[np.bool_], known: tuple[float, float]) -> Assignment:
    """How well raw levels [h, w] (NaN for none) distinguish two planes, given their masks and known levels.

    A level exactly halfway, and a pair of equal levels, count one half.
    """
    middle = (known[0] + known[1]) / 2
    first, second = level[near & np.isfinite(level)], level[far & np.isfinite(level)]
    textured = (first.size + second.size) / max(int(near.sum() + far.sum()), 1)
    if not first.size or not second.size:
        return Assignment(known[0] - known[1], float("nan"), float("nan"), textured)
    right = [np.mean(np.sign(first - middle)), np.mean(np.sign(middle - second))]
    below = np.searchsorted(np.sort(second), first, side="left") + np.searchsorted(np.sort(second), first, side="right")
    return Assignment(
        known[0] - known[1], float(0.5 + np.mean(right) / 2), float(below.mean() / 2 / second.size), textured
    )


def threshold(steps: tuple[float, ...], right: list[float]) -> float:
    """Smallest step above which the share of right answers stays at ``RIGHT_SHARE`` or more, interpolated; NaN if there
    is none.

    If the smallest step tried is sufficient, it is the result, and thus an upper limit.
    """
    enough = np.array(right) >= RIGHT_SHARE
    if not enough[-1]:
        return float("nan")
    first = len(steps) - int(np.argmin(enough[::-1])) if not enough.all() else 0
    if first == 0:
        return steps[0]
    low, high = right[first - 1], right[first]
    share = (RIGHT_SHARE - low) / (high - low)
    return float(steps[first - 1] * (steps[first] / steps[first - 1]) ** share)


def _photographed(
    camera: Camera, depth_m: float, step: float, seed: int, methods: Sequence[NamedMethod]
) -> dict[str, Assignment]:
    """How well each method distinguishes two planes that are ``step`` levels apart."""
    scene = steps_scene(100 * depth_m, 100 * step_m(camera, depth_m, step))
    shot = photographed(scene, camera, seed, spp=SPP)
    bank = recon.calibrate(dasim.calibration_captures(camera, diffraction=shot.capture.provenance["diffraction"]))
    level_px = float(geometry.level_blur_px(camera)[1])
    blur = float(geometry.blur_px(camera, depth_m))
    known = (blur / level_px, blur / level_px - step)
    clear = int(np.ceil(blur / 2 + WINDOW_PX / 2))
    x, y = np.meshgrid(np.arange(SIZE_PX[0]), np.arange(SIZE_PX[1]))
    inner = (y >= WINDOW_PX // 2) & (y < SIZE_PX[1] - WINDOW_PX // 2)
    near = inner & (x >= WINDOW_PX // 2) & (x < SIZE_PX[0] / 2 - clear)
    far = inner & (x < SIZE_PX[0] - WINDOW_PX // 2) & (x >= SIZE_PX[0] / 2 + clear)
    return {
        method.name: assigned(reconstructed(shot.capture, bank, method).level_raw, near, far, known)
        for method in methods
    }


def _picture(curves: dict[str, list[float]], methods: Sequence[NamedMethod]) -> str:
    def draw(axes: Any) -> None:
        for panel, method in zip(np.atleast_1d(axes), methods, strict=True):
            for label, right in curves.items():
                what = label.removeprefix(f"{method}.")
                if what != label:
                    style = "--s" if what.startswith("8mm") else "-o"
                    panel.semilogx(
                        STEPS, right, style, markersize=3.5, linewidth=0.9, label=what.replace("mm.", "mm, ")
                    )
            panel.axhline(RIGHT_SHARE, color="black", linewidth=0.8)
            panel.set(xlabel="step, blur levels", title=method.name, ylim=(0.4, 1.02))
            panel.set_xticks(STEPS, [f"{step:g}" for step in STEPS])
            panel.minorticks_off()
        np.atleast_1d(axes)[0].set(ylabel="share of pixels assigned right")
        np.atleast_1d(axes)[-1].legend(fontsize=7, loc="lower right")

    return plot(draw, columns=len(methods), size=(4.4, 3.2))
