"""Which pictures the focal stack has, and that they are those of ``recon.refocus``."""

import numpy as np
import pytest

import recon
from recon.files.reconstruction import displayed
from recon.levels import level_of
from tests.support import viewed
from validation.reports.view import focal_stack as stacks

ROUNDING = 1e-3  # levels, single precision


def test_f_numbers_are_those_of_lenses():
    assert stacks.f_numbers(2.8) == (2.8, 4.0, 5.6, 8.0)
    assert stacks.f_numbers(1.75) == (1.75, 2.0, 2.8, 4.0)
    assert stacks.f_numbers(32.0) == (32.0,)


def test_distances_are_even_in_levels_and_cover_the_scene():
    bank = viewed.example().bank
    level = np.linspace(2, 10, 1000).reshape(20, 50)
    depths = stacks.focus_depths_m(level, bank)
    found = level_of(depths, bank.depth_m)
    assert np.diff(found) == pytest.approx(np.diff(found)[0], abs=ROUNDING)
    assert -stacks.STEP_LEVELS <= np.diff(found)[0] < 0, "near to far, at most one level apart"
    assert found[-1] == pytest.approx(0, abs=ROUNDING), "the focus of the capture"
    assert 9.9 < found[0] <= 10
    assert len(stacks.focus_depths_m(level * 2.5, bank)) == stacks.MOST_SLICES
    assert len(stacks.focus_depths_m(level, bank, 3)) == 3


def test_smaller_apertures_have_fewer_distances():
    """Expectation: steps of blur are no larger than at the lens's own aperture."""
    example = viewed.example()
    plan = stacks.plan(example.result, example.bank)
    counts = [len(depths) for _, depths in plan]
    assert counts == sorted(counts, reverse=True) and counts[-1] < counts[0]
    steps = [-np.diff(level_of(depths, example.bank.depth_m))[0] * plan[0][0] / number for number, depths in plan]
    assert max(steps) <= steps[0] + ROUNDING


def test_pictures_are_those_of_refocus():
    example = viewed.example()
    small = example.result
    seen = []
    slices = stacks.focal_stack(small, example.bank, 2, lambda stage, share: seen.append(share))
    assert [(s.f_number, len([t for t in slices if t.f_number == s.f_number])) for s in slices[::2]] == [
        (2.8, 2), (4.0, 2), (5.6, 2), (8.0, 2),
    ]  # fmt: skip
    one = slices[2]
    again = displayed(recon.refocus(small, example.bank, one.depth_m, one.f_number), small)
    assert np.array_equal(one.picture, again)
    assert seen[-1] == 1.0 and seen == sorted(seen)
