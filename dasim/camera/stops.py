"""Stops of the lens, each with a shape in the pupil and a spectral transmittance.

The light through different stops adds up: a glass disc that blocks the near-infrared outside a hole is modelled as the
open lens with the transmittance of the disc, plus the hole with the complement. (Within the few nanometres of the
coating's edge, where both stops pass light of the same wavelength, the sum neglects interference.)

Lengths in the pupil are ratios of the radius of the open lens, in camera axes: x to the right, y down.

Tested in tests/dasim/render/test_pupil.py and tests/dasim/camera/test_cameras.py.
"""

from __future__ import annotations

import itertools
from functools import lru_cache
from typing import Annotated, Any, Literal, NamedTuple

import cv2
import numpy as np
from pydantic import Field, ValidationInfo, field_validator, model_validator

from dasim.base import untrusted
from dasim.base.toml import Specification, named_file
from dasim.camera.zernike import Wavefront
from dasim.spectra import grid
from dasim.spectra.grid import WHOLE_GRID_NM
from dasim.typing import FloatArray

Transmittance = Annotated[float, Field(ge=0, le=1)]
Ratio = Annotated[float, Field(ge=-1, le=1)]  # of the radius of the open lens
Point = tuple[Ratio, Ratio]

MOST_MASK_CELLS = 256  # per side
LEAST_RADIUS_RATIO = 0.05  # f/56 at f/2.8, whose diffraction fills a phone's frame
MOST_PHASE_NM = 10_000.0  # micrometres of coating
PUPIL_CELLS = 256  # per side of the grid that represents the open area of a stop
_FINE_ROWS = 16  # in a cell, for the share of it that a stop covers
_ROUNDING = 1e-9


class _Stop(Specification):
    name: str = Field(min_length=1)
    passes_nm: tuple[tuple[grid.AnyNm, grid.AnyNm], ...] = Field(
        default=(WHOLE_GRID_NM,), min_length=1, description="bands that pass; 400 and 830 mean no edge"
    )
    edge_width_nm: float = Field(default=8.0, gt=0, le=100, description="10-90 % width of every edge")
    phase_nm: float = Field(
        default=0.0,
        ge=-MOST_PHASE_NM,
        le=MOST_PHASE_NM,
        description="optical path through this opening minus that through the coating around it: light of the other "
        "stops has a phase step at its rim",
    )
    wavefront_nm: Wavefront = Field(
        default=Wavefront(), description="Zernike coefficients of this stop's light beside those of the lens"
    )
    glare_share: float = Field(default=0.0, ge=0, le=0.5, description="share of this stop's light that veils the frame")
    glare_radius_mm: float | None = Field(
        default=None, ge=0.02, le=1000, description="half of the veil lies within; by default twice the image distance"
    )

    @field_validator("passes_nm")
    @classmethod
    def _in_order(cls, bands: tuple[tuple[float, float], ...]) -> tuple[tuple[float, float], ...]:
        edges = [edge for band in bands for edge in band]
        low, high = WHOLE_GRID_NM
        if min(edges) < low or max(edges) > high:
            raise ValueError(f"bands must lie within {low:g} to {high:g} nm")
        if any(b <= a for a, b in itertools.pairwise(edges)):
            raise ValueError("bands must be [from, to] in rising order, without overlap")
        return bands


class Disc(_Stop):
    """An open disc, about the axis or displaced."""

    shape: Literal["disc"] = "disc"
    radius_ratio: float = Field(ge=LEAST_RADIUS_RATIO, le=1)
    centre_ratio: Point = (0.0, 0.0)

    @model_validator(mode="after")
    def _inside(self) -> Disc:
        _check_reach(float(np.hypot(*self.centre_ratio)) + self.radius_ratio, "centre_ratio and radius_ratio")
        return self


class Annulus(_Stop):
    """An open ring, about the axis or displaced."""

    shape: Literal["annulus"]
    inner_ratio: float = Field(gt=0, lt=1)
    outer_ratio: float = Field(gt=0, le=1)
    centre_ratio: Point = (0.0, 0.0)

    @model_validator(mode="after")
    def _inside(self) -> Annulus:
        if self.inner_ratio >= self.outer_ratio:
            raise ValueError("inner_ratio must be below outer_ratio")
        _check_reach(float(np.hypot(*self.centre_ratio)) + self.outer_ratio, "centre_ratio and outer_ratio")
        return self


class Polygon(_Stop):
    """A simple polygon, which may be concave; the corners are listed in order."""

    shape: Literal["polygon"]
    corners_ratio: tuple[Point, ...] = Field(min_length=3, max_length=200)

    @field_validator("corners_ratio")
    @classmethod
    def _simple(cls, corners: tuple[Point, ...]) -> tuple[Point, ...]:
        _check_reach(float(np.hypot(*np.array(corners).T).max()), "corners_ratio")
        triangles(corners)
        return corners


