"""The report page of ``dasim demo``, and its overview picture.

Tested in tests/validation/reports/test_demo.py.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import cv2
import jinja2
import numpy as np
from numpy.typing import NDArray

from dasim.base.durations import words
from dasim.simulation.exposure import Shot
from dasim.values import Reconstruction
from recon.files.reconstruction import grey
from recon.views.maps import coloured_mosaic
from validation.gates.claim import Claim
from validation.reports import crops
from validation.reports.headlines import headlines
from validation.reports.page import MAP, NO_ESTIMATE, TEMPLATE_DIR, png_address
from validation.reports.pictures import photo_address
from validation.reports.plots import svg_address
from validation.scores.depth import level_error
from validation.scores.pictures import displayed
from validation.scores.score import depth_of_level

ERROR_SPAN_LEVELS = 4.0  # the error map's colours end here
OVERVIEW_PX = 1600  # width
ERROR_MAP = "PuOr"
MAP_INCH, MAP_DPI, BAR_INCH = 6.4, 120, 0.6  # width and resolution of a map, height of the scale below it
TICKS = 5
CROP_SCALE = 4  # a raw pixel is shown as a square of so many

Caption = tuple[str, str]  # a caption and a picture's data address


class Row(NamedTuple):
    """Pictures that are compared with each other, side by side where there is room."""

    pictures: Sequence[Caption]
    pixels: bool = False  # whether each pixel is shown as a square, at a fixed size


def demo_page(shot: Shot, result: Reconstruction, claims: list[Claim], timings_s: dict[str, float]) -> str:
    """HTML page with the report of the demo: capture, depth, all-in-focus picture and the page ``view.html`` beside
    it, eight figures, and all else folded.
    """
    depth_of = _depth_maps(shot)
    sections = {
        "Depth and its error": _depth_rows(shot, result, depth_of),
        "The raw mosaic, pixel by pixel": [_mosaic_row(shot, result)],
        "Pictures beside the truth": _picture_rows(shot, result),
    }
    hero = [
        ("Captured: what is not near the focus is blurred", photo_address(result.rgb)),
        ("Depth, estimated from this one exposure", depth_of(result.depth_m)),
        ("All in focus, from the same exposure", photo_address(result.sharp_rgb)),
    ]
    environment = jinja2.Environment(loader=jinja2.FileSystemLoader(TEMPLATE_DIR), autoescape=True)
    return environment.get_template("demo.html").render(
        hero=hero,
        headlines=headlines(claims),
        sections=sections,
        claims=claims,
        facts=_facts(shot, result),
        timings={name: words(seconds) for name, seconds in timings_s.items()},
        total=words(sum(timings_s.values())),
        crop_px=crops.CROP_PX,
        crop_scale=CROP_SCALE,
    )


def _depth_rows(shot: Shot, result: Reconstruction, depth_of: Any) -> list[Row]:
    """A row per estimated map: the truth, the map, and its error against the truth."""

    def error(level: NDArray[Any]) -> str:
        off = level_error(level, shot.truth)
        return _map(off, -ERROR_SPAN_LEVELS, ERROR_SPAN_LEVELS, ERROR_MAP, "error in blur levels", "{:g}".format)

    raw_m = depth_of_level(result.level_raw, result)
    confidence = _map(result.confidence, 0.0, 1.0, MAP, "confidence", "{:g}".format)
    regularised = [
        ("True depth", depth_of(shot.truth.depth_m)),
        ("Estimated depth", depth_of(result.depth_m)),
        ("Its error; grey: nothing there", error(result.level)),
    ]
    raw = [
        ("Confidence of the estimate", confidence),
        ("Before regularisation; grey: no estimate", depth_of(raw_m)),
        ("Its error", error(result.level_raw)),
    ]
    return [Row(regularised), Row(raw)]


def _mosaic_row(shot: Shot, result: Reconstruction) -> Row:
    """A part of the raw mosaic with much detail: in grey, in the colours of its filters, and as a picture."""
    sensor = shot.capture.camera.sensor
    light = cv2.GaussianBlur(np.asarray(result.sharp_rgb, np.float32).mean(axis=-1), (0, 0), 1)
    detail = np.hypot(*np.gradient(light))
    size = min(crops.CROP_PX, *light.shape)
    top, left = crops.places({"": detail}, size).get("", (0, 0))
    window = np.s_[top : top + size, left : left + size]
    raw = shot.capture.raw_dn.astype(float) - sensor.black_level_dn
    pictures = (
        (f"Raw numbers, {size} x {size} pixels", grey(raw)[window]),
        ("Each in the colour of its filter; infrared violet", coloured_mosaic(shot.capture.raw_dn, sensor)[window]),
        ("The same place, all in focus", result.sharp_rgb[window]),
    )
    return Row([(caption, png_address(picture)) for caption, picture in pictures], pixels=True)


PICTURES = {
    "captured": "Captured", "all-in-focus": "All in focus",
    "truth": "Truth, through a pinhole", "truth-focus": "Truth, in focus with diffraction",
}  # fmt: skip


def _picture_rows(shot: Shot, result: Reconstruction) -> list[Row]:
    """Capture and all-in-focus picture beside the true ones, in the same colours, and the channels of the capture."""
    shown = displayed(result, shot.truth)
    compared = [(caption, photo_address(shown[name])) for name, caption in PICTURES.items() if name in shown]
    infrared = grey(result.ir_e)[..., None].repeat(3, axis=-1)
    developed = (("Colour, infrared removed", result.rgb), ("Near-infrared", infrared))
    return [Row([*compared, *((caption, photo_address(picture)) for caption, picture in developed)])]


def _facts(shot: Shot, result: Reconstruction) -> dict[str, Any]:
    camera, about = shot.capture.camera, shot.capture.provenance
    lens, sensor = camera.lens, camera.sensor
    return {
        "Scene": about["scene"]["name"],
        "Camera": f"{camera.name}: {lens.focal_length_mm:g} mm f/{lens.f_number:g}, focus {lens.focus_distance_m:g} m",
        "Frame": f"{sensor.width_px} x {sensor.height_px} pixels of {sensor.pixel_pitch_um:g} um",
        "Exposure": f"{shot.capture.exposure_s * 1e3:.1f} ms, {about['saturated_pixels']} saturated pixels",
        "Renderer": f"{about['renderer']}, {about['spp']} samples per pixel and stop, "
        f"diffraction '{about['diffraction']}'",
        "Light": f"{shot.capture.illuminant}; chosen by white balance: {result.light}",
        "Seed": shot.capture.seed,
    }


def overview(shot: Shot, result: Reconstruction) -> NDArray[np.uint8]:
    """Capture, true depth, estimated depth and all-in-focus picture side by side, small, [h, w, 3] BGR.

    Maps are linear in dioptres, as everywhere: near is bright.
    """
    import matplotlib

    low, high = 1 / float(np.nanmax(shot.truth.depth_m)), 1 / float(np.nanmin(shot.truth.depth_m))

    def coloured(depth_m: NDArray[Any]) -> NDArray[Any]:
        return matplotlib.colormaps[MAP]((1 / depth_m - low) / max(high - low, 1e-9))[..., :3]

    pictures = (result.rgb, coloured(shot.truth.depth_m), coloured(result.depth_m), result.sharp_rgb)
    row = np.hstack([np.clip(picture, 0, 1) for picture in pictures])
    small = cv2.resize(row, (OVERVIEW_PX, OVERVIEW_PX * row.shape[0] // row.shape[1]), interpolation=cv2.INTER_AREA)
    return np.rint(small[..., ::-1] * 255).astype(np.uint8)


def _depth_maps(shot: Shot) -> Any:
    """A function that draws depth maps [h, w] in metres, all on the scale of the truth, even in dioptres."""
    far, near = 1 / float(np.nanmax(shot.truth.depth_m)), 1 / float(np.nanmin(shot.truth.depth_m))

    def draw(depth_m: NDArray[Any]) -> str:
        return _map(1 / depth_m, far, near, MAP, "depth z in cm", lambda vergence: f"{100 / vergence:.2g}")

    return draw


def _map(values: NDArray[Any], low: float, high: float, cmap: str, label: str, text: Any) -> str:
    """A false-colour picture [h, w] above its colour bar with ticks of a ``text``, as a data URL; NaN is grey."""
    import matplotlib
    from matplotlib.backends.backend_svg import FigureCanvasSVG
    from matplotlib.figure import Figure

    colours = matplotlib.colormaps[cmap].with_extremes(bad=NO_ESTIMATE)
    map_inch = MAP_INCH * values.shape[0] / values.shape[1]
    height = map_inch + BAR_INCH
    with matplotlib.rc_context({"font.size": 15}):
        figure = Figure(figsize=(MAP_INCH, height))
        FigureCanvasSVG(figure)
        axes = figure.add_axes((0, BAR_INCH / height, 1, map_inch / height))
        shown = np.ma.masked_invalid(values)
        image = axes.imshow(shown, cmap=colours, vmin=low, vmax=high, interpolation="nearest", aspect="auto")
        axes.set_axis_off()
        unit = BAR_INCH / height
        place_of_bar = figure.add_axes((0.35, 0.65 * unit, 0.6, 0.22 * unit))
        bar = figure.colorbar(image, cax=place_of_bar, orientation="horizontal")
        places = np.linspace(low, high, TICKS)
        bar.set_ticks(list(places), labels=[text(place) for place in places])
        figure.text(0.02, 0.62 * unit, label)
        return svg_address(figure, MAP_DPI)
