"""Edges of maps of levels: steps worked out by hand, and symmetries."""

from __future__ import annotations

import math

import numpy as np
import pytest

from validation.scores.depth_edges import FEWEST_PX, TOLERANCE_PX, edge_score, edges

SIZE = (120, 80)
ALL = np.ones(SIZE, bool)
MIDDLE = SIZE[1] // 2


def step(column, near=6.0, far=2.0):
    return np.broadcast_to(np.where(np.arange(SIZE[1]) < column, near, far), SIZE)


def test_a_step_marks_the_pixels_on_both_sides():
    marked = edges(step(MIDDLE), ALL)
    assert np.flatnonzero(marked.all(axis=0)).tolist() == [MIDDLE - 1, MIDDLE] and marked.sum() == 2 * SIZE[0]


@pytest.mark.parametrize(
    ("near", "far", "expected"),
    [(1.9, 1.0, False), (2.1, 1.0, True), (20, 18.5, False), (20, 17.5, True), (9, 7.9, True)],
)
def test_a_jump_is_a_level_or_a_tenth(near, far, expected):
    assert edges(step(MIDDLE, near, far), ALL).any() == expected


def test_a_slope_is_no_edge():
    assert not edges(np.broadcast_to(0.45 * np.arange(SIZE[1]), SIZE), ALL).any()


@pytest.mark.parametrize(
    ("shift", "share"),
    [(0, 1.0), (3, 1.0), (-3, 1.0), (4, 0.5), (5, 0.0)],
)
def test_a_shifted_edge(shift, share):
    """Expectation: edges of 2 px, so that at a shift of 4 px one of two columns is 3 px away, and at 5 px none."""
    score = edge_score(step(MIDDLE + shift), step(MIDDLE), ALL)
    assert score == pytest.approx((share, share, share)) and TOLERANCE_PX == 3


def test_precision_and_recall_by_hand():
    """Set-up: a false edge of the same length beside the true one; or half of the true one."""
    false = step(MIDDLE) + 3.0 * (np.arange(SIZE[1]) >= 60)
    assert edge_score(false, step(MIDDLE), ALL) == pytest.approx((0.5, 1.0, 2 / 3))
    half = np.where(np.arange(SIZE[0])[:, None] < SIZE[0] // 2, step(MIDDLE), step(SIZE[1]))
    score = edge_score(half, step(MIDDLE), ALL)
    assert 0.5 < score.recall < 0.55, "and 3 px beyond"
    score = edge_score(step(MIDDLE), half, ALL)  # which has a horizontal edge that the step lacks
    assert score.precision < 0.55 and score.recall < 0.8


def test_a_map_without_edges_scores_nothing():
    score = edge_score(np.full(SIZE, 4.0), step(MIDDLE), ALL)
    assert math.isnan(score.precision) and score.recall == 0 and score.f_score == 0


def test_without_true_edges_there_is_nothing_to_judge():
    assert np.isnan(edge_score(step(MIDDLE), np.full(SIZE, 4.0), ALL)).all()
    dot = np.full(SIZE, 4.0)
    dot[50, 50] = 9
    assert 0 < edges(dot, ALL).sum() < FEWEST_PX and math.isnan(edge_score(dot, dot, ALL).f_score)


def test_pixels_elsewhere_do_not_count():
    """Set-up: what lies right of the step is behind the focus. Expectation: neither the step nor anything there."""
    where = np.broadcast_to(np.arange(SIZE[1]) < MIDDLE, SIZE)
    noise = np.where(where, 2.0, np.random.default_rng(0).uniform(0, 20, SIZE))
    assert not edges(noise, where).any() and not edges(np.where(where, 2.0, np.nan), where).any()


def test_orientation_does_not_matter():
    random = np.random.default_rng(1)
    estimate, exact = (np.kron(random.uniform(0, 9, (6, 4)), np.ones((20, 20))) for _ in range(2))
    first = edge_score(estimate, exact, ALL)
    assert 0 < first.f_score < 1
    for turned in (lambda a: a[::-1], lambda a: a[:, ::-1], lambda a: a.T):
        assert edge_score(turned(estimate), turned(exact), turned(ALL)) == pytest.approx(first)
