"""Adaptive sampling reaches its noise target, on pictures of known noise; what the control variate does to a mean."""

from __future__ import annotations

import numpy as np
import pytest

from dasim.simulation import adaptive_sampling
from dasim.simulation.adaptive_sampling import allotted_spp, render_to_noise_target
from dasim.simulation.rendering_noise import Picture, add, measured, no_pairs, rates

FRAME = (2, 60, 80)
SHAPE = (*FRAME, 4)
FEW = np.full(FRAME, 8)
MEAN_E = np.array([400.0, 900.0, 100.0, 50.0])
MEDIAN = 0.1  # relative; the median of 4,800 absolute differences is known to 2 %, a pair's worth to 3 %


def pictures(coefficients, calls, slope=0.65, loud=None, louder=5.0):
    """Pictures of half the light per stop, with noise of ``coefficients`` x samples ** -slope of it in every channel,
    and ``louder`` times that in some pixels.
    """
    factor = np.ones(FRAME[1:]) if loud is None else np.where(loud, louder, 1.0)

    def picture(index, spp, finer=1):
        calls.append((index, spp, finer))
        noise = np.random.default_rng(index).standard_normal(SHAPE) * factor[..., None]
        spread = np.array(coefficients)[:, None, None] * np.maximum(spp, 1e-9) ** -slope
        rate = np.where(spp[..., None] > 0, MEAN_E / 2 * (1 + spread[..., None] * noise), 0.0)
        return Picture(spp, rate, np.zeros(SHAPE))

    return picture


def by_stop(picture):
    """Pictures of all stops, made once, a stop at a time."""
    made = {}

    def of_stop(number, index, spp, finer):
        whole = made[index] = made[index] if index in made else picture(index, spp, finer)
        return Picture(*(part[[number]] for part in whole[:3]))

    return of_stop


def poisson(rate):
    """Variance of photon noise."""
    return np.maximum(rate, 0)


def error_of(result):
    """Error of the mean over the standard deviation of photon noise, [h, w, channel]."""
    return np.abs(rates(result.sums).sum(axis=0) - MEAN_E) / np.sqrt(MEAN_E) / 0.6745


def test_the_noise_target_is_met_and_the_stated_noise_is_true():
    """Rationale: what meta.json says of the noise must be the noise of the picture that is kept.

    Expectation: below the share that was asked for; the error of the result, known here, is what is stated.
    """
    calls: list = []
    result = render_to_noise_target(by_stop(pictures((2.0, 1.0), calls)), poisson, FEW)
    assert max(result.share) <= adaptive_sampling.NOISE_SHARE
    finest = max(finer for *_, finer in calls)
    np.testing.assert_array_equal(result.sums.spp, np.sum([spp for _, spp, finer in calls if finer == finest], axis=0))
    mean = result.sums.spp.mean(axis=(1, 2))
    assert mean[0] > mean[1], "the stop that gives more of the noise gets more samples"
    assert len({index for index, *_ in calls}) == len(calls), "every picture has random numbers of its own"
    np.testing.assert_allclose(result.share, np.median(error_of(result), axis=(0, 1)), rtol=MEDIAN)


def test_a_target_that_the_pilot_misses_is_met_with_few_more():
    """Set-up: noise that falls more slowly than the pilot expects: its variance as the inverse of the samples.

    Expectation: after two pilots, of a coarse and of a finer irradiance, and a pair, one more brings the share to the
    target, and not below nine tenths of it.
    """
    calls: list = []
    result = render_to_noise_target(by_stop(pictures((1.0, 1.0), calls, slope=0.5)), poisson, FEW)
    assert len(calls) == 8
    assert 0.9 < max(result.share) / adaptive_sampling.NOISE_SHARE <= 1.0


def test_noisy_pixels_get_the_samples():
    """Set-up: a tenth of the pixels has five times the noise.

    Expectation: at the percentile 95 their share is met, with more samples there than elsewhere; at the median they get
    no more than a few times as many, and miss it.
    """
    loud = np.zeros(FRAME[1:], bool)
    loud[:, :8] = True
    noisy = pictures((0.3, 0.3), [], loud=loud)
    high, median = (render_to_noise_target(by_stop(noisy), poisson, FEW, percentile=at) for at in (95.0, 50.0))
    assert max(high.share) <= adaptive_sampling.NOISE_SHARE
    spp = high.sums.spp[0]
    assert spp[:, :6].mean() > 5 * spp[:, 12:].mean()
    assert np.median(error_of(high)[loud], axis=0).max() <= adaptive_sampling.NOISE_SHARE
    assert np.median(error_of(median)[loud], axis=0).max() > adaptive_sampling.NOISE_SHARE
    assert median.sums.spp.mean() < high.sums.spp.mean()


