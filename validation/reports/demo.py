"""The report page of ``dasim demo``, and its overview picture.

Tested in tests/validation/scores/test_score.py.
"""

from __future__ import annotations

import base64
import io
from typing import Any

import cv2
import jinja2
import numpy as np
from numpy.typing import NDArray

from dasim.simulation.exposure import Shot
from dasim.values import Reconstruction
from recon.files.reconstruction import grey
from validation.gates.claim import Claim
from validation.reports.page import MAP, NO_ESTIMATE, TEMPLATE_DIR, png_address
from validation.scores.depth import level_error
from validation.scores.pictures import displayed
from validation.scores.score import depth_of_level

ERROR_SPAN_LEVELS = 4.0  # the error map's colours end here
OVERVIEW_PX = 1600  # width
ERROR_MAP = "PuOr"


def demo_page(shot: Shot, result: Reconstruction, claims: list[Claim], timings_s: dict[str, float]) -> str:
    """HTML page with the report of the demo."""
    truth, camera = shot.truth, shot.capture.camera
    pictures = displayed(result, truth)
    near, far = float(np.nanmin(truth.depth_m)) * 100, float(np.nanmax(truth.depth_m)) * 100

    def depth(depth_m: NDArray[Any]) -> str:
        return _map(depth_m * 100, low=near, high=far, cmap=MAP, label="depth z in cm")

    error = level_error(result.level, truth)
    groups = [
        (
            "The capture",
            [
                ("Raw mosaic", png_address(grey(shot.capture.raw_dn.astype(float) - camera.sensor.black_level_dn))),
                ("Colour, infrared removed", png_address(result.rgb)),
                ("Near-infrared", png_address(grey(result.ir_e))),
            ],
        ),
        (
            "Depth",
            [
                ("True depth", depth(truth.depth_m)),
                ("Estimated depth, regularised", depth(result.depth_m)),
                ("Estimated depth, raw (grey: no edge, no estimate)", depth(depth_of_level(result.level_raw, result))),
                (
                    "Error in blur levels, regularised (grey: nothing there)",
                    _map(error, low=-ERROR_SPAN_LEVELS, high=ERROR_SPAN_LEVELS, cmap=ERROR_MAP, label="levels"),
                ),
            ],
        ),
        (
            "All in focus",
            [
                ("Captured", png_address(pictures["captured"])),
                ("All in focus", png_address(pictures["all-in-focus"])),
                ("Truth, through a pinhole", png_address(pictures["truth"])),
                ("Truth, in focus with diffraction", png_address(pictures["truth-focus"])),
            ],
        ),
    ]
    lens, sensor = camera.lens, camera.sensor
    facts = {
        "Scene": shot.capture.provenance["scene"]["name"],
        "Camera": f"{camera.name}: {lens.focal_length_mm:g} mm f/{lens.f_number:g}, focus {lens.focus_distance_m:g} m",
        "Frame": f"{sensor.width_px} x {sensor.height_px} pixels of {sensor.pixel_pitch_um:g} um",
        "Exposure": f"{shot.capture.exposure_s * 1e3:.1f} ms, "
        f"{shot.capture.provenance['saturated_pixels']} saturated pixels",
        "Renderer": f"{shot.capture.provenance['renderer']}, "
        f"{shot.capture.provenance['spp']} samples a pixel and stop, "
        f"diffraction '{shot.capture.provenance['diffraction']}'",
        "Light": f"{shot.capture.illuminant}; chosen by white balance: {result.light}",
        "Seed": shot.capture.seed,
    }
    environment = jinja2.Environment(loader=jinja2.FileSystemLoader(TEMPLATE_DIR), autoescape=True)
    return environment.get_template("demo.html").render(facts=facts, groups=groups, claims=claims, timings=timings_s)


def overview(shot: Shot, result: Reconstruction) -> NDArray[np.uint8]:
    """Capture, true depth, estimated depth and all-in-focus picture side by side, small, [h, w, 3] BGR."""
    import matplotlib

    low, high = float(np.nanmin(shot.truth.depth_m)), float(np.nanmax(shot.truth.depth_m))

    def coloured(depth_m: NDArray[Any]) -> NDArray[Any]:
        return matplotlib.colormaps[MAP]((depth_m - low) / max(high - low, 1e-9))[..., :3]

    pictures = (result.rgb, coloured(shot.truth.depth_m), coloured(result.depth_m), result.sharp_rgb)
    row = np.hstack([np.clip(picture, 0, 1) for picture in pictures])
    small = cv2.resize(row, (OVERVIEW_PX, OVERVIEW_PX * row.shape[0] // row.shape[1]), interpolation=cv2.INTER_AREA)
    return np.rint(small[..., ::-1] * 255).astype(np.uint8)


def _map(values: NDArray[Any], *, low: float, high: float, cmap: str, label: str) -> str:
    """A false-colour picture with its colour bar, as a data URL."""
    import matplotlib
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    colours = matplotlib.colormaps[cmap].with_extremes(bad=NO_ESTIMATE)
    height, width = values.shape
    figure = Figure(figsize=(6.4, 6.4 * 0.86 * height / width), dpi=120, layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.add_subplot()
    image = axes.imshow(np.ma.masked_invalid(values), cmap=colours, vmin=low, vmax=high, interpolation="nearest")
    axes.set_axis_off()
    figure.colorbar(image, ax=axes, label=label, shrink=0.9)
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", facecolor="white")
    return "data:image/png;base64," + base64.b64encode(buffer.getvalue()).decode()
