"""The mask search: the projection and its adjoint, light budgets, features, and what a search gains."""

from __future__ import annotations

import numpy as np
import pytest

import dasim
from validation.studies.shape import free_stop, masks, search
from validation.studies.shape.search import Search

CELLS, BUDGET = 20, 0.2116
BLURS = np.array([5.0, 20.0, 40.0])
GRADIENT_TOLERANCE = 1e-3  # relative; central differences of 1e-5 reach 1e-6


@pytest.mark.parametrize("symmetry", ["none", "half-turn"])
@pytest.mark.parametrize("beta", [2.0, 16.0])
def test_the_projection_keeps_the_budget_and_its_gradient(symmetry: str, beta: float) -> None:
    task = Search(CELLS, BUDGET, 3.0, symmetry=symmetry)  # type: ignore[arg-type]
    random = np.random.default_rng(7)
    latent = random.uniform(0, 1, (CELLS, CELLS)) * masks.inside(CELLS)
    weight, direction = random.normal(size=(2, CELLS, CELLS))
    direction *= masks.inside(CELLS)
    amplitude, back = search.projected(latent, task, beta)
    assert masks.budget(amplitude) == pytest.approx(BUDGET, rel=1e-9)
    if symmetry == "half-turn":
        np.testing.assert_allclose(amplitude, amplitude[::-1, ::-1], atol=1e-12)
    ends = [(search.projected(latent + sign * 1e-5 * direction, task, beta)[0] * weight).sum() for sign in (1, -1)]
    assert (back(weight) * direction).sum() == pytest.approx((ends[0] - ends[1]) / 2e-5, rel=GRADIENT_TOLERANCE)


@pytest.mark.parametrize("diameter", [3, 5])
def test_thresholded_masks_have_their_budget_and_no_smaller_feature(diameter: int) -> None:
    task = Search(48, BUDGET, diameter)
    for seed in (3, 4):
        mask = search.thresholded(search.filtered(search.start(task, seed), task), task)
        assert set(np.unique(mask)) == {0.0, 1.0}
        assert masks.budget(mask) == pytest.approx(BUDGET, abs=0.02)  # one level may open or close a whole part
        assert masks.smallest_feature(mask) >= diameter


def test_a_search_finds_more_depth_than_the_disc_with_the_same_light(camera: dasim.Camera) -> None:
    """Two windows far apart measure depth like a stereo pair: at least 20 % less error."""
    stop = free_stop.free_stop(camera, BLURS, 24, budget=BUDGET, fine_cells=32)
    design = search.optimised(stop, Search(24, BUDGET, 3.0, symmetry="half-turn", iterations=8), seed=1)
    disc = masks.disc(24, BUDGET)
    assert objective(camera, design.amplitude) < 0.8 * objective(camera, disc)
    np.testing.assert_array_equal(design.amplitude, design.amplitude[::-1, ::-1])
    assert design.history[-1] < design.history[0]


def objective(camera: dasim.Camera, mask: np.ndarray) -> float:
    return free_stop.value(free_stop.free_stop(camera, BLURS, len(mask), budget=masks.budget(mask)), mask)


def test_seeds_are_repeatable(camera: dasim.Camera) -> None:
    stop = free_stop.free_stop(camera, BLURS, CELLS, budget=BUDGET, fine_cells=32)
    task = Search(CELLS, BUDGET, 2.0, iterations=2)
    first, again = (search.optimised(stop, task, 3) for _ in range(2))
    np.testing.assert_array_equal(first.amplitude, again.amplitude)
