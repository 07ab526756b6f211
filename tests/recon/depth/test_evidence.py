"""The inputs of the network of the preset ``best``: shapes, clipped windows, levels that the bank lacks."""

from __future__ import annotations

import numpy as np
import pytest

import recon
from recon.depth import evidence, raw_levels, surface_net
from recon.picture import mosaic
from tests.support import recon_scenes

LEVELS = evidence.level_grid(28)
COUNT = len(LEVELS)


def found_of(level, last=None, clipped=None):
    """Evidence of a capture of known levels, with the bank's first ``last + 1`` levels."""
    scene = recon_scenes.make(level, white_e=3000)
    bank = recon_scenes.bank()
    raw_e, saturated = mosaic.linearise(scene.capture)
    if clipped is not None:
        saturated = saturated.copy()
        saturated[clipped] = True
    index = bank.lights.index("D65")
    kernels = bank.kernel[index][: None if last is None else last + 1]
    variances = raw_levels.variances(raw_e, scene.capture)
    frame = raw_levels.Frame(raw_e, variances, saturated, scene.capture.camera, kernels, bank.signature[index])
    return raw_levels.joint_evidence(frame, recon.PRESETS["best"])


@pytest.fixture(scope="module")
def board():
    return found_of(np.full((150, 198), 6.0))


def test_levels_are_as_many_for_every_bank_and_reach_its_last():
    assert all(len(evidence.level_grid(last)) == COUNT for last in (5, 28, 60))
    assert evidence.level_grid(60)[-1] == pytest.approx(60)
    assert evidence.level_grid(5)[-1] == pytest.approx(evidence.LAST)
    steps = np.diff(LEVELS)
    assert steps[0] == pytest.approx(evidence.FINEST, rel=0.15)  # the grid is stretched to end at its last level


def test_a_frame_has_a_node_per_block_also_at_its_end(board):
    """Set-up: planes of 75 x 99 samples, no multiples of a block."""
    inputs = evidence.SCORES * COUNT + evidence.FITS + evidence.SIGNALS + 1
    assert board.inputs.shape == (19, 25, inputs)
    assert board.picture.shape == (76, 100, 4)
    assert np.isfinite(board.inputs).all() and np.isfinite(board.picture).all()


def test_every_score_is_largest_near_the_level_of_a_board(board):
    """Expectation: of each of the four scores, the median of the windows' best levels is within 1 level of 6."""
    middle = board.inputs[5:-5, 5:-5, : evidence.SCORES * COUNT]
    for score in np.split(middle, evidence.SCORES, axis=-1):
        assert np.median(LEVELS[score.argmax(axis=-1)]) == pytest.approx(6, abs=1)


def test_windows_of_two_depths_fit_worse(board):
    """Set-up: stripes of 12 samples at levels 1 and 14 beside a board at level 6. Expectation: the best level
    explains the board's windows of both sizes better, by 0.1 in the median: 0.36 against 0.56, and 0.55 against 0.90.
    """
    stripes = found_of(np.where(np.arange(198) // 12 % 2 == 0, 1.0, 14.0) * np.ones((150, 1)))
    first = evidence.SCORES * COUNT
    for size in range(evidence.FITS):
        one, two = (found.inputs[5:-5, 5:-5, first + size] for found in (board, stripes))
        assert np.median(one) > np.median(two) + 0.1


@pytest.mark.parametrize("level", [5.0, 12.0])
def test_the_network_is_less_sure_without_the_scores(level):
    """Set-up: a board in noise, with its scores and without. Expectation: twice the standard deviation, and more."""
    found = found_of(np.full((150, 198), level))
    known = surface_net.posterior(found.inputs, found.picture, LEVELS, 28)
    inputs = found.inputs.copy()
    inputs[..., : evidence.SCORES * COUNT] = 0
    unknown = surface_net.posterior(inputs, found.picture, LEVELS, 28)
    assert np.median(known.level) == pytest.approx(level, abs=0.5)
    assert np.median(unknown.sd) > 2 * np.median(known.sd)


def test_the_network_expects_floors_at_the_bottom():
    """Set-up: evidence of a board in focus, weakened to a tenth. Expectation: nearer in the lowest row than above."""
    found = found_of(np.zeros((150, 198)))
    inputs = found.inputs.copy()
    inputs[..., : evidence.SCORES * COUNT] *= 0.1
    level = surface_net.posterior(inputs, found.picture, LEVELS, 28).level
    assert level[-10:].mean() > level[:-20].mean()


def test_levels_beyond_the_bank_are_excluded():
    """Set-up: a bank of levels 0 to 12. Expectation: larger ones have no posterior; scores fall steadily from the last
    level on, within what the network has seen.
    """
    found = found_of(np.full((150, 198), 6.0), last=12)
    beyond = found.levels > 12
    scores = found.inputs[..., : evidence.SCORES * COUNT].reshape(*found.inputs.shape[:2], evidence.SCORES, COUNT)
    assert beyond.any()
    below = evidence.SCORE_UNIT * np.expm1(-scores[..., :-1, :].astype(np.float64))
    falls = np.diff(below, axis=-1)[..., int(np.flatnonzero(beyond)[0]) - 1 :]
    np.testing.assert_allclose(falls, evidence.FALL, rtol=1e-3)
    assert (np.exp(scores[..., -1, beyond]) < 0.02).all()


def test_a_short_bank_does_not_blind_the_network():
    """Rationale: the network has learned from banks of all levels; levels that a bank does not have, given as
    impossible, made it read 2.5 where every window said 6.

    Set-up: a textured board at level 6, banks of levels 0 to 7 and 0 to 28. Expectation: both medians within half a
    level.
    """
    for last in (7, 28):
        found = found_of(np.full((150, 198), 6.0), last=last)
        level = surface_net.posterior(found.inputs, found.picture, found.levels, last).level
        assert np.median(level) == pytest.approx(6, abs=0.5), last


def test_clipped_windows_say_nothing():
    """Set-up: a quarter of the frame is clipped. Expectation: there, the windows' scores are equal for all levels."""
    found = found_of(np.full((150, 198), 6.0), clipped=(slice(0, 75), slice(0, 99)))
    windows = found.inputs[..., : 3 * COUNT].reshape(*found.inputs.shape[:2], 3, COUNT)
    assert (np.ptp(windows[:6, :8], axis=-1) == 0).all()
    assert (np.ptp(windows[14:, 20:], axis=-1) > 0).all()


def test_the_picture_reaches_to_the_end_of_the_last_nodes():
    """Set-up: 12 x 10 samples, no multiple of a node's. Expectation: the last columns repeat the frame's."""
    image = np.random.default_rng(0).normal(size=(2, 12, 10)).astype(np.float32)
    nodes = evidence.cross_spectra.nodes((12, 10), evidence.NODE)
    whole = evidence._whole(image, nodes)
    np.testing.assert_array_equal(whole[:, :10], image.transpose(1, 2, 0))
    np.testing.assert_array_equal(whole[:, 10:], np.repeat(whole[:, 9:10], 2, axis=1))
