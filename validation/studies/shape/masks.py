"""Masks for the near-infrared stop: shapes on a grid at a given light budget, and drawings of them in mm.

A mask is a picture of amplitudes 0..1 over the square around the lens, [y, x]: 1 open, 0 closed; its transmittance is
the square. Its light budget is its open area over the lens's, alpha^2 of a disc.
"""

from __future__ import annotations

import itertools
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from dasim.base.errors import InputError
from dasim.bounds import pupils
from dasim.camera import stops
from dasim.camera.geometry import aperture_m
from dasim.camera.specification import Camera
from dasim.typing import FloatArray
from validation.studies import criteria

_MARGIN = 0.35  # of the lens's radius around the drawing, for the dimensions


def inside(cells: int) -> NDArray[np.bool_]:
    """Cells whose centre lies in the lens, [cells, cells]."""
    place = stops.cell_centres(cells)
    return np.asarray(np.hypot(place[:, None], place[None, :]) <= 1)


def budget(amplitude: FloatArray) -> float:
    """Open area over the lens's."""
    return float((amplitude**2).sum()) * (2 / len(amplitude)) ** 2 / np.pi


def disc(cells: int, share: float, centre: tuple[float, float] = (0.0, 0.0)) -> FloatArray:
    """A disc of a light budget: the cells that it covers by half or more."""
    stop = stops.Disc(name="disc", radius_ratio=float(np.sqrt(share)), centre_ratio=centre)
    return _binary(pupils.drawn(stop, cells))


def annulus(cells: int, share: float, inner: float) -> FloatArray:
    """A ring of a light budget; InputError where it does not fit into the lens."""
    outer = float(np.sqrt(share + inner**2))
    if outer > 1:
        raise InputError(
            f"annulus: an inner radius of {inner:g} and a light budget of {share:g} reach outside the lens"
        )
    ring = stops.Annulus(name="ring", shape="annulus", inner_ratio=inner, outer_ratio=outer)
    return _binary(pupils.drawn(ring, cells))


def _binary(covered: FloatArray) -> FloatArray:
    return np.where(inside(len(covered)) & (covered >= 0.5), 1.0, 0.0)


def square(pattern: FloatArray, cells: int, share: float | None = None) -> FloatArray:
    """A square pattern of 0 and 1 in the middle of the lens: as large as fits, or of a light budget if that is less.

    :func:`budget` says what the mask then passes.
    """
    side = float(np.sqrt(2.0))  # of the square in a circle of radius 1
    if share is not None:
        side = min(side, float(np.sqrt(share * np.pi / pattern.mean())))
    edges = (np.arange(len(pattern) + 1) / len(pattern) - 0.5) * side
    own = np.arange(cells + 1) * 2 / cells - 1
    low, high = np.maximum(own[:-1, None], edges[None, :-1]), np.minimum(own[1:, None], edges[None, 1:])
    covered = np.clip(high - low, 0.0, None) / (2 / cells)
    return _binary(covered @ pattern @ covered.T)


def smallest_feature(amplitude: FloatArray, tolerance: float = 0.005) -> int:
    """Diameter in cells of the largest disc that fits everywhere into what is open and into what is closed.

    By opening and closing the mask; of the lens's cells a share of ``tolerance`` may change. What lies outside the lens
    may be open or closed.
    """
    whole = inside(len(amplitude))
    mask = (amplitude > 0.5) & whole
    most = 1
    for diameter in range(2, len(amplitude)):
        changed = smoothed(mask, diameter, whole) != mask
        if changed.sum() > tolerance * whole.sum():
            break
        most = diameter
    return most