class Mask(_Stop):
    """Transmittances 0..1 on a square grid that circumscribes the lens, top row first.

    In TOML, ``file`` names a linear grey image, black closed and white open, which is read into ``mask``.
    """

    shape: Literal["mask"]
    mask: tuple[tuple[Transmittance, ...], ...] = Field(min_length=2, max_length=MOST_MASK_CELLS)

    @model_validator(mode="before")
    @classmethod
    def _read(cls, data: Any, info: ValidationInfo) -> Any:
        if not isinstance(data, dict) or "file" not in data:
            return data
        if "mask" in data:
            raise ValueError("file and mask both say what is open; give one")
        path = named_file(data, info)
        picture = untrusted.picture(path, f"file {path}", cv2.IMREAD_GRAYSCALE | cv2.IMREAD_ANYDEPTH)
        if max(picture.shape) > MOST_MASK_CELLS or picture.dtype not in (np.uint8, np.uint16):
            raise ValueError(f"file {path}: must have 8 or 16 bits, and at most {MOST_MASK_CELLS} cells across")
        rows = (picture / np.iinfo(picture.dtype).max).round(4).tolist()
        return {key: value for key, value in data.items() if key != "file"} | {"mask": rows}

    @field_validator("mask")
    @classmethod
    def _open_inside_the_lens(cls, rows: tuple[tuple[float, ...], ...]) -> tuple[tuple[float, ...], ...]:
        if any(len(row) != len(rows) for row in rows):
            raise ValueError("must be square, with as many columns as rows")
        values = np.array(rows)
        if values.max() <= 0:
            raise ValueError("is closed everywhere")
        place = cell_centres(len(rows))
        if (values[np.hypot(place[:, None], place[None, :]) > 1 + _ROUNDING] > 0).any():
            raise ValueError("is open outside the lens; cells whose centre lies beyond its rim must be 0")
        return rows


def _check_reach(reach: float, keys: str) -> None:
    if reach > 1 + _ROUNDING:
        raise ValueError(f"the stop reaches outside the lens, to {reach:.4g} of its radius; {keys} must keep within 1")


Stop = Annotated[Disc | Annulus | Polygon | Mask, Field(discriminator="shape")]


class Ring(NamedTuple):
    """A disc (``inner`` 0) or annulus; lengths are ratios of the lens's radius."""

    inner: float
    outer: float
    centre: Point


def ring(stop: Stop) -> Ring | None:
    """The stop as a ring, or None for other shapes."""
    if isinstance(stop, Disc):
        return Ring(0.0, stop.radius_ratio, stop.centre_ratio)
    if isinstance(stop, Annulus):
        return Ring(stop.inner_ratio, stop.outer_ratio, stop.centre_ratio)
    return None


def is_plain_disc(stop: Stop) -> bool:
    """Whether the stop is a disc about the axis."""
    return isinstance(stop, Disc) and stop.centre_ratio == (0.0, 0.0)


def transmittance(stop: Stop, edge_factor: float = 1.0) -> FloatArray:
    """Spectral transmittance 0..1 of the open area of a stop, [wavelength].

    The edges at the ends of ``passes_nm`` are logistic; two bands that share an edge, of one stop or two, sum to 1.
    ``edge_factor`` multiplies their wavelengths, see :func:`dasim.camera.coatings.edge_factor`.
    """
    passed = np.zeros_like(grid.WAVELENGTH_NM)
    for low, high in stop.passes_nm:
        rise = 1.0 if low <= WHOLE_GRID_NM[0] else grid.long_pass(low * edge_factor, stop.edge_width_nm)
        fall = 0.0 if high >= WHOLE_GRID_NM[1] else grid.long_pass(high * edge_factor, stop.edge_width_nm)
        passed = passed + (rise - fall)
    return np.clip(passed, 0.0, 1.0)


def open_area(stop: Stop) -> float:
    """Open area relative to the whole lens, 0..1; the cells of a mask count by their transmittance."""
    disc = ring(stop)
    if disc is not None:
        return disc.outer**2 - disc.inner**2
    if isinstance(stop, Polygon):
        return float(triangle_areas(triangles(stop.corners_ratio)).sum()) / np.pi
    assert isinstance(stop, Mask)
    return float(np.sum(stop.mask)) * (2.0 / len(stop.mask)) ** 2 / np.pi


def reach(stop: Stop) -> float:
    """Radius of the smallest disc about the axis that contains the stop."""
    disc = ring(stop)
    if disc is not None:
        return float(np.hypot(*disc.centre)) + disc.outer
    if isinstance(stop, Polygon):
        return float(np.hypot(*np.array(stop.corners_ratio).T).max())
    return 1.0


def breadth(stop: Stop) -> float:
    """Twice the open area over the length of the rim: the radius of a disc, the width of a ring.

    The light that is diffracted far from the centre of a kernel is proportional to the inverse.
    """
    disc = ring(stop)
    if disc is not None:
        return disc.outer - disc.inner
    if isinstance(stop, Polygon):
        corners = np.array(stop.corners_ratio)
        return 2 * np.pi * open_area(stop) / float(np.hypot(*(np.roll(corners, -1, axis=0) - corners).T).sum())
    assert isinstance(stop, Mask)
    amplitude = np.pad(np.sqrt(stop.mask), 1)
    steps = sum(float((np.diff(amplitude, axis=axis) ** 2).sum()) for axis in (0, 1))
    return 2 * float(np.sum(stop.mask)) / steps * (2.0 / len(stop.mask))


