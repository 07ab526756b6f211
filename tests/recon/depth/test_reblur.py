"""Ways to compare two channels: whole pictures as a case of planes, near focus, and the closed forms behind them."""

import numpy as np
import pytest
from scipy import signal

from dasim.spectra.grid import CHANNELS
from recon.depth import reblur, scores
from recon.settings import PRESETS
from tests.recon.depth.test_scores import grey
from tests.support import recon_scenes

NOISE = 0.02  # of full scale
BORDER_PX = 45
NEAR_FOCUS_LEVELS = 0.5  # the NCC of a deblurred infrared is off by one to two levels there
AWAY_LEVELS = 0.3  # bias on one small patch of texture; the claim staircase holds the mean of many to 0.2


def strips(level, noise, seed=0):
    """Infrared and green of a grey texture at a level, samples one pixel apart, no mosaic."""
    kernels = recon_scenes.bank().kernel[0]
    sharp = grey(160 + 74, 192 + 74, seed)
    random = np.random.default_rng(seed)
    channels = []
    for name in ("IR", "G"):
        own = kernels[:, CHANNELS.index(name)]
        blurred = signal.fftconvolve(sharp, own[level].astype(float), mode="valid")
        plane = (blurred + noise * random.standard_normal(blurred.shape)).astype(np.float32)
        channels.append((plane, (0, 0), np.full(plane.shape, noise**2, np.float32), own))
    return channels


def estimate(level, settings, noise=NOISE):
    infrared, green = strips(level, noise)
    found = scores.match(infrared, green, settings, 1.0)
    levels, _ = scores.best_level(found.score, found.plain, found.offset, settings)
    inner = slice(BORDER_PX, -BORDER_PX)
    return levels[inner, inner]


def test_whole_pictures_at_focus_are_not_drawn_to_larger_levels():
    """Infrared is the blurrier channel there: the likelihood knows what deblurring does to its noise."""
    assert estimate(0, PRESETS["likelihood"]).mean() < NEAR_FOCUS_LEVELS


@pytest.mark.parametrize("preset", ["paper", "likelihood"])
@pytest.mark.parametrize("level", [4, 14])
def test_whole_pictures_have_no_bias(preset, level):
    assert abs(estimate(level, PRESETS[preset]).mean() - level) < AWAY_LEVELS


def test_the_likelihood_beats_the_colour_line_near_focus():
    ours, prior = (np.abs(estimate(1, PRESETS[p]) - 1).mean() for p in ("likelihood", "chakrabarti-zickler"))
    assert ours < prior


def test_the_four_derivatives_are_those_of_a_turned_grid():
    """Both diagonals together hold the energy of x and y together, at every frequency; the published pair does not."""
    shape = (32, 48)
    right = reblur.directional(shape, PRESETS["chakrabarti-zickler"])
    power = [np.abs(f) ** 2 for f in right]
    np.testing.assert_allclose(power[0] + power[1], power[2] + power[3], atol=1e-5)
    published = PRESETS["chakrabarti-zickler"].model_copy(update={"diagonals": "published"})
    wrong = [np.abs(f) ** 2 for f in reblur.directional(shape, published)]
    assert np.abs(wrong[0] + wrong[1] - wrong[2] - wrong[3]).max() > 0.1


def test_green_given_infrared_varies_as_a_gaussian_pair_says():
    """Schur complement of the covariance of two noisy views of one texture, at a random frequency each."""
    random = np.random.default_rng(3)
    infrared, green = (random.uniform(0.05, 1, (8, 5)).astype(np.complex64) for _ in range(2))
    gradient = random.uniform(0.1, 4, (8, 5)).astype(np.float32)
    weights = reblur.Weights(0.3, 0.2)
    texture = 1 / gradient
    across = texture * infrared.real * green.real / weights.green
    own = texture * infrared.real**2 + weights.sharper
    expected = 1 + texture * green.real**2 / weights.green - across**2 * weights.green / own
    found = reblur.whitening(infrared, green, weights, gradient)
    np.testing.assert_allclose(found, expected, rtol=1e-4)
