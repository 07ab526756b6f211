"""Planes on a common grid."""

import numpy as np
import pytest
from scipy import ndimage

from recon import fourier
from recon.depth import grid

MEANS = 1e-3  # of windows that end at four standard deviations in slightly different ways


@pytest.mark.parametrize("phase", [(0, 0), (0, 1), (1, 0), (1, 1)])
def test_planes_are_moved_to_the_middle_of_the_blocks(phase):
    """A sinusoid sampled at any phase gives the same values at the blocks' middles, half a pixel in."""
    y, x = np.indices((128, 128), dtype=float)

    def wave(y, x):
        return np.cos(2 * np.pi * (3 * y + 5 * x) / 128).astype(np.float32)

    shape = (64, 64)
    moved = fourier.inverse(grid.transform(wave(y, x)[phase[0] :: 2, phase[1] :: 2], phase, shape), shape)
    np.testing.assert_allclose(moved, wave(y[::2, ::2] + 0.5, x[::2, ::2] + 0.5), atol=1e-4)


def test_gaussian_means_at_some_samples_are_those_of_all():
    """Set-up: a window wider than the frame, and one narrower. Expectation: SciPy's filter, mirrored at the border."""
    images = np.random.default_rng(1).random((2, 40, 56)).astype(np.float32)
    rows, columns = np.array([0, 3, 39]), np.arange(2, 56, 4)
    for sigma in (2.4, 14.0):
        few = grid.gaussian_means(images, sigma, (rows, columns))
        every = grid.gaussian_means(images, sigma)
        for image, at, whole in zip(images, few, every, strict=True):
            expected = ndimage.gaussian_filter(image.astype(np.float64), sigma, mode="reflect", truncate=4.0)
            np.testing.assert_allclose(at, expected[np.ix_(rows, columns)], atol=MEANS)
            np.testing.assert_allclose(whole, expected, atol=MEANS)
