"""Masks that a search is compared with: the same light budget, and the best ring."""

from __future__ import annotations

import numpy as np
import pytest

import dasim
from validation.studies.shape import designs, free_stop, masks
from validation.studies.shape.free_stop import FreeStop

BUDGET = 0.2116
CODE_CELLS = 0.04  # of the budget: cells of a code are drawn to whole cells of the grid


def test_references_have_the_same_light_budget() -> None:
    every = designs.references(128, BUDGET)
    assert every[0].name == designs.disc_name(BUDGET) == "disc 0.46"
    for design in every:
        budget = masks.budget(design.amplitude)
        if design.name.endswith("as large as fits"):
            assert budget > 1.05 * BUDGET
        else:
            assert budget == pytest.approx(BUDGET, rel=CODE_CELLS), design.name


def test_the_best_ring_is_at_least_as_good_as_the_disc(camera: dasim.Camera) -> None:
    def free(cells: int, budget: float) -> FreeStop:
        return free_stop.free_stop(camera, np.array([5.0, 20.0]), cells, budget=budget, fine_cells=24)

    ring = designs.best_ring(free, 32, BUDGET)
    disc, stop = masks.disc(32, BUDGET), free(32, BUDGET)
    assert free_stop.value(stop, ring.amplitude) <= free_stop.value(stop, disc)
