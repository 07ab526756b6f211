"""Scrambled Sobol' points: stratified in each dimension and in pairs, and different for each pixel."""

from __future__ import annotations

import numpy as np
import pytest

COUNT = 64


@pytest.fixture(scope="module")
def points(jit):
    """All dimensions of one pixel's samples, [COUNT, DIMENSIONS]."""
    import drjit as dr
    import mitsuba as mi

    from dasim.render.sobol import DIMENSIONS, Sobol, points

    def points_of(key: int) -> np.ndarray:
        numbers = Sobol(points(COUNT), dr.arange(mi.UInt32, COUNT), mi.UInt32(key))
        return np.stack([np.array(numbers.next_1d(), dtype=np.float64) for _ in range(DIMENSIONS)], axis=-1)

    return points_of


@pytest.mark.parametrize("key", [0, 1, 12345])
def test_every_dimension_has_one_point_in_each_stratum(points, key):
    """Expectation: of 64 points exactly one in each 64th of the interval (Owen's scrambling keeps a net a net)."""
    for dimension in points(key).T:
        np.testing.assert_array_equal(np.sort(np.floor(dimension * COUNT)), np.arange(COUNT))


def test_the_first_two_dimensions_are_a_net(points):
    """Expectation: a (0, 6, 2)-net in base 2: each of the 64 boxes of any shape 2^-a x 2^-(6 - a) has one point."""
    first, second = points(7)[:, :2].T
    for along in range(7):
        box = np.floor(first * 2**along) * 2 ** (6 - along) + np.floor(second * 2 ** (6 - along))
        assert len(np.unique(box)) == COUNT, along


def test_pixels_have_points_of_their_own(points):
    """Expectation: two pixels' points are independent: means of squared differences are 1/6 within 5 deviations."""
    squared = (points(1) - points(2)) ** 2
    assert squared.mean() == pytest.approx(1 / 6, abs=5 * np.sqrt(7 / 180 / squared.size))
