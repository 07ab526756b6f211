"""Depth discontinuities of the blocks move to edges of the all-in-focus picture."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

import recon
from recon.depth.method import METHODS
from recon.depth.peak import sd_of
from recon.depth.steps import aligned
from recon.depth.upsampling import Levels
from tests.support import recon_scenes

BLOCKS = (40, 60)
EDGE = 31  # first block column of the second surface


def picture(noise: float = 0.02) -> tuple[np.ndarray, np.ndarray]:
    """Colours and infrared in electrons of two surfaces, the second twice as bright."""
    is_second = np.arange(2 * BLOCKS[1]) >= 2 * EDGE
    image = 200.0 * (1 + is_second)[None, :, None] * np.ones((2 * BLOCKS[0], 1, 4))
    image = (image * np.random.default_rng(1).normal(1, noise, image.shape)).astype(np.float32)
    return image[..., :3], np.ascontiguousarray(image[..., 3])


def ramp(low: float, high: float, middle: float, width: float = 10.0) -> Levels:
    x = np.arange(BLOCKS[1], dtype=np.float32)
    share = np.clip(0.5 + (x - middle) / width, 0, 1)
    level = np.broadcast_to(low + (high - low) * share, BLOCKS).astype(np.float32)
    return Levels(level, np.full(BLOCKS, 0.8, np.float32))


@pytest.mark.parametrize(("low", "high"), [(2.0, 8.0), (8.0, 2.0), (-5.0, 3.0), (-2.0, -8.0)])
def test_a_blurred_step_moves_to_the_edge(low, high):
    """Set-up: a ramp over 10 blocks, 2.5 beside the edge. Expectation: in the blocks between ramp and edge the level of
    their own surface, and a standard deviation that holds what the level changed; far from the edge, both stay.
    """
    blocks = ramp(low, high, EDGE + 2.0)
    found = aligned(blocks, *picture())
    inner = (slice(8, -8), slice(EDGE - 4, EDGE + 4))
    is_second = np.broadcast_to(np.arange(BLOCKS[1]) >= EDGE, BLOCKS)
    before, after = (np.abs(of.level - np.where(is_second, high, low))[inner].mean() for of in (blocks, found))
    assert after < 0.4 * before
    change, sd = np.abs(found.level - blocks.level), sd_of(found.confidence)
    assert change.max() > 2
    assert (sd >= 0.999 * change).all()
    np.testing.assert_allclose(found.level[:, :10], low, atol=0.05)
    np.testing.assert_allclose(found.confidence[:, :10], 0.8, atol=1e-3)


def test_blocks_without_any_confidence_keep_their_levels():
    """Expectation: no weighted median, only the sharpening of ramps of a few blocks, by a block."""
    blocks = ramp(2.0, 8.0, EDGE + 2.0)._replace(confidence=np.zeros(BLOCKS, np.float32))
    found = aligned(blocks, *picture())
    assert np.abs(found.level - blocks.level).max() < 1.01 * np.diff(blocks.level, axis=1).max()
    assert (found.confidence == 0).all()


def test_a_method_asks_for_it():
    """Set-up: a map that changes gradually from one textured board to another. Expectation: with ``align_steps`` the
    step between the boards is steeper than without, and all-in-focus pictures are the same.
    """
    level = np.full((128, 192), 2.0)
    level[:, 96:] = 10.0
    scene = recon_scenes.make(level, white_e=3000)
    share = np.clip(0.5 + (np.arange(192) - 95.5) / 40, 0, 1)
    blurred = np.broadcast_to(2 + 8 * share, level.shape)
    estimate = recon.DepthEstimate(level=blurred, sd=np.full(level.shape, 0.5), joined=True)
    results = [
        recon.reconstruct(
            scene.capture,
            recon_scenes.bank(),
            method=lambda capture, bank, steps=steps: dataclasses.replace(estimate, align_steps=steps),
        )
        for steps in (False, True)
    ]
    jumps = [np.abs(np.diff(of.level, axis=1)).max(axis=1).mean() for of in results]
    assert jumps[1] > 3 * jumps[0]
    np.testing.assert_array_equal(results[0].sharp_e, results[1].sharp_e)


@pytest.mark.parametrize(("name", "wanted"), [("best", True), ("fast", False), ("bands", False)])
def test_of_the_bundled_methods_the_default_asks_for_it(name, wanted):
    scene = recon_scenes.make(np.full((64, 96), 3.0), white_e=3000)
    assert METHODS[name](scene.capture, recon_scenes.bank()).align_steps is wanted
