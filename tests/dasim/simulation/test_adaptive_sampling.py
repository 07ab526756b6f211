"""Adaptive sampling reaches its noise target, on pictures of known noise."""

from __future__ import annotations

import numpy as np

from dasim.simulation import adaptive_sampling
from dasim.simulation.adaptive_sampling import StopPictures, render_to_noise_target

STOPS = 2
SHAPE = (STOPS, 60, 80, 4)
MEAN_E = np.array([400.0, 900.0, 100.0, 50.0])
MEDIAN = 0.1  # relative; the median of 4,800 absolute differences is known to 2 %, a pair's worth to 3 %


def pictures(coefficients, calls, slope=0.75):
    """Pictures of half the light a stop, with noise of ``coefficients`` x samples ** -slope of it in every channel."""

    def picture(index, spp):
        calls.append((index, spp))
        noise = np.random.default_rng((index, *spp)).standard_normal(SHAPE)
        spread = np.multiply(coefficients, np.power(spp, -slope))
        return StopPictures(MEAN_E / STOPS * (1 + spread[:, None, None, None] * noise), field=index)

    return picture


def poisson(rate):
    """Variance of photon noise."""
    return np.maximum(rate, 0)


def test_the_noise_target_is_met_and_the_stated_noise_is_true():
    """Rationale: what meta.json says of the noise must be the noise of the picture that is kept.

    Expectation: below the share that was asked for; the error of the result, known here, is what is stated.
    """
    calls: list = []
    result = render_to_noise_target(pictures((1.0, 0.5), calls), poisson, stops=STOPS)
    assert max(result.share) <= adaptive_sampling.NOISE_SHARE
    assert result.spp == tuple(np.sum([spp for _, spp in calls], axis=0))
    assert result.spp[0] > result.spp[1], "the stop that gives more of the noise gets more samples"
    assert len({index for index, _ in calls}) == len(calls), "every picture has random numbers of its own"
    truth = np.median(np.abs(result.rate - MEAN_E) / np.sqrt(MEAN_E), axis=(0, 1)) / 0.6745
    np.testing.assert_allclose(result.share, truth, rtol=MEDIAN)


def test_the_percentile_decides_which_pixels_count():
    """Set-up: a tenth of the pixels has five times the noise. Expectation: at the median they do not matter, at the
    percentile 95 the share of theirs is met, for more samples; the error of the result, known here, agrees.
    """
    loud = np.zeros(SHAPE[1:3], bool)
    loud[:, :8] = True

    def picture(index, spp):
        noise = np.random.default_rng((index, *spp)).standard_normal(SHAPE) * np.where(loud, 5.0, 1.0)[..., None]
        return StopPictures(MEAN_E / STOPS * (1 + np.power(spp, -0.75)[:, None, None, None] * noise))

    median, high = (render_to_noise_target(picture, poisson, stops=STOPS, percentile=at) for at in (50.0, 95.0))
    assert max(high.share) <= adaptive_sampling.NOISE_SHARE and min(high.spp) > 2 * max(median.spp)
    error = np.abs(high.rate - MEAN_E) / np.sqrt(MEAN_E)
    assert 0.5 * max(high.share) < np.median(error[loud], axis=0).max() / 0.6745 <= adaptive_sampling.NOISE_SHARE
    error = np.abs(median.rate - MEAN_E) / np.sqrt(MEAN_E)
    assert np.median(error[loud], axis=0).max() / 0.6745 > adaptive_sampling.NOISE_SHARE


def test_a_quiet_scene_takes_the_first_pair_alone():
    calls: list = []
    result = render_to_noise_target(pictures((0.01, 0.01), calls), poisson, stops=STOPS)
    pilot = (adaptive_sampling.PILOT_SPP,) * STOPS
    assert calls == [(0, pilot), (1, pilot)] and result.spp == (2 * adaptive_sampling.PILOT_SPP,) * STOPS


def test_a_smaller_share_takes_more_samples():
    """Expectation: half the noise takes two to three times the samples; powers of two blur that."""
    noisy = pictures((2.0, 2.0), [])
    counts = [sum(render_to_noise_target(noisy, poisson, stops=STOPS, target=share).spp) for share in (0.4, 0.2, 0.1)]
    assert counts[0] < counts[1] < counts[2]


def test_the_most_samples_end_it():
    result = render_to_noise_target(pictures((50.0, 50.0), []), poisson, stops=STOPS, most_spp=500)
    assert max(result.spp) <= 500 and max(result.share) > adaptive_sampling.NOISE_SHARE


def test_no_light_and_no_noise_need_no_more():
    result = render_to_noise_target(lambda index, spp: StopPictures(np.zeros(SHAPE)), poisson, stops=STOPS)
    assert result.share == (0, 0, 0, 0) and result.spp == (2 * adaptive_sampling.PILOT_SPP,) * STOPS
