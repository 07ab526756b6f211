"""The variance in the likelihood, compared with the covariance of a pair of Gaussian variables."""

import numpy as np

from recon.depth import likelihood, ncc


def test_conditional_variance_is_the_schur_complement():
    """The variance is the Schur complement of the covariance of two noisy views of one texture,
    at random frequencies.
    """
    random = np.random.default_rng(3)
    infrared, green = (random.uniform(0.05, 1, (8, 5)).astype(np.complex64) for _ in range(2))
    gradient = random.uniform(0.1, 4, (8, 5)).astype(np.float32)
    weights = ncc.Weights(0.3, 0.2)
    texture = 1 / gradient
    across = texture * infrared.real * green.real / weights.green
    variance = texture * infrared.real**2 + weights.sharper
    expected = 1 + texture * green.real**2 / weights.green - across**2 * weights.green / variance
    whitening = likelihood.whitening(infrared, green, weights, gradient)
    np.testing.assert_allclose(whitening, expected, rtol=1e-4)