def test_choosing_samples_by_the_noise_leaves_no_bias():
    """Rationale: a pixel whose own bright outlier brought it more samples would weight that outlier less.

    Set-up: noise with a long tail, many frames. Expectation: the mean of all is that of the light within its scatter.
    """

    def frame_of(frame):
        def picture(index, spp, finer=1):
            random = np.random.default_rng((index, frame))
            noise = random.exponential(1.0, SHAPE) ** 2 / 2 - 1  # of mean 0
            rate = MEAN_E / 2 * (1 + 0.2 * noise * np.maximum(spp, 1e-9)[..., None] ** -0.5)
            return Picture(spp, np.where(spp[..., None] > 0, rate, 0.0), np.zeros(SHAPE))

        return picture

    means = []
    for frame in range(12):
        result = render_to_noise_target(by_stop(frame_of(frame)), poisson, FEW, percentile=95)
        assert len(np.unique(result.sums.spp)) > 2
        means.append(rates(result.sums).sum(axis=0).mean(axis=(0, 1)) / MEAN_E)
    z = (np.mean(means, axis=0) - 1) / (np.std(means, axis=0, ddof=1) / np.sqrt(12))
    assert np.abs(z).max() < 4.5


def test_the_factor_of_the_variate_lowers_the_noise_and_leaves_the_mean():
    """Set-up: noise of a tail with a variate that follows it by 0.8, another that has nothing to do with it.

    Expectation: the first takes out nearly all noise, the second adds at most a twentieth; no mean moves.
    """
    random = np.random.default_rng(4)
    spp = np.full((2, 1, 1), 8)
    for follows, low, high in ((1.0, 0.0, 0.15), (0.0, 0.9, 1.05)):
        noise = random.exponential(1.0, (2, *SHAPE)) - 1
        other = random.exponential(1.0, (2, *SHAPE)) - 1
        variate = 1.25 * (follows * noise + (1 - follows) * other) + 0.05 * other
        two = [Picture(spp, 5 + noise[k], variate[k]) for k in range(2)]
        sums = no_pairs(two[0])
        add(sums, *two)
        result = measured(sums)
        spread = (result.rate - 5).std() / np.sqrt(0.5)
        assert low <= spread < high
        assert abs(result.rate.mean() - 5) < 5 * max(spread, 0.05) / np.sqrt(result.rate.size)
        assert np.sqrt(result.variance.mean()) == pytest.approx((result.rate - 5).std(), rel=0.05)


def test_a_quiet_scene_takes_the_first_pair_alone():
    calls: list = []
    result = render_to_noise_target(by_stop(pictures((0.01, 0.01), calls)), poisson, FEW)
    assert [index for index, *_ in calls] == [0, 1] and set(result.sums.spp.ravel()) == {16}


def test_every_picture_has_the_fewest_samples_of_each_pixel():
    """Rationale: pixels that see several depths are biased by few samples; the others take fewer.

    Set-up: half of the frame needs 8 samples, half of it 4, with the noise of one sample alike.

    Expectation: the pilot takes these; further pictures take as many, or more, or none; the target is met with fewer
    samples than if all pixels needed 8, and with 4 where 4 are enough.
    """
    fewest = np.where(np.arange(FRAME[2]) < 40, 8, 4) * np.ones(FRAME, int)
    for size, quiet in ((0.35, False), (0.04, True)):
        calls: list = []
        noisy = pictures((size, size), calls, slope=0.5)
        mixed, equal = (render_to_noise_target(by_stop(noisy), poisson, few) for few in (fewest, np.full(FRAME, 8)))
        np.testing.assert_array_equal(calls[0][1], fewest)
        for _, spp, _ in calls:
            assert ((spp >= fewest) | (spp == 0)).all()
        assert max(mixed.share) <= adaptive_sampling.NOISE_SHARE
        assert mixed.sums.spp.mean() < equal.sums.spp.mean()
        assert quiet == (len(calls) == 4) and (not quiet or set(mixed.sums.spp[:, :, 40:].ravel()) == {8})


