"""Boards on which designs are scored, and statistics of their scores."""

from __future__ import annotations

import numpy as np

import dasim
from dasim.camera import geometry
from validation.studies.shape import boards


def test_ratios_are_paired_by_exposure() -> None:
    assert boards.ratio((1.0, 2.0, 3.0), (2.0, 4.0, 6.0)) == (0.5, 0.0)
    mean, spread = boards.ratio((1.0,), (2.0,))
    assert mean == 0.5
    assert np.isnan(spread)


def test_boards_stand_at_their_levels_under_one_light(camera: dasim.Camera) -> None:
    lit = list(boards.lit_boards(camera))
    assert len(lit) == len(boards.LEVELS)
    for scene, cropped in lit:
        assert (cropped.sensor.width_px, cropped.sensor.height_px) == boards.BOARD_PX
        assert {light.illuminant for light in scene.lights} == {boards.LIGHT}
    blurs = geometry.level_blur_px(camera)[list(boards.LEVELS)]
    np.testing.assert_allclose(blurs[[0, -1]], [9, 43], atol=0.6)  # as the module says


def test_the_inner_part_is_textured_and_far_from_the_border() -> None:
    textured = np.ones((200, 300), bool)
    textured[100] = False
    mask = boards.inner(textured)
    assert mask.sum() == (200 - 2 * boards.BORDER_PX - 1) * (300 - 2 * boards.BORDER_PX)
    assert not mask[boards.BORDER_PX - 1].any()
    assert not mask[100].any()
