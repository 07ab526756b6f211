"""Claim on depth resolution: the curves of Fig. 13 for both lenses, and the number of blur levels."""

from __future__ import annotations

import numpy as np
from scipy.optimize import brentq

from dasim.camera import geometry
from dasim.camera import specification as cameras
from dasim.camera.specification import BLUR_LEVELS, Camera
from dasim.typing import ShareDone
from validation.gates.claim import Evidence
from validation.references.depth_from_blur import first_order_m
from validation.reports.plots import plot
from validation.scores.figures import Figure

LENSES = {"3.6mm": "da-mobile", "8mm": "da-8mm"}
DEPTHS_CM = (5, 10, 20, 40, 100, 200)
FOCUS_AT_INFINITY_M = 1e4
LADDER_FOCUS_M = 2.0
NEAREST_M = 0.05
PAPERS_AXIS_CM = 14.75  # the largest number on the axis of Fig. 13
COLOURS = ("#0072b2", "#d55e00")


def depth_resolution(progress: ShareDone) -> Evidence:
    """Half a pixel of blur corresponds to the depth error of Fig. 13, and 5 cm to 2 m spans 29 blur levels.

    Rationale: the depths that a design can distinguish follow from its blur diameters, and Fig. 13 is the paper's
    summary of both lenses. The resolution by blur levels, (1 - alpha) c = 1 px, is coarser by
    1 / (1 - alpha) = 1.85; both are stated, and measured resolution is compared with the second.

    Set-up: da-mobile (3.6 mm) and da-8mm (8 mm), both focused at infinity, at six depths. The camera's blur is inverted
    numerically for the two depths whose blur differs by half a pixel to either side; the figure is half their distance.
    The number of levels is computed for da-mobile focused at 2 m.

    Expectation: to first order half a pixel corresponds to e = d^2 N p / (2 f^2). Blur is linear in 1/d, so the exact
    value is e / (1 - (e / d)^2). The largest number on the figure's axis, 14.75 cm, fits the 8 mm lens at 2 m if
    (d - f)^2 replaces d^2 (14.756), which measures depth from the front focal plane; this value is reported. From 2 m
    to 5 cm the difference of the two blurs, (1 - alpha) c, spans 28.7 px, which gives the 29 levels 0 to 28 of 1 px
    each.

    Limit: 0.1 % for half a pixel; 28 to 29 px for the span.

    Source: Fig. 13, sec. 6; Pentland 1987 for the error of depth from blur.
    """
    rows, figures, curves = [], [], {}
    worst = 0.0
    grid_cm = np.geomspace(DEPTHS_CM[0], DEPTHS_CM[-1], 40)
    for number, (lens, name) in enumerate(LENSES.items()):
        camera = cameras.refocused(cameras.load_camera(name), FOCUS_AT_INFINITY_M)
        for depth_cm in DEPTHS_CM:
            exact, expected = 100 * half_pixel_m(camera, depth_cm / 100), 100 * first_order_m(camera, depth_cm / 100)
            worst = max(worst, abs(exact * (1 - (expected / depth_cm) ** 2) / expected - 1))
            by_level = expected / (1 - geometry.hole_ratio(camera))
            rows.append([lens, f"{depth_cm}", f"{exact:.3f}", f"{expected:.3f}", f"{by_level:.3f}"])
            text = f"depth error of half a pixel of blur at {depth_cm} cm, {lens} lens"
            figures.append(Figure(f"{lens}.{depth_cm}cm", exact, "cm", text))
        curves[lens] = np.array([100 * first_order_m(camera, depth / 100) for depth in grid_cm])
        progress((number + 1) / len(LENSES))
    camera = cameras.refocused(cameras.load_camera(LENSES["3.6mm"]), LADDER_FOCUS_M)
    span = (1 - geometry.hole_ratio(camera)) * float(geometry.blur_px(camera, NEAREST_M))
    long_lens = cameras.load_camera(LENSES["8mm"])
    focal_m = long_lens.lens.focal_length_mm * 1e-3
    axis_cm = 100 * first_order_m(long_lens, 2.0) * ((2.0 - focal_m) / 2.0) ** 2
    figures += [
        Figure("error", worst, "1", "largest relative difference between the inverted blur and the formula"),
        Figure(
            "papers-axis",
            axis_cm,
            "cm",
            f"depth error at 2 m from the front focal plane, 8 mm lens; the paper's axis shows {PAPERS_AXIS_CM}",
        ),
        Figure("ladder-span", span, "px", "range of (1 - alpha) c from 2 m to 5 cm, 3.6 mm lens"),
    ]
    levels = geometry.level_blur_px(camera)
    ladder_cm = 100 * np.asarray(geometry.depth_of_blur_m(camera, levels))

    def draw(axes):  # type: ignore[no-untyped-def]
        for colour, (lens, curve) in zip(COLOURS, curves.items(), strict=True):
            axes[0].loglog(grid_cm, curve, color=colour, label=f"{lens}, half a pixel")
            axes[0].loglog(grid_cm, curve * 1.85, "--", color=colour, label=f"{lens}, by blur levels")
        axes[0].set(xlabel="depth in cm", ylabel="depth resolution in cm")
        axes[0].legend()
        axes[1].semilogy(range(BLUR_LEVELS), ladder_cm, ".", color=COLOURS[0])
        axes[1].set(xlabel="blur level", ylabel="depth in cm")

    head = ["lens", "depth, cm", "half a pixel, cm", "first order, cm", "by blur levels, cm"]
    caption = "Depth resolution of both lenses (compare Fig. 13), and the depth of each blur level, focus at 2 m"
    pictures = [(caption, plot(draw, columns=2, size=(4.4, 3.2)))]
    return Evidence(figures, pictures=pictures, tables=[("Depth resolution", head, rows)])


def half_pixel_m(camera: Camera, depth_m: float) -> float:
    """Half the distance in metres between the depths whose blur is half a pixel more and less than at ``depth_m``."""

    def at(blur_px: float) -> float:
        return float(
            brentq(lambda d: float(geometry.blur_px(camera, d)) - blur_px, depth_m / 5, depth_m * 50, xtol=1e-9)
        )

    blur = float(geometry.blur_px(camera, depth_m))
    return (at(blur - 0.5) - at(blur + 0.5)) / 2
