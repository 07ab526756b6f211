"""Means over blocks, which claims on the renderer compare pictures by."""

from __future__ import annotations

import numpy as np

from validation.subjects.rendering import block_means


def test_block_means_keep_pictures_and_channels_apart_and_leave_incomplete_blocks_out():
    """Set-up: two pictures of 5 x 7 px and two channels, 1 in one pixel of a whole block each, and 100 beyond."""
    pictures = np.zeros((2, 5, 7, 2))
    pictures[0, 1, 2, 0] = 1  # first row of blocks, second column
    pictures[1, 3, 5, 1] = 1  # second row, third column
    pictures[:, 4:] = pictures[:, :, 6:] = 100
    means = block_means(pictures, 2)
    expected = np.zeros((2, 2, 3, 2))
    expected[0, 0, 1, 0] = expected[1, 1, 2, 1] = 0.25
    np.testing.assert_array_equal(means, expected)
    np.testing.assert_array_equal(block_means(pictures[0], 2), expected[0])
