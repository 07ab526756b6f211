"""Colour pictures of data without colours: depth and confidence with their scales, and the raw mosaic.

Tested in tests/recon/views/test_maps.py.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from dasim.camera.sensor import Sensor, channel_block, channels
from dasim.typing import Float32Array

MAP = "viridis"  # colour-blind-safe
UNKNOWN = 0.5  # grey of pixels without a value
OUTLIERS_PERCENT = 0.5  # of the pixels at either end of the range, beyond the ends of the colours
TICKS = 6
LEAST_HEIGHT_PX = 240  # smaller maps are enlarged by a whole number
BAR_PX, FONT_PX = 110, 13  # width of the scale beside a map, height of its text
WHITE_PERCENTILE = 99.5
GAMMA = 2.2
TINT = {"R": (1.0, 0.35, 0.3), "G": (0.35, 1.0, 0.4), "B": (0.4, 0.55, 1.0), "IR": (0.8, 0.6, 1.0)}


def depth_picture(depth_m: NDArray[Any]) -> NDArray[np.uint8]:
    """A depth map [h, w] in metres in false colours with its scale in cm, [h', w', 3] RGB.

    Colours are linear in dioptres, as blur is; unknown depths are grey. Each pixel of the map becomes one pixel of the
    picture, or a square of equal pixels if the map is small.
    """
    depth = np.asarray(depth_m, np.float64)
    with np.errstate(divide="ignore"):
        vergence = np.where(depth > 0, 1 / depth, np.nan)
    vergence[~np.isfinite(vergence)] = np.nan
    return _with_scale(vergence, *_range(vergence), label="distance from the lens, cm", text=_centimetres)


def confidence_picture(confidence: NDArray[Any]) -> NDArray[np.uint8]:
    """A map [h, w] of confidences 0..1 in false colours with its scale, [h', w', 3] RGB; NaN is grey."""
    values = np.asarray(confidence, np.float64)
    return _with_scale(values, 0.0, 1.0, label="confidence", text=lambda value: f"{value:.1f}")


def coloured_mosaic(raw_dn: NDArray[Any], sensor: Sensor) -> Float32Array:
    """The raw mosaic at full size, each pixel in the colour of its filter; display values 0..1, [h, w, 3].

    Infrared is violet. To be looked at pixel by pixel: reduced, a mosaic shows patterns that it does not contain.
    """
    above = np.asarray(raw_dn, np.float32) - sensor.black_level_dn
    white = max(float(np.percentile(above, WHITE_PERCENTILE)), 1.0)
    tint = np.array([TINT.get(name, (1.0, 1.0, 1.0)) for name in channels(sensor)], np.float32)[channel_block(sensor)]
    rows, columns = (-(-size // period) for size, period in zip(raw_dn.shape, tint.shape[:2], strict=True))
    colours = np.tile(tint, (rows, columns, 1))[: raw_dn.shape[0], : raw_dn.shape[1]]
    return np.asarray(np.clip(above / white, 0, 1)[..., None] ** (1 / GAMMA) * colours, np.float32)


def _centimetres(vergence: float) -> str:
    return f"{100 / vergence:.3g}" if vergence > 0 else "∞"


def _range(values: NDArray[np.float64]) -> tuple[float, float]:
    """Ends of the colours: the values without the outliers at either end."""
    known = values[np.isfinite(values)]
    if not known.size:
        return 0.0, 1.0
    low, high = np.percentile(known, [OUTLIERS_PERCENT, 100 - OUTLIERS_PERCENT])
    return (float(low), float(high)) if high > low else (float(low) * 0.9, float(low) * 1.1 + 1e-9)


def _with_scale(values: NDArray[np.float64], low: float, high: float, *, label: str, text: Any) -> NDArray[np.uint8]:
    """False colours of values between two ends, with a colour bar on the right."""
    import matplotlib
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    times = -(-LEAST_HEIGHT_PX // values.shape[0])
    colours = matplotlib.colormaps[MAP].with_extremes(bad=(UNKNOWN,) * 3)
    share = np.ma.masked_invalid((values - low) / (high - low))
    picture = colours(share.repeat(times, axis=0).repeat(times, axis=1), bytes=True)[..., :3]
    height = picture.shape[0]
    figure = Figure(figsize=(BAR_PX / 100, height / 100), dpi=100, facecolor="white")
    canvas = FigureCanvasAgg(figure)
    axes = figure.add_axes((0.12, 0.05, 0.16, 0.9))
    axes.imshow(np.linspace(0, 1, 256)[:, None], cmap=colours, aspect="auto", origin="lower", extent=(0, 1, 0, 1))
    places = np.linspace(0, 1, TICKS)
    axes.set_yticks(places, [text(low + place * (high - low)) for place in places], fontsize=FONT_PX * 0.72)
    axes.set_xticks([])
    axes.yaxis.tick_right()
    axes.yaxis.set_label_position("right")
    axes.set_ylabel(label, fontsize=FONT_PX * 0.72)
    canvas.draw()
    bar = np.asarray(canvas.buffer_rgba())[..., :3]
    return np.ascontiguousarray(np.hstack([picture, bar[:height]]))
