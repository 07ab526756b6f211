"""Random rooms: nearer surfaces cover farther ones, and levels stay in range."""

from __future__ import annotations

import numpy as np
import pytest

from validation.training import rooms
from validation.training.rooms import FAMILIES, FINE, room


@pytest.mark.parametrize("family", FAMILIES)
def test_a_room_has_light_and_a_level_everywhere(family):
    for seed in range(4):
        made = room(np.random.default_rng(seed), 40, 60, 12.0, FAMILIES[family])
        assert made.radiance.shape == (4, FINE * 40, FINE * 60)
        assert (made.radiance > 0).all()
        assert made.level.min() >= 0
        assert made.level.max() < 20


def test_a_seed_gives_the_same_room():
    first, second = (room(np.random.default_rng(7), 30, 40, 6.0, FAMILIES["textured"]) for _ in range(2))
    np.testing.assert_array_equal(first.radiance, second.radiance)
    assert not np.array_equal(first.level, room(np.random.default_rng(8), 30, 40, 6.0, FAMILIES["textured"]).level)


def test_a_floor_comes_nearer_towards_the_bottom():
    floor = rooms._floor(np.random.default_rng(2), (80, 120), 1.0, 20.0)
    column = floor.level[:, 60][floor.mask[:, 60]]
    assert (np.diff(column) > 0).all()
    assert column[0] < 2 < column[-1]