def test_a_smaller_share_takes_more_samples():
    """Expectation: half the noise takes two to three times the samples; powers of two blur that."""
    noisy = pictures((2.0, 2.0), [])
    counts = [
        render_to_noise_target(by_stop(noisy), poisson, FEW, target=share).sums.spp.mean() for share in (0.4, 0.2, 0.1)
    ]
    assert counts[0] < counts[1] < counts[2]


def test_the_most_samples_end_it():
    result = render_to_noise_target(by_stop(pictures((50.0, 50.0), [])), poisson, FEW, most_spp=16)
    assert result.sums.spp.max() <= 16 * 2 * adaptive_sampling.MOST_ROUNDS
    assert max(result.share) > adaptive_sampling.NOISE_SHARE


def test_no_light_and_no_noise_need_no_more():
    def dark(index, spp, finer=1):
        return Picture(spp, np.zeros(SHAPE), np.zeros(SHAPE))

    result = render_to_noise_target(by_stop(dark), poisson, FEW)
    assert result.share == (0, 0, 0, 0) and set(result.sums.spp.ravel()) == {16}


def test_a_further_pair_has_its_samples_where_the_pilot_is_noisy():
    """Set-up: pilots of 8 samples through two stops, of which the first has twice the noise; five times as much in the
    middle of the frame.

    Expectation: as many samples as asked for, and in proportion to the noise of one sample: within the steps of the
    numbers of samples, 2 between the stops and 5 between the places, where both got more than the pilot's.
    """
    loud = np.zeros(FRAME[1:], bool)
    loud[20:40, 20:60] = True
    picture = pictures((2.0, 1.0), [], slope=0.5, loud=loud)
    pilots = []
    for stop in (0, 1):
        pair = [picture(index, np.full(FRAME, 4)) for index in (0, 1)]
        first, second = (Picture(*(part[[stop]] for part in one[:3])) for one in pair)
        pilots.append(no_pairs(first))
        add(pilots[-1], first, second)
    more = allotted_spp(pilots, 24.0)
    assert 2 * more.mean() == pytest.approx(24.0, rel=0.1)
    inner, outer = np.s_[24:36, 24:56], np.s_[:16]
    whole = 8 + 2 * more
    assert whole[0][inner].mean() / whole[0][outer].mean() == pytest.approx(5.0, rel=0.25)
    assert whole[0][inner].mean() / whole[1][inner].mean() == pytest.approx(2.0, rel=0.25)


def test_many_samples_are_asked_for_in_parts(monkeypatch):
    """Set-up: noise that needs many times the pilot's samples and falls faster than the pilot expects.

    Expectation: the target is met with fewer samples than the pilot asks for: about half as many as all at once.
    """
    shares, spp = [], []
    for part in (adaptive_sampling.PART_OF_FAR, 1.0):
        monkeypatch.setattr(adaptive_sampling, "PART_OF_FAR", part)
        calls: list = []
        result = render_to_noise_target(by_stop(pictures((1.0, 1.0), calls, slope=0.65)), poisson, FEW)
        shares.append(max(result.share))
        spp.append(result.sums.spp.mean())
    assert spp[1] > 2 * adaptive_sampling.FAR * FEW.max()
    assert spp[0] < 0.6 * spp[1]
    assert 0.7 * adaptive_sampling.NOISE_SHARE < shares[0] <= adaptive_sampling.NOISE_SHARE


def test_a_pilot_without_noise_asks_for_no_more():
    still = Picture(np.full(FRAME, 4), np.ones(SHAPE), np.zeros(SHAPE))
    pilot = no_pairs(still)
    add(pilot, still, still)
    assert not allotted_spp([pilot._replace(**{name: getattr(pilot, name)[:1] for name in pilot._fields})], 8.0).any()


IRRADIANCE_FRAME = (1, 120, 160)
FEW_OF_IRRADIANCE = np.full(IRRADIANCE_FRAME, 8)


