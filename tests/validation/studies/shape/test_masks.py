"""Shapes on a grid of cells: light budget, smallest feature, smoothing."""

from __future__ import annotations

import numpy as np
import pytest

import dasim
from validation.studies.shape import masks, published_codes


@pytest.mark.parametrize("share", [0.05, 0.2116, 0.6])
def test_shapes_have_their_light_budget(share: float) -> None:
    """To a fraction of one row of cells along the rim, with 128 cells across."""
    rim = 2 * np.pi * (2 / 128) / np.pi
    assert masks.budget(masks.disc(128, share)) == pytest.approx(share, abs=rim / 4)
    assert masks.budget(masks.annulus(128, share, 0.3)) == pytest.approx(share, abs=rim / 2)
    code = published_codes.zhou_nayar()
    code_budget = min(share, code.mean() * 2 / np.pi)
    assert masks.budget(masks.square(code, 128, share)) == pytest.approx(code_budget, rel=0.08)  # 13 cells on 128


def test_a_ring_that_does_not_fit_is_refused() -> None:
    with pytest.raises(dasim.InputError, match="outside the lens"):
        masks.annulus(64, 0.5, 0.9)


@pytest.mark.parametrize("width", [3, 5, 8])
def test_the_smallest_feature_of_stripes_is_their_width(width: int) -> None:
    rows = (np.arange(64) // width) % 2
    mask = np.where(masks.inside(64), rows[:, None] * np.ones(64), 0.0)
    assert masks.smallest_feature(mask) == width


def test_smoothing_removes_specks_and_holes_smaller_than_the_feature() -> None:
    mask = masks.disc(64, 0.2) > 0.5
    speck, hole = mask.copy(), mask.copy()
    speck[8:10, 30:32] = True
    hole[31:33, 31:33] = False
    whole = masks.inside(64)
    for wrong in (speck, hole):
        np.testing.assert_array_equal(masks.smoothed(wrong, 5, whole), masks.smoothed(mask, 5, whole))


def test_overlaps_of_intervals_are_their_common_lengths() -> None:
    expected = [[0.5, 0.0], [0.5, 0.5], [0.0, 1.0]]  # of 0..1, 1..2 and 2..3 with 0.5..1.5 and 1.5..3.5
    np.testing.assert_allclose(masks.overlap(np.arange(4.0), np.array([0.5, 1.5, 3.5])), expected)