def cell_centres(count: int) -> FloatArray:
    """Centres of ``count`` cells across the lens, -1..1, [count]."""
    return (np.arange(count) + 0.5) * 2 / count - 1


@lru_cache(maxsize=16)
def pupil(stop: Stop) -> tuple[FloatArray, FloatArray]:
    """Transmittance of a stop on a grid, [y, x], and the centres of the cells along an axis.

    At the rim of a disc, ring or polygon, a cell has the share that is covered; the cells of a mask are repeated.
    """
    if isinstance(stop, Mask):
        repeat = -(-PUPIL_CELLS // len(stop.mask))
        values = np.kron(np.array(stop.mask), np.ones((repeat, repeat)))
        return values, cell_centres(len(values))
    disc = ring(stop)
    if disc is not None:
        values = _covered_by_disc(disc.outer, disc.centre) - _covered_by_disc(disc.inner, disc.centre)
        return values, cell_centres(PUPIL_CELLS)
    assert isinstance(stop, Polygon)
    # In each fine row, an edge adds or subtracts the coverage to its right, which is exact along x.
    y, left = cell_centres(PUPIL_CELLS * _FINE_ROWS)[:, None], np.arange(PUPIL_CELLS)
    covered = np.zeros((len(y), PUPIL_CELLS))
    for (ax, ay), (bx, by) in zip(stop.corners_ratio, (*stop.corners_ratio[1:], stop.corners_ratio[0]), strict=True):
        rows = np.flatnonzero((y >= ay) != (y >= by))
        if len(rows):
            cell = (ax + (y[rows] - ay) / (by - ay) * (bx - ax) + 1) / 2 * PUPIL_CELLS
            covered[rows] += np.sign(by - ay) * np.clip(left + 1 - cell, 0.0, 1.0)
    values = np.abs(covered).reshape(PUPIL_CELLS, _FINE_ROWS, PUPIL_CELLS).mean(axis=1)
    return values, cell_centres(PUPIL_CELLS)


def _covered_by_disc(radius: float, centre: Point) -> FloatArray:
    """Share of each cell of the pupil's grid that a disc covers, [y, x]; exact along x in each fine row."""
    y, left = cell_centres(PUPIL_CELLS * _FINE_ROWS)[:, None], np.arange(PUPIL_CELLS)
    half = np.sqrt(np.maximum(radius**2 - (y - centre[1]) ** 2, 0.0))
    low, high = ((centre[0] + side * half + 1) / 2 * PUPIL_CELLS for side in (-1, 1))
    covered = np.clip(high - left, 0.0, 1.0) - np.clip(low - left, 0.0, 1.0)
    return np.asarray(covered.reshape(PUPIL_CELLS, _FINE_ROWS, PUPIL_CELLS).mean(axis=1))


def triangle_areas(corners: FloatArray) -> FloatArray:
    """Areas of triangles [n, 3, 2]."""
    a, b = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    return np.abs(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]) / 2


def triangles(corners_ratio: tuple[Point, ...]) -> FloatArray:
    """Triangulation of a simple polygon by ear clipping, [n - 2, 3, 2]; ValueError where its sides cross."""
    points = np.array(corners_ratio, dtype=np.float64)
    if _turn(points, np.roll(points, -1, axis=0)) < 0:
        points = points[::-1]
    left, cut = list(range(len(points))), []
    while len(left) > 3:
        for place in range(len(left)):
            ear = [left[place - 1], left[place], left[(place + 1) % len(left)]]
            others = points[[index for index in left if index not in ear]]
            if _is_left(*points[ear]) > 0 and not _holds_any(points[ear], others):
                cut.append(points[ear])
                left.pop(place)
                break
        else:
            raise ValueError("is not a simple polygon: its sides cross or corners fall together")
    result = np.array([*cut, points[left]])
    whole = abs(_turn(points, np.roll(points, -1, axis=0))) / 2
    if whole <= _ROUNDING or abs(triangle_areas(result).sum() - whole) > 1e-6 * whole:
        raise ValueError("is not a simple polygon: its sides cross or it has no area")
    return result


def _turn(a: FloatArray, b: FloatArray) -> float:
    return float(np.sum(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]))


def _is_left(a: FloatArray, b: FloatArray, c: FloatArray) -> float:
    return float((b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]))


def _holds_any(triangle: FloatArray, points: FloatArray) -> bool:
    return any(all(_is_left(triangle[i - 1], triangle[i], p) >= 0 for i in range(3)) for p in points)


def light_loss(reductions: list[tuple[int, float]], pixels: int) -> float:
    """Share of light lost to smaller apertures, eq. (1): sum of n_k (1 - alpha_k^2) over ``pixels``.

    ``reductions`` holds (n_k, alpha_k): the pixels of the mosaic that see the k-th aperture and its
    radius relative to the lens. The formula assumes equal signals, disjoint colours and no crosstalk.
    """
    return sum(count * (1.0 - alpha**2) for count, alpha in reductions) / pixels
