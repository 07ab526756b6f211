"""Masks that a search is compared with: the disc, rings, discs at the rim and published codes, at one light budget."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from dasim.typing import FloatArray
from validation.studies.shape import free_stop, masks, published_codes
from validation.studies.shape.free_stop import FreeStop

AT_RIM = "disc at the rim"  # displaced as far as the lens permits: infrared shifts with defocus, and stays as sharp
INNER_RADII = (0.25, 0.5, 0.75)  # of the rings, in radii of the lens
RINGS = 25  # inner radii of the search for the best ring
CODES = {
    "Levin 2007, rebuilt": published_codes.levin,
    "Veeraraghavan 2007, rebuilt": published_codes.veeraraghavan,
    "Zhou & Nayar 2009, rebuilt": published_codes.zhou_nayar,
}


@dataclass(frozen=True)
class Design:
    """A mask, and for a search the course of its objective."""

    name: str
    amplitude: FloatArray  # [cells, cells]
    history: tuple[float, ...] = ()  # the objective at each evaluation
    steps: tuple[int, ...] = ()  # evaluations at which beta rose


def disc_name(budget: float) -> str:
    """Name of the disc of a light budget."""
    return f"disc {np.sqrt(budget):.2f}"


def references(cells: int, budget: float) -> list[Design]:
    """The disc first, then rings, a disc and two discs at the rim, and published codes, at the same light budget.

    Codes are also given as large as the lens permits where that passes at least 5 % more light.
    """
    alpha = float(np.sqrt(budget))
    designs = [Design(disc_name(budget), masks.disc(cells, budget))]
    for inner in INNER_RADII:
        if inner**2 + budget <= 1:
            designs.append(Design(f"ring from {inner:g}", masks.annulus(cells, budget, inner)))
    designs.append(Design(AT_RIM, masks.disc(cells, budget, (1 - alpha, 0.0))))
    # Two windows at opposite ends of the lens: a stereo pair in one lens, with both pictures superimposed.
    half = budget / 2
    apart = 1 - float(np.sqrt(half))
    if apart > np.sqrt(half):
        two = masks.disc(cells, half, (apart, 0.0)) + masks.disc(cells, half, (-apart, 0.0))
        designs.append(Design("two discs at the rim", two))
    designs += [Design(name, masks.square(code(), cells, budget)) for name, code in CODES.items()]
    for name, code in CODES.items():
        largest = masks.square(code(), cells)
        if masks.budget(largest) > 1.05 * budget:
            designs.append(Design(f"{name}, as large as fits", largest))
    return designs


def best_ring(free: Callable[[int, float], FreeStop], cells: int, budget: float) -> Design:
    """The ring of a light budget with the smallest objective over its inner radius; an inner radius of 0 is a disc.

    ``free`` gives the free stop for a number of cells and a light budget.
    """
    largest = float(np.sqrt(1 - budget))
    rings = []
    for inner in np.linspace(0, largest, RINGS):
        mask = masks.disc(cells, budget) if inner == 0 else masks.annulus(cells, budget, float(inner) * (1 - 1e-9))
        rings.append((free_stop.value(free(cells, budget), mask), float(inner), mask))
    _, inner, mask = min(rings, key=lambda one: one[0])
    return Design(f"best ring, from {inner:.2f}", mask)