def irradiance_pictures(own, shared, calls):
    """Pictures with noise of ``own`` over the square root of the samples, and of ``shared`` over that of the
    directions, which all pixels around share and every second picture; both over photon noise.
    """
    height, width = IRRADIANCE_FRAME[1:]

    def picture(index, spp, finer):
        calls.append((finer, spp))
        coarse = np.random.default_rng((index % 2, finer)).standard_normal((height // 8, width // 8))
        coarse = np.repeat(np.repeat(coarse, 8, axis=0), 8, axis=1)[None, ..., None]
        noise = np.random.default_rng(index).standard_normal((*IRRADIANCE_FRAME, 4))
        noise *= own / np.sqrt(np.maximum(spp, 1))[..., None]
        rate = MEAN_E + np.sqrt(MEAN_E) * (noise + shared * np.sqrt(2 / finer) * coarse)
        return Picture(spp, rate, np.zeros((*IRRADIANCE_FRAME, 4)))

    return picture


def test_noise_of_the_irradiance_asks_for_more_directions_not_for_samples():
    """Set-up: little noise of samples, and much that all pixels around share, which falls with the directions.

    Expectation: after the pilot, which does not count, pictures of finer irradiance reach the target with few samples;
    what is stated is the error of the mean.
    """
    calls: list = []
    result = render_to_noise_target(by_stop(irradiance_pictures(0.3, 0.6, calls)), poisson, FEW_OF_IRRADIANCE)
    assert [finer for finer, _ in calls[:2]] == [1, 1] and calls[2][0] >= 16
    assert result.sums.spp.max() <= 32
    assert max(result.share) <= 1.1 * adaptive_sampling.NOISE_SHARE
    error = np.sqrt(np.mean((rates(result.sums)[0] - MEAN_E) ** 2 / MEAN_E, axis=(0, 1)))
    np.testing.assert_allclose(result.share, error, rtol=0.3)


def test_many_samples_have_a_finer_irradiance_and_another_pilot():
    """Set-up: nodes of a noisy irradiance seem to disagree, so that rays are traced on: ten times the noise of samples.

    Expectation: the samples are as many as the second pilot asks for, whose irradiance is finer; those of the first do
    not count. Where the noise is little, one pilot is enough.
    """
    calls: list = []
    fine, coarse = irradiance_pictures(1.5, 0.0, calls), irradiance_pictures(15.0, 0.0, calls)
    picture = lambda index, spp, finer: (fine if finer > 1 else coarse)(index, spp, finer)  # noqa: E731
    result = render_to_noise_target(by_stop(picture), poisson, FEW_OF_IRRADIANCE)
    wanted = (1.5 / adaptive_sampling.NOISE_SHARE) ** 2
    assert [finer for finer, _ in calls[:2]] == [1, 1] and len({finer for finer, _ in calls[2:]}) == 1
    assert calls[2][0] > 1 and set(calls[2][1].ravel()) == {8}
    assert result.sums.spp.mean() < 2 * wanted
    assert max(result.share) <= adaptive_sampling.NOISE_SHARE
    calls.clear()
    render_to_noise_target(by_stop(fine), poisson, FEW_OF_IRRADIANCE)
    assert {finer for finer, _ in calls} == {1}


def test_noise_of_the_irradiance_that_the_pilot_could_not_see_is_found_later(monkeypatch):
    """Set-up: so much noise of samples that a pilot of 16 hides what pixels around share; no finer irradiance for that
    many samples alone.

    Expectation: it is seen once the samples are many, and pictures of finer irradiance reach the target; without them,
    no number of samples would.
    """
    monkeypatch.setattr(adaptive_sampling, "RAYS_PER_FINENESS", 1e9)
    calls: list = []
    result = render_to_noise_target(by_stop(irradiance_pictures(20.0, 0.4, calls)), poisson, FEW_OF_IRRADIANCE)
    assert [finer for finer, _ in calls[:4]] == [1, 1, 1, 1] and calls[4][0] >= 8
    assert max(result.share) <= adaptive_sampling.NOISE_SHARE
    fine = np.sum([spp for finer, spp in calls if finer > 1], axis=0)
    np.testing.assert_array_equal(result.sums.spp, fine, "pictures of the coarse irradiance do not count")


def test_pixels_that_have_the_most_samples_do_not_make_others_take_more():
    """Set-up: the noise is meant at the percentile 95, and a quarter of the pixels wants a hundred times the samples
    that pictures may have.

    Expectation: the others get about what they want for the target, not that times the largest factor.
    """
    loud = np.zeros(FRAME[1:], bool)
    loud[:, :20] = True
    calls: list = []
    noisy = pictures((0.3, 0.3), calls, slope=0.5, loud=loud, louder=40.0)
    result = render_to_noise_target(by_stop(noisy), poisson, FEW, percentile=95)
    spp = result.sums.spp[0]
    # Half of the variance each: (0.3 x 900 / 2)^2 / n = 0.25^2 x 900 / 2 in green.
    assert np.median(spp[~loud]) < 2 * (0.3 * 900 / 2 / 0.25) ** 2 / 450
    assert spp[loud].min() >= adaptive_sampling.MOST_SPP
