"""Levels of pixels from those of blocks: steps at the picture's edges, and everything else by linear interpolation."""

from __future__ import annotations

import numpy as np
import pytest

from recon.depth.upsampling import Levels, interpolated, take_sides

BLOCKS = (20, 30)
SHAPE = (40, 60)
STEP = 15  # first block column of the second surface


def picture(edge: float, noise: float = 0.02) -> tuple[np.ndarray, np.ndarray]:
    """Colours and infrared in electrons of two surfaces, the second from the pixel column ``edge`` on, with noise."""
    rng = np.random.default_rng(1)
    image = 200.0 + 150.0 * (np.arange(SHAPE[1]) >= edge)[None, :, None] + np.zeros((*SHAPE, 4))
    image = (image * rng.normal(1, noise, image.shape)).astype(np.float32)
    return image[..., :3], np.ascontiguousarray(image[..., 3])


def levels(low: float, high: float) -> Levels:
    """Blocks of two surfaces, the second more certain than the first."""
    is_second = np.broadcast_to(np.arange(BLOCKS[1]) >= STEP, BLOCKS)
    return Levels(*(np.where(is_second, b, a).astype(np.float32) for a, b in ((low, high), (0.5, 0.9))))


@pytest.mark.parametrize(("low", "high"), [(2.0, 6.0), (6.0, 2.0), (-4.0, 1.0)])
@pytest.mark.parametrize("edge", [2 * STEP - 1, 2 * STEP, 2 * STEP + 1])
def test_steps_are_at_the_edges_of_the_picture(low: float, high: float, edge: int):
    """Set-up: two surfaces whose step in the blocks is up to a pixel beside the picture's edge. Expectation: every
    pixel that is not beside the edge of a block that sees both has the level and the confidence of its own surface;
    interpolation has levels between them.
    """
    blocks = levels(low, high)
    pixels = interpolated(blocks, SHAPE)
    between = (pixels.level > min(low, high) + 0.1) & (pixels.level < max(low, high) - 0.1)
    assert between.any(axis=1).all()
    take_sides(pixels, blocks, *picture(edge))
    is_second = np.broadcast_to(np.arange(SHAPE[1]) >= edge, SHAPE)
    found = np.abs(pixels.level - np.where(is_second, high, low)) < 1e-4
    if edge % 2:
        found = np.delete(found, [edge - 1, edge], axis=1)
    assert found.mean() > 0.998
    np.testing.assert_allclose(pixels.confidence, np.where(np.abs(pixels.level - high) < 1e-4, 0.9, 0.5), atol=1e-4)


def test_slopes_are_interpolated():
    """Set-up: a slanted surface, under a picture with an edge. Expectation: the interpolated levels, unchanged."""
    row, column = np.indices(BLOCKS, np.float32)
    blocks = Levels(3 + 0.1 * row + 0.2 * column, np.full(BLOCKS, 0.7, np.float32))
    pixels = interpolated(blocks, SHAPE)
    expected = Levels(*(image.copy() for image in pixels))
    take_sides(pixels, blocks, *picture(2 * STEP))
    np.testing.assert_array_equal(pixels, expected)


def test_the_nearest_side_is_taken_where_nothing_is_alike():
    """Set-up: a step in a dark picture without light. Expectation: no level between those of both surfaces, and the
    step within a pixel of that of the blocks.
    """
    blocks = levels(2.0, 6.0)
    pixels = interpolated(blocks, SHAPE)
    take_sides(pixels, blocks, np.zeros((*SHAPE, 3), np.float32), np.zeros(SHAPE, np.float32))
    assert set(np.unique(pixels.level.round(4))) == {2.0, 6.0}
    first = np.argmax(pixels.level > 4, axis=1)
    assert np.abs(first - 2 * STEP).max() <= 1
