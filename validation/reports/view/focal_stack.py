"""The focal stack of a reconstruction: pictures of ``recon.refocus`` at even steps of blur and several apertures."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

import recon
from dasim.typing import Float32Array, Progress
from dasim.values import PsfBank, Reconstruction
from recon.files.reconstruction import displayed
from recon.levels import depth_of

SERIES = (1.0, 1.4, 2.0, 2.8, 4.0, 5.6, 8.0, 11.0, 16.0, 22.0, 32.0)  # f-numbers engraved on lenses
SMALLER_APERTURES = 3  # of the series, beside the lens's own
NEXT_STOP = 1.1  # an f-number of the series counts as smaller from this factor on
STEP_LEVELS = 1.0  # between neighbouring focus distances at the lens's own aperture, where they are not too many
MOST_SLICES = 24  # at the lens's own aperture
OUTLIERS = 1.0  # percent of the pixels at either end of the levels that need no slice of their own


@dataclass(frozen=True, repr=False)
class Slice:
    """One picture of the stack."""

    f_number: float
    depth_m: float  # focus distance
    picture: Float32Array  # [h, w, 3] sRGB 0..1


def f_numbers(own: float) -> tuple[float, ...]:
    """The lens's own f-number and the next ``SMALLER_APERTURES`` of the series."""
    return own, *[number for number in SERIES if number > NEXT_STOP * own][:SMALLER_APERTURES]


def focus_depths_m(level: NDArray, bank: PsfBank, count: int | None = None) -> list[float]:
    """Focus distances in metres from near to far, evenly spaced in levels and so in dioptres.

    They reach from the nearest to the farthest level of the scene [h, w], and to the focus of the capture, level 0.

    Args:
        level: levels of the scene, [h, w].
        bank: the PSF bank, whose levels have depths.
        count: how many; by default ``STEP_LEVELS`` apart, at most ``MOST_SLICES``.
    """
    low, high = np.percentile(level[np.isfinite(level)], [OUTLIERS, 100 - OUTLIERS])
    low, high = min(float(low), 0.0), max(float(high), 1.0)
    if count is None:
        count = min(int(np.ceil((high - low) / STEP_LEVELS)) + 1, MOST_SLICES)
    behind = None if bank.behind is None else bank.behind.depth_m
    depths = depth_of(np.linspace(high, low, count), bank.depth_m, behind)
    return [float(depth) for depth in np.unique(depths)]  # one each where levels exceed the bank


def plan(result: Reconstruction, bank: PsfBank, count: int | None = None) -> list[tuple[float, list[float]]]:
    """f-numbers with their focus distances in metres.

    At a smaller aperture the blur between two distances is smaller in proportion, and so is the number of distances.
    """
    own = result.camera.lens.f_number
    at_own = len(focus_depths_m(result.level, bank, count))
    numbers = f_numbers(own)
    counts = [max(int(np.ceil((at_own - 1) * own / number)) + 1, 2) for number in numbers]
    return [(number, focus_depths_m(result.level, bank, least)) for number, least in zip(numbers, counts, strict=True)]


def focal_stack(result: Reconstruction, bank: PsfBank, count: int | None, progress: Progress) -> list[Slice]:
    """The pictures of the stack, by f-number and within it from near to far.

    Args:
        result: the reconstruction.
        bank: its PSF bank.
        count: number of focus distances at the lens's own aperture; see :func:`focus_depths_m`.
        progress: called with a stage and the share of it that is done.
    """
    places = [(number, depth) for number, depths in plan(result, bank, count) for depth in depths]
    slices = []
    for done, (number, depth) in enumerate(places):
        progress("refocusing", done / len(places))
        slices.append(Slice(number, depth, displayed(recon.refocus(result, bank, depth, number), result)))
    progress("refocusing", 1.0)
    return slices
