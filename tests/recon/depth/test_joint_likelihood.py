"""The joint likelihood, on spectra that are drawn from the model."""

from __future__ import annotations

import numpy as np

from recon.depth.cross_spectra import Spectra
from recon.depth.joint_likelihood import NU, log_likelihood

BANDS, LEVELS, WINDOWS = 8, 12, 100


def table():
    """Transfers that fall with level and band, the second channel's at half the rate, [level, band, 2, 2]."""
    band, level = np.arange(1, BANDS + 1) / BANDS, np.arange(LEVELS)[:, None]
    first, second = np.exp(-((0.5 * level * band) ** 2)), np.exp(-((0.25 * level * band) ** 2))
    one = np.stack([first, second], axis=-1)
    return one[..., :, None] * one[..., None, :] / band[None, :, None, None] ** 2


def drawn(true, noise, seed=0, coherence=0.9, colour=0.0, number=60):
    """Spectra of windows whose plane has a level; ``colour`` is the scatter of the logarithm of each band's power."""
    random = np.random.default_rng(seed)
    sigma = np.array([[1.0, coherence * 0.7], [coherence * 0.7, 0.49]])
    power = np.exp(colour * random.standard_normal((WINDOWS, BANDS)))
    model = power[..., None, None] * sigma * table()[true] + noise * np.eye(2)
    root = np.linalg.cholesky(model)
    values = np.einsum("wbij,wbnj->wbni", root, random.standard_normal((WINDOWS, BANDS, number, 2)))
    matrix = np.einsum("wbni,wbnj->wbij", values, values) / number
    pairs = np.stack([matrix[..., 0, 0], matrix[..., 0, 1], matrix[..., 1, 1]], axis=-1)[:, None]
    expected = np.broadcast_to(np.float32([noise, 0, noise]), pairs.shape)
    return Spectra(pairs.astype(np.float32), expected, np.full(BANDS, number, np.float32))


def test_the_level_of_the_model_is_found():
    """Expectation: the median of the best levels is the true one, and most are within one level."""
    for true in (1, 3, 6):
        best = log_likelihood(drawn(true, 0.02), table())[:, 0].argmax(axis=-1)
        assert abs(np.median(best) - true) <= 0.5, true
        assert (np.abs(best - true) <= 1).mean() > 0.8, true


def test_a_texture_of_another_spectrum_does_not_read_as_blur():
    """Rationale: smooth prints have little power in fine bands, as blur has.

    Set-up: the power of each band is scattered by a factor of 4. Expectation: the true level, still.
    """
    best = log_likelihood(drawn(3, 0.02, colour=1.4), table())[:, 0].argmax(axis=-1)
    assert abs(np.median(best) - 3) <= 1


def test_bands_below_the_noise_do_not_read_as_blur():
    """Rationale: the power of a band says something of that of its neighbours. If each band were free by itself, bands
    that noise hides would fit any level, and blur would be the cheapest way to have no power there.

    Set-up: a noise that hides the upper bands of green and all but the lowest of infrared. Expectation: the mean of the
    best levels is within 0.8 levels of the true one; with bands that are free by themselves it is 1.4 to 1.8 too large.
    """
    for true in (1, 2, 3):
        best = log_likelihood(drawn(true, 3.0), table())[:, 0].argmax(axis=-1)
        assert abs(best.mean() - true) < 0.8, true


def test_noise_alone_says_little():
    """Expectation: where the texture is a hundredth of the noise, no level is preferred by much."""
    weak, strong = (log_likelihood(drawn(3, noise), table())[:, 0] for noise in (300.0, 0.02))
    spread = [np.median(np.ptp(score, axis=-1)) for score in (weak, strong)]
    assert spread[0] < 0.25 * spread[1]


def test_a_band_that_no_level_explains_counts_little():
    """Rationale: an edge between two depths disturbs some bands. Set-up: a band with three times the energy in one
    channel. Expectation: the true level, and oftener than with the Gaussian law.
    """
    spectra = drawn(3, 0.02)
    energy = spectra.energy.copy()
    energy[..., 5, 0] *= 3
    robust, gaussian = (
        (log_likelihood(spectra._replace(energy=energy), table(), nu=nu)[:, 0].argmax(axis=-1) == 3).mean()
        for nu in (NU, 1e9)
    )
    assert robust > max(0.98, gaussian)
