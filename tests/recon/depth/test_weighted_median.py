"""The weighted median filter: where steps go, and what stays."""

from __future__ import annotations

from unittest import mock

import numpy as np

from recon.depth import weighted_median
from recon.depth.weighted_median import filtered

SHAPE = (60, 80)
EDGE = 40  # column of the picture's edge


def two_surfaces(noise: float = 0.02) -> np.ndarray:
    """A picture of two surfaces that differ by 0.5 in all of four channels, with noise."""
    picture = np.random.default_rng(1).normal(0, noise, (*SHAPE, 4)).astype(np.float32)
    picture[:, EDGE:] += 0.5
    return picture


def ramp(middle: float, width: float = 10.0) -> np.ndarray:
    """Levels 2 and 8 with a ramp between them."""
    x = np.arange(SHAPE[1], dtype=np.float32)
    return np.broadcast_to(np.clip(5 + 6 * (x - middle) / width, 2, 8), SHAPE).astype(np.float32)


def test_a_blurred_step_moves_to_the_edge_of_the_picture():
    """Set-up: a ramp over 10 samples whose middle is 3 beside the edge. Expectation: the levels of both sides, with
    their jump of 6 between two samples at the edge.
    """
    level = filtered(ramp(EDGE + 3), np.full(SHAPE, 0.5, np.float32), two_surfaces())
    inner = level[10:-10]
    assert np.abs(inner[:, : EDGE - 1] - 2).max() < 0.5
    assert np.abs(inner[:, EDGE + 8 :] - 8).max() < 0.5
    assert (np.argmax(np.diff(inner, axis=1), axis=1) == EDGE - 1).all()
    assert np.diff(inner, axis=1).max(axis=1).min() > 2


def test_a_short_ramp_becomes_a_step():
    """Set-up: a ramp over 4 samples, at the edge of the picture. Expectation: no level between those of both sides."""
    level = filtered(ramp(EDGE - 0.5, 4.0), np.full(SHAPE, 0.5, np.float32), two_surfaces())[10:-10, 5:-5]
    is_between = (level > 3) & (level < 7)
    assert is_between.mean() < 0.002


def test_a_plane_stays_a_plane():
    """Set-up: a slanted plane under a picture of noise. Expectation: errors below 0.2 levels, also at the border."""
    y, x = np.indices(SHAPE, np.float32)
    plane = 2 + 0.05 * x + 0.03 * y
    picture = np.random.default_rng(2).normal(0, 0.05, (*SHAPE, 4)).astype(np.float32)
    level = filtered(plane, np.full(SHAPE, 0.5, np.float32), picture)
    assert np.abs(level - plane).max() < 0.2


def test_slopes_keep_most_of_their_ripples_away_from_steps():
    """Set-up: ripples of half a level on a slope, and a step of 6 levels with an edge in the picture. Expectation: from
    twice the reach on, three quarters of the levels' deviation from the filter's are left, and none of it at the step.
    """
    y, x = np.indices(SHAPE, np.float32)
    level = 2 + 0.02 * x + 0.25 * np.sin(y / 3) + 6 * (x >= EDGE)
    sd = np.full(SHAPE, 0.05, np.float32)
    found = filtered(level, sd, two_surfaces())[8:-8]
    whole = _with_share(level, sd, 0.0)[8:-8]
    far = np.abs(np.arange(SHAPE[1]) - EDGE) >= 2 * weighted_median.REACH
    expected = 0.75 * level[8:-8] + 0.25 * whole
    assert np.abs(found - expected)[:, far].max() < 1e-4
    assert np.abs(whole - level[8:-8])[:, far].max() > 0.1
    beside = slice(EDGE - 1, EDGE + 1)
    np.testing.assert_allclose(found[:, beside], whole[:, beside], atol=1e-4)


def _with_share(level: np.ndarray, sd: np.ndarray, share: float) -> np.ndarray:
    with mock.patch.object(weighted_median, "OWN_SHARE", share):
        return filtered(level, sd, two_surfaces())


def test_levels_that_are_known_prevail():
    """Set-up: a square whose level is wrong and known to be unsure, on a surface of one colour. Expectation: it takes
    the level around it, and keeps its own where that is sure.
    """
    level = np.full(SHAPE, 3, np.float32)
    box = (slice(24, 36), slice(34, 46))
    level[box] = 9
    picture = np.zeros((*SHAPE, 4), np.float32)
    picture[box] = 0.5
    unsure, sure = np.full(SHAPE, 0.3, np.float32), np.full(SHAPE, 0.3, np.float32)
    unsure[box] = 30
    np.testing.assert_allclose(filtered(level, sure, picture)[box], 9, atol=0.3)
    np.testing.assert_allclose(filtered(level, unsure, 0.1 * picture)[box], 3, atol=0.3)


def test_a_sample_that_is_like_no_other_keeps_its_level():
    """Set-up: a slanted plane under a picture in which all samples differ by far. Expectation: levels stay, to a bin of
    the histogram.
    """
    y, x = np.indices(SHAPE, np.float32)
    level = 1 + 0.08 * x + 0.03 * y
    picture = np.random.default_rng(4).normal(0, 50, (*SHAPE, 4)).astype(np.float32)
    found = filtered(level, np.full(SHAPE, 0.5, np.float32), picture)
    assert np.isfinite(found).all()
    assert np.abs(found - level).max() < 0.1


def test_of_noise_each_sample_takes_a_level_beside_it():
    """Set-up: levels without any order, likewise. Expectation: every sample has one of the nine levels around it."""
    level = np.random.default_rng(3).uniform(0, 9, SHAPE).astype(np.float32)
    picture = np.random.default_rng(4).normal(0, 50, (*SHAPE, 4)).astype(np.float32)
    found = filtered(level, np.full(SHAPE, 0.5, np.float32), picture)
    padded = np.pad(level, 1, mode="edge")
    beside = [padded[dy : dy + SHAPE[0], dx : dx + SHAPE[1]] for dy in range(3) for dx in range(3)]
    assert np.abs(found - np.stack(beside)).min(axis=0).max() < 0.1


def test_levels_behind_the_focus_are_filtered_as_those_in_front():
    """Set-up: the ramp with the sign changed, and from -4 to 2. Expectation: minus the levels of the ramp, to a bin of
    the histogram, and a jump of 6 at the edge of the picture.
    """
    sd = np.full(SHAPE, 0.5, np.float32)
    behind, across = (filtered(level, sd, two_surfaces()) for level in (-ramp(EDGE + 3), ramp(EDGE + 3) - 6))
    assert np.abs(behind + filtered(ramp(EDGE + 3), sd, two_surfaces())).max() < 0.25
    assert np.abs(across[10:-10, : EDGE - 1] + 4).max() < 0.5
    assert np.abs(across[10:-10, EDGE + 8 :] - 2).max() < 0.5
