"""Files of a mask for people and machines: a PNG that a camera reads, and an SVG drawing in millimetres."""

from __future__ import annotations

import itertools
from pathlib import Path

import numpy as np

from dasim.camera import stops
from dasim.camera.geometry import aperture_m
from dasim.camera.specification import Camera
from dasim.files.png import write_png16
from dasim.typing import FloatArray
from validation.studies.shape import masks

MARGIN = 0.35  # of the lens's diameter around the drawing, for the dimensions


def save_png(path: Path, amplitude: FloatArray) -> None:
    """Write the transmittance as a 16-bit grey PNG, linear, white open, as :class:`dasim.camera.stops.Mask` reads it.

    Each cell is a square of pixels, as many as the largest mask that a camera reads permits.
    """
    repeat = max(1, stops.MOST_MASK_CELLS // len(amplitude))
    picture = np.kron(masks.transmittance(amplitude), np.ones((repeat, repeat)))
    picture = np.where(masks.inside(len(picture)), picture, 0.0)
    write_png16(path, np.rint(picture * 65535).astype(np.uint16))


def svg(camera: Camera, amplitude: FloatArray, title: str) -> str:
    """An SVG drawing in mm: the rim of the lens, the open cells, the lens's diameter and a scale bar; 1 unit is 1 mm.

    Open cells are white on the black coating, with their transmittance as opacity. Each run of equal cells in a row is
    one rectangle, so that a plotter receives the cells exactly.
    """
    diameter_mm = aperture_m(camera) * 1e3
    radius, side = diameter_mm / 2, diameter_mm / len(amplitude)
    margin = MARGIN * diameter_mm
    width = diameter_mm + 2 * margin
    line = 0.004 * diameter_mm
    corner = f"{-radius - margin:.4f}"
    cells = _runs(masks.transmittance(amplitude).round(3), radius, side)
    lines = [
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{width * 60:.0f}" height="{width * 60:.0f}" '
        f'viewBox="{corner} {corner} {width:.4f} {width:.4f}">',
        f"<title>{title}: 1 unit is 1 mm</title>",
        f'<rect x="{corner}" y="{corner}" width="{width:.4f}" height="{width:.4f}" fill="#fff"/>',
        f'<circle r="{radius:.5f}" fill="#111"/>',
        f'<g fill="#fff" shape-rendering="crispEdges">{cells}</g>',
        f'<circle r="{radius:.5f}" fill="none" stroke="#d55e00" stroke-width="{line:.5f}"/>',
        *_dimensions(diameter_mm, line),
        *_labels(diameter_mm, line, title, f"open {100 * masks.budget(amplitude):.1f} % of the lens, "
                 f"cells of {side * 1e3:.1f} um"),
        "</svg>",
    ]  # fmt: skip
    return "\n".join(lines)


def _dimensions(diameter_mm: float, line: float) -> list[str]:
    """The dimension line of the diameter, below the lens."""
    radius, text, below = diameter_mm / 2, _text_height(diameter_mm), _dimension_y(diameter_mm)
    return [
        f'<g stroke="#d55e00" stroke-width="{line:.5f}" fill="none">'
        f'<path d="M{-radius:.4f} 0V{below:.4f}M{radius:.4f} 0V{below:.4f}" stroke-dasharray="{4 * line:.4f}"/>'
        f'<path d="M{-radius:.4f} {below:.4f}H{radius:.4f}"/></g>',
        _arrow(-radius, below, 1, text),
        _arrow(radius, below, -1, text),
    ]


def _labels(diameter_mm: float, line: float, title: str, size: str) -> list[str]:
    """The scale bar, 1, 2 or 5 times a power of ten mm long, and all text."""
    radius, text, below = diameter_mm / 2, _text_height(diameter_mm), _dimension_y(diameter_mm)
    bar_mm = float(10 ** np.floor(np.log10(radius)))
    bar_mm = bar_mm * (5 if 5 * bar_mm <= radius else 2 if 2 * bar_mm <= radius else 1)
    return [
        f'<path d="M{-bar_mm / 2:.4f} {below + 2.9 * text:.4f}h{bar_mm:g}" '
        f'stroke="#111" stroke-width="{3 * line:.5f}"/>',
        f'<g font-family="sans-serif" font-size="{text:.4f}" text-anchor="middle">'
        f'<text y="{-radius - 0.12 * diameter_mm:.4f}">{title}</text>'
        f'<text y="{-radius - 0.05 * diameter_mm:.4f}">{size}</text>'
        f'<text y="{below + 1.3 * text:.4f}" fill="#d55e00">diameter {diameter_mm:.3f} mm (lens aperture)</text>'
        f'<text y="{below + 4.1 * text:.4f}">{bar_mm:g} mm</text></g>',
    ]


def _text_height(diameter_mm: float) -> float:
    return 0.045 * diameter_mm


def _dimension_y(diameter_mm: float) -> float:
    return diameter_mm / 2 + 0.10 * diameter_mm


def _arrow(x: float, y: float, way: int, text: float) -> str:
    """An arrow head at (x, y) that points to -x for ``way`` 1, to +x for -1."""
    size = 0.5 * text
    return f'<path d="M{x:.4f} {y:.4f}l{way * size:.4f} {-size / 3:.4f}v{2 * size / 3:.4f}z" fill="#d55e00"/>'


def _runs(transmittance: FloatArray, radius: float, side: float) -> str:
    """Rectangles, one for each run of equal open cells in a row."""
    parts = []
    for row, values in enumerate(transmittance):
        edges = [0, *(np.flatnonzero(np.diff(values)) + 1), len(values)]
        for start, end in itertools.pairwise(edges):
            if values[start] > 0:
                opacity = "" if values[start] == 1 else f' fill-opacity="{values[start]:g}"'
                parts.append(
                    f'<rect x="{start * side - radius:.5f}" y="{row * side - radius:.5f}" '
                    f'width="{(end - start) * side:.5f}" height="{side:.5f}"{opacity}/>'
                )
    return "".join(parts)
