"""Planes on a common grid."""

import numpy as np
import pytest

from recon import fourier
from recon.depth import grid


@pytest.mark.parametrize("phase", [(0, 0), (0, 1), (1, 0), (1, 1)])
def test_planes_are_moved_to_the_middle_of_the_blocks(phase):
    """A sinusoid sampled at any phase gives the same values at the blocks' middles, half a pixel in."""
    y, x = np.indices((128, 128), dtype=float)

    def wave(y, x):
        return np.cos(2 * np.pi * (3 * y + 5 * x) / 128).astype(np.float32)

    shape = (64, 64)
    moved = fourier.inverse(grid.transform(wave(y, x)[phase[0] :: 2, phase[1] :: 2], phase, shape), shape)
    np.testing.assert_allclose(moved, wave(y[::2, ::2] + 0.5, x[::2, ::2] + 0.5), atol=1e-4)