def smoothed(mask: NDArray[np.bool_], diameter: int, whole: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """A mask opened, then closed, by a disc of a diameter in cells, within the lens ``whole``."""
    place = np.arange(diameter) - (diameter - 1) / 2
    element = np.hypot(place[:, None], place[None, :]) <= diameter / 2
    frame, outside = np.pad(mask, diameter), np.pad(~whole, diameter, constant_values=True)
    # What lies at the rim may go on outside: outside counts as open for opening, as closed for closing.
    opened = ndimage.binary_opening(frame | outside, element, border_value=1)
    closed = ndimage.binary_closing(opened & ~outside, element)
    return np.asarray(closed[diameter:-diameter, diameter:-diameter] & whole)


def camera_with(camera: Camera, amplitude: FloatArray) -> Camera:
    """The camera with a mask in its near-infrared stop; InputError where no light gets through."""
    transmittance = np.where(inside(len(amplitude)), np.clip(amplitude, 0, 1) ** 2, 0.0).round(4)
    if transmittance.max() <= 0:
        raise InputError("mask: is closed everywhere; no near-infrared gets through")
    stop = criteria.infrared_stop(camera)
    mask = stops.Mask(
        name=stop.name,
        shape="mask",
        mask=tuple(map(tuple, transmittance.tolist())),
        passes_nm=stop.passes_nm,
        edge_width_nm=stop.edge_width_nm,
    )
    return criteria.with_stop(camera, mask)


# --- drawings ------------------------------------------------------------------------------------


def save_png(path: Path, amplitude: FloatArray) -> None:
    """A grey picture of the transmittance, linear, white open, each cell a square of pixels: as a camera reads it.

    16 bits; one pixel a cell would do for :class:`dasim.camera.stops.Mask`, so cells are repeated only as far as it
    reads.
    """
    repeat = max(1, stops.MOST_MASK_CELLS // len(amplitude))
    picture = np.where(inside(len(amplitude)), np.clip(amplitude, 0, 1) ** 2, 0.0)
    picture = np.kron(picture, np.ones((repeat, repeat)))
    picture = np.where(inside(len(picture)), picture, 0.0)
    cv2.imwrite(str(path), np.rint(picture * 65535).astype(np.uint16))


def svg(camera: Camera, amplitude: FloatArray, title: str) -> str:
    """A drawing in mm, 1 unit 1 mm times ten: the rim of the lens, what is open, its diameter and a scale bar.

    Open cells are white with their transmittance as opacity, on the black coating; each run of equal cells in a row is
    one rectangle, so that a plotter gets the cells as they are.
    """
    diameter_mm = aperture_m(camera) * 1e3
    radius, cells = diameter_mm / 2, len(amplitude)
    side = diameter_mm / cells
    margin = _MARGIN * diameter_mm
    width, height = diameter_mm + 2 * margin, diameter_mm + 2 * margin
    passed = np.where(inside(cells), np.clip(amplitude, 0, 1) ** 2, 0.0).round(3)
    bar_mm = float(10 ** np.floor(np.log10(radius)))
    bar_mm = bar_mm * (5 if 5 * bar_mm <= radius else 2 if 2 * bar_mm <= radius else 1)
    text = 0.045 * diameter_mm
    line = 0.004 * diameter_mm
    below = radius + 0.10 * diameter_mm
    lines = [
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{width * 60:.0f}" height="{height * 60:.0f}" '
        f'viewBox="{-radius - margin:.4f} {-radius - margin:.4f} {width:.4f} {height:.4f}">',
        f"<title>{title}: 1 unit is 1 mm</title>",
        f'<rect x="{-radius - margin:.4f}" y="{-radius - margin:.4f}" width="{width:.4f}" height="{height:.4f}" '
        'fill="#fff"/>',
        f'<circle r="{radius:.5f}" fill="#111"/>',
        f'<g fill="#fff" shape-rendering="crispEdges">{_runs(passed, radius, side)}</g>',
        f'<circle r="{radius:.5f}" fill="none" stroke="#d55e00" stroke-width="{line:.5f}"/>',
        f'<g stroke="#d55e00" stroke-width="{line:.5f}" fill="none">'
        f'<path d="M{-radius:.4f} 0V{below:.4f}M{radius:.4f} 0V{below:.4f}" stroke-dasharray="{4 * line:.4f}"/>'
        f'<path d="M{-radius:.4f} {below:.4f}H{radius:.4f}"/></g>',
        _arrow(-radius, below, 1, text),
        _arrow(radius, below, -1, text),
        f'<path d="M{-bar_mm / 2:.4f} {below + 2.9 * text:.4f}h{bar_mm:g}" '
        f'stroke="#111" stroke-width="{3 * line:.5f}"/>',
        f'<g font-family="sans-serif" font-size="{text:.4f}" text-anchor="middle">'
        f'<text y="{-radius - 0.12 * diameter_mm:.4f}">{title}</text>'
        f'<text y="{-radius - 0.05 * diameter_mm:.4f}">open {100 * budget(amplitude):.1f} % of the lens, '
        f"cells of {side * 1e3:.1f} um</text>"
        f'<text y="{below + 1.3 * text:.4f}" fill="#d55e00">diameter {diameter_mm:.3f} mm (lens aperture)</text>'
        f'<text y="{below + 4.1 * text:.4f}">{bar_mm:g} mm</text></g>',
        "</svg>",
    ]
    return "\n".join(lines)


def _arrow(x: float, y: float, way: int, text: float) -> str:
    size = 0.5 * text
    return f'<path d="M{x:.4f} {y:.4f}l{way * size:.4f} {-size / 3:.4f}v{2 * size / 3:.4f}z" fill="#d55e00"/>'


def _runs(passed: FloatArray, radius: float, side: float) -> str:
    """Rectangles of equal open cells in a row."""
    parts = []
    for row, values in enumerate(passed):
        edges = [0, *(np.flatnonzero(np.diff(values)) + 1), len(values)]
        for start, end in itertools.pairwise(edges):
            if values[start] > 0:
                opacity = "" if values[start] == 1 else f' fill-opacity="{values[start]:g}"'
                parts.append(
                    f'<rect x="{start * side - radius:.5f}" y="{row * side - radius:.5f}" '
                    f'width="{(end - start) * side:.5f}" height="{side:.5f}"{opacity}/>'
                )
    return "".join(parts)
