"""Masks for the near-infrared stop: shapes on a grid of cells with a given light budget, and their smallest feature.

A mask is a picture of amplitudes 0..1, [y, x], over the square around the lens: 1 open, 0 closed; its transmittance is
the square of the amplitude. Its light budget is its open area over that of the lens: alpha^2 for a disc of radius
alpha.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from dasim.base.errors import InputError
from dasim.bounds import pupils
from dasim.camera import stops
from dasim.typing import FloatArray

FEATURE_TOLERANCE = 0.005  # share of the lens's cells that opening and closing may change


def inside(cells: int) -> NDArray[np.bool_]:
    """Cells whose centre lies within the lens, [cells, cells]."""
    place = stops.cell_centres(cells)
    return np.asarray(np.hypot(place[:, None], place[None, :]) <= 1)


def transmittance(amplitude: FloatArray) -> FloatArray:
    """Transmittance of a mask, 0..1, [cells, cells]; 0 outside the lens."""
    return np.asarray(np.where(inside(len(amplitude)), np.clip(amplitude, 0, 1) ** 2, 0.0))


def budget(amplitude: FloatArray) -> float:
    """Light budget of a mask: its open area over that of the lens."""
    return float((amplitude**2).sum()) * (2 / len(amplitude)) ** 2 / np.pi


def disc(cells: int, share: float, centre: tuple[float, float] = (0.0, 0.0)) -> FloatArray:
    """A disc of the light budget ``share``: the cells of which it covers at least half.

    ``centre`` is (x, y) in radii of the lens.
    """
    stop = stops.Disc(name="disc", radius_ratio=float(np.sqrt(share)), centre_ratio=centre)
    return _binary(pupils.stop_amplitude(stop, cells))


def annulus(cells: int, share: float, inner: float) -> FloatArray:
    """A ring of the light budget ``share`` and the inner radius ``inner``, in radii of the lens.

    Raises InputError for a ring that does not fit into the lens.
    """
    outer = float(np.sqrt(share + inner**2))
    if outer > 1:
        raise InputError(
            f"annulus: an inner radius of {inner:g} with a light budget of {share:g} extends outside the lens"
        )
    ring = stops.Annulus(name="ring", shape="annulus", inner_ratio=inner, outer_ratio=outer)
    return _binary(pupils.stop_amplitude(ring, cells))


def _binary(covered: FloatArray) -> FloatArray:
    return np.where(inside(len(covered)) & (covered >= 0.5), 1.0, 0.0)


def square(pattern: FloatArray, cells: int, share: float | None = None) -> FloatArray:
    """A square pattern of 0 and 1, [n, n], centred in the lens: of the light budget ``share``, or as large as fits.

    The smaller of the two sizes; :func:`budget` gives the light budget of the result.
    """
    side = float(np.sqrt(2.0))  # of the square inscribed in a circle of radius 1
    if share is not None:
        side = min(side, float(np.sqrt(share * np.pi / pattern.mean())))
    edges = (np.arange(len(pattern) + 1) / len(pattern) - 0.5) * side
    covered = overlap(np.arange(cells + 1) * 2 / cells - 1, edges) / (2 / cells)
    return _binary(covered @ pattern @ covered.T)


def overlap(first: NDArray[np.floating], second: NDArray[np.floating]) -> FloatArray:
    """Lengths that the intervals between the edges ``first`` [n + 1] share with those of ``second`` [m + 1], [n, m]."""
    low = np.maximum(first[:-1, None], second[None, :-1])
    high = np.minimum(first[1:, None], second[None, 1:])
    return np.asarray(np.clip(high - low, 0.0, None), np.float64)


def smallest_feature(amplitude: FloatArray) -> int:
    """Diameter in cells of the largest disc that fits everywhere into the open and into the closed part of a mask.

    The largest diameter for which opening and closing the mask (:func:`smoothed`) change no more than
    ``FEATURE_TOLERANCE`` of the lens's cells. The area outside the lens counts as neither open nor closed.
    """
    whole = inside(len(amplitude))
    mask = (amplitude > 0.5) & whole
    largest = 1
    for diameter in range(2, len(amplitude)):
        changed = smoothed(mask, diameter, whole) != mask
        if changed.sum() > FEATURE_TOLERANCE * whole.sum():
            break
        largest = diameter
    return largest


def smoothed(mask: NDArray[np.bool_], diameter: int, whole: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """A mask after morphological opening, then closing, by a disc of ``diameter`` cells, within the lens ``whole``."""
    place = np.arange(diameter) - (diameter - 1) / 2
    element = np.hypot(place[:, None], place[None, :]) <= diameter / 2
    frame, outside = np.pad(mask, diameter), np.pad(~whole, diameter, constant_values=True)
    # A feature at the rim may continue outside: the outside counts as open for opening, and as closed for closing.
    opened = ndimage.binary_opening(frame | outside, element, border_value=1)
    closed = ndimage.binary_closing(opened & ~outside, element)
    return np.asarray(closed[diameter:-diameter, diameter:-diameter] & whole)
