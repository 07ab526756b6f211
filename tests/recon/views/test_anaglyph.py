"""Stereo pairs: the disparity formula, a displaced plane, occlusion, and the colours of both eyes."""

import numpy as np
import pytest

from dasim.base.errors import InputError
from recon.views import anaglyph

EXACT_PX = 1e-4  # float32 of shifts of some pixels
PLANE_ERROR = 1e-3  # linear interpolation of a linear ramp is exact up to float32


def test_shift_is_that_of_two_parallel_cameras():
    """Shifts are b f / p (1 / z_0 - 1 / z), on both sides of the screen, with the baseline that gives the stated
    largest shift.
    """
    depth = np.array([[0.1, 0.2, 0.4]], np.float32)
    per_dioptre = 12 / (1 / 0.1 - 1 / 0.4)
    np.testing.assert_allclose(
        anaglyph.disparity_px(depth, 12, "in"), per_dioptre * (1 / 0.1 - 1 / depth), atol=EXACT_PX
    )
    np.testing.assert_allclose(
        anaglyph.disparity_px(depth, 12, "out"), per_dioptre * (1 / 0.4 - 1 / depth), atol=EXACT_PX
    )


def test_into_and_out_of_the_screen_lie_on_its_two_sides():
    depth = np.random.default_rng(1).uniform(0.05, 2, (8, 8))
    assert anaglyph.disparity_px(depth, 5, "in").min() == 0 and anaglyph.disparity_px(depth, 5, "out").max() == 0


@pytest.mark.parametrize("where", ["in", "out"])
def test_planes_are_displaced_by_half_the_shift_each(where):
    """Set-up: two planes with a ramp each. Expectation: away from their edge, the eyes see the ramp displaced by plus
    and minus half the shift.
    """
    x = np.arange(96, dtype=np.float32)
    image = np.repeat(x[None, :, None], 4, 0).repeat(3, 2)
    depth = np.where(x < 48, 0.1, 0.4)[None].repeat(4, 0)
    shift = anaglyph.disparity_px(depth, 7, where)
    left, right = anaglyph.pair(image, depth, 7, where)
    for part, at in ((slice(12, 36), 20), (slice(60, 84), 70)):
        np.testing.assert_allclose((left - right)[:, part], shift[0, at], atol=PLANE_ERROR)


def test_near_hides_far_and_gaps_show_the_far_side():
    """Set-up: a near white bar in front of a far black ground. Expectation: the bar keeps its width, no grey appears,
    and gaps show the ground.
    """
    image = np.zeros((3, 64, 3), np.float32)
    image[:, 24:40] = 1
    depth = np.where(image[..., 0] > 0, 0.1, 0.5)
    for eye in anaglyph.pair(image, depth, 8, "out"):
        assert set(np.unique(eye)) == {0.0, 1.0}
        np.testing.assert_array_equal(eye[..., 0].sum(axis=1), 16)


def test_no_shift_leaves_the_picture():
    image = np.random.default_rng(0).random((16, 24, 3)).astype(np.float32)
    for eye in anaglyph.pair(image, np.full((16, 24), 0.3), 9):
        np.testing.assert_array_equal(eye, image)


def test_unknown_depth_is_finite():
    image = np.ones((4, 8, 3), np.float32)
    assert all(np.isfinite(eye).all() for eye in anaglyph.pair(image, np.full((4, 8), np.nan), 4))


def test_red_is_for_the_left_eye():
    left, right = np.full((2, 2, 3), 0.25), np.full((2, 2, 3), 0.75)
    np.testing.assert_array_equal(anaglyph.anaglyph(left, right)[0, 0], [0.25, 0.75, 0.75])
    assert anaglyph.side_by_side(left, right).shape == (2, 4, 3)


def test_what_cannot_be_is_refused():
    with pytest.raises(InputError, match="largest shift of -1"):
        anaglyph.disparity_px(np.ones((2, 2)), -1)


def test_a_few_wrong_depths_leave_the_others_their_shift():
    """Set-up: a ramp in dioptres with half a percent of its pixels at 1 mm. Expectation: the ramp has
    its full shift.
    """
    vergence = np.linspace(2, 10, 4000).reshape(40, 100)
    wrong = vergence.copy()
    wrong.ravel()[::200] = 1000
    right = np.ones(4000, bool)
    right[::200] = False
    shift = anaglyph.disparity_px(1 / wrong, 8, "out").ravel()[right]
    assert shift.min() < -7.8 and np.ptp(shift) > 7.8
    assert anaglyph.disparity_px(1 / wrong, 8, "out").min() >= -8 - EXACT_PX
