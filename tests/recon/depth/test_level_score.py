"""The score of one level, on full-resolution pictures and near focus."""

import numpy as np
import pytest
from scipy import signal

from dasim.spectra.grid import CHANNELS
from recon.depth import peak, scores
from recon.depth.channels import Channel
from recon.settings import PRESETS
from tests.recon.depth.test_scores import grey
from tests.support import recon_scenes

NOISE = 0.02  # of full scale
BORDER_PX = 45
NEAR_FOCUS_LEVELS = 0.5  # the NCC of a deblurred infrared is off by one to two levels there
AWAY_LEVELS = 0.3  # bias on one small patch of texture; the claim staircase holds the mean of many to 0.2


def strips(level, noise, seed=0):
    """Infrared and green of a grey texture at a level, sampled at every pixel instead of on a mosaic."""
    kernels = recon_scenes.bank().kernel[0]
    sharp = grey(160 + 74, 192 + 74, seed)
    random = np.random.default_rng(seed)
    channels = []
    for name in ("IR", "G"):
        kernel = kernels[:, CHANNELS.index(name)]
        blurred = signal.fftconvolve(sharp, kernel[level].astype(float), mode="valid")
        plane = (blurred + noise * random.standard_normal(blurred.shape)).astype(np.float32)
        channels.append(Channel(plane, (0, 0), np.full(plane.shape, noise**2, np.float32), kernel))
    return channels


def estimate(level, settings, noise=NOISE):
    infrared, green = strips(level, noise)
    score = scores.match(infrared, green, settings, 1.0)
    levels, _ = peak.best_level(score.score, score.ncc, score.offset, settings.window_px)
    inner = slice(BORDER_PX, -BORDER_PX)
    return levels[inner, inner]


def test_full_resolution_pictures_in_focus_are_not_biased_to_larger_levels():
    """In focus infrared is the blurrier channel, and the likelihood accounts for the noise
    that deblurring amplifies.
    """
    assert estimate(0, PRESETS["likelihood"]).mean() < NEAR_FOCUS_LEVELS


@pytest.mark.parametrize("preset", ["paper", "likelihood"])
@pytest.mark.parametrize("level", [4, 14])
def test_full_resolution_pictures_have_no_bias(preset, level):
    assert abs(estimate(level, PRESETS[preset]).mean() - level) < AWAY_LEVELS


def test_the_likelihood_beats_the_colour_line_near_focus():
    ours, prior = (np.abs(estimate(1, PRESETS[p]) - 1).mean() for p in ("likelihood", "chakrabarti-zickler"))
    assert ours < prior
