"""Field rings: angles at which responses are computed, and between which they are interpolated for each pixel.

Coatings shift with the angle of the chief ray (:mod:`dasim.camera.coatings`), and the responses of the pixels shift
with them. The rings are evenly spaced in sin^2 of that angle, in which the shift is nearly linear, and close enough
that no edge moves by more than about half of its width from one ring to the next. Linear interpolation of the responses
between two rings then has the correct area, and an edge of nearly the correct shape. The spacing depends on the camera,
not on its frame, so that a crop has the responses of that part of the whole frame.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np

from dasim.camera.distortion import square_of_pinhole_height_m2
from dasim.camera.geometry import field_angle_deg as field_angle_deg
from dasim.camera.geometry import image_distance_m
from dasim.camera.specification import Camera
from dasim.spectra import grid
from dasim.typing import FloatArray


class Rings(NamedTuple):
    """Angles of the rings that a frame needs, and the place of every pixel between them."""

    angle_deg: FloatArray  # [ring] of the chief ray, from 0
    place: FloatArray  # [h, w] fractional number of the ring


def rings(*cameras: Camera) -> Rings:
    """The rings of the first camera's frame, close enough for the coatings of all; one ring where nothing shifts."""
    spacing = min(spacing_of(camera) for camera in cameras)
    sine2 = square_of_sine(cameras[0])
    if not np.isfinite(spacing):
        return Rings(np.zeros(1), np.zeros_like(sine2))
    place = sine2 / spacing
    count = int(place.max()) + 2
    return Rings(np.degrees(np.arcsin(np.sqrt(np.minimum(np.arange(count) * spacing, 1.0)))), place)


def spacing_of(camera: Camera) -> float:
    """Difference of sin^2 of the angle from ring to ring; infinite where no edge moves.

    An edge at lambda_0 moves by lambda_0 sin^2 / (2 n^2), so that half of its width takes n^2 width / lambda_0.
    """
    spacings = [
        index**2 * max(width_nm, grid.WAVELENGTH_STEP_NM) / edge_nm
        for index, edge_nm, width_nm in _edges(camera)
        if index != 0
    ]
    return min(spacings, default=np.inf)


def _edges(camera: Camera) -> Iterator[tuple[float, float, float]]:
    """Effective index, wavelength and width of each spectral edge."""
    for stop in camera.stops:
        for edge_nm in (edge for band in stop.passes_nm for edge in band if edge not in grid.WHOLE_GRID_NM):
            yield camera.lens.coating_index, edge_nm, stop.edge_width_nm
    yield camera.sensor.coating_index, camera.sensor.cutoff_nm, camera.sensor.cutoff_width_nm


def square_of_sine(camera: Camera) -> FloatArray:
    """Square of the sine of the chief ray's angle at each pixel, [h, w]: r^2 / (r^2 + s^2)."""
    r2 = square_of_pinhole_height_m2(camera)
    return r2 / (r2 + image_distance_m(camera) ** 2)


def at_pixels(values: FloatArray, place: FloatArray) -> FloatArray:
    """Values of the rings [ring, ...] interpolated linearly to pixels of ``place`` [...], [*place, ...]."""
    if len(values) == 1:
        return np.broadcast_to(values[0], (*place.shape, *values.shape[1:]))
    rows = np.arange(len(values))
    flat: Any = values.reshape(len(values), -1)
    parts = [np.interp(place, rows, column) for column in flat.T]
    return np.stack(parts, axis=-1).reshape(*place.shape, *values.shape[1:])
