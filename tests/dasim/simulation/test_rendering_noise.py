"""The variance of a mean of pictures, from pairs of known noise."""

from __future__ import annotations

import tracemalloc

import numpy as np
import pytest
from scipy import ndimage

from dasim.simulation import rendering_noise
from dasim.simulation.rendering_noise import (
    PERCENTILES,
    WEIGHTS,
    Picture,
    add,
    mean_and_left,
    measured,
    no_pairs,
    of_sum,
    rates,
    share,
    shared_uncertainty,
    shares_at,
)

SHAPE = (2, 120, 160, 3)  # 19,200 pixels: the mean of their squares is known to 1 %
KNOWN = 0.03


def pair(random, sd, spp):
    """Two pictures of light 10, whose noise falls as samples ** -0.5; ``sd`` is that of one sample, by stop."""
    sd = np.asarray(sd)[:, None, None, None]
    rates = [10 + sd / np.sqrt(n) * random.standard_normal(SHAPE) for n in spp]
    return tuple(picture(n, rate) for n, rate in zip(spp, rates, strict=True))


def picture(spp, rate, variate=None):
    return Picture(np.full((SHAPE[0], 1, 1), spp), rate, np.zeros(SHAPE) if variate is None else variate)


def summed(pairs):
    sums = no_pairs(pairs[0][0])
    for first, second in pairs:
        add(sums, first, second)
    return sums


@pytest.mark.parametrize("spp", [[(32, 32)], [(3, 2)], [(16, 16), (40, 40), (64, 32)]])
def test_the_variance_is_that_of_the_mean(spp):
    """Expectation: the squared error of the mean, known here, and 1 / samples by stop; sums over stops add."""
    random = np.random.default_rng(5)
    found = measured(summed([pair(random, (1.0, 2.0), counts) for counts in spp]))
    total = sum(map(sum, spp))
    np.testing.assert_array_equal(found.spp.ravel(), (total, total))
    np.testing.assert_allclose(found.variance.mean(axis=(1, 2)).T, np.tile([1 / total, 4 / total], (3, 1)), rtol=KNOWN)
    np.testing.assert_allclose(np.mean((found.rate.sum(axis=0) - 20) ** 2, axis=(0, 1)), 5 / total, rtol=KNOWN)


def test_the_map_follows_the_noise_from_place_to_place():
    """Set-up: the right half has three times the noise. Expectation: variances 1 : 9, with a border of 2 px between."""
    random = np.random.default_rng(6)
    even = pair(random, (1.0, 1.0), (8, 8))
    scale = np.where(np.arange(SHAPE[2]) < 80, 1.0, 3.0)[:, None]
    found = measured(summed([tuple(picture(8, 10 + scale * (each.rate - 10)) for each in even)]))
    left, right = (found.variance[:, :, part].mean() for part in (slice(0, 78), slice(82, None)))
    assert right / left == pytest.approx(9.0, rel=KNOWN)
    assert found.variance[:, :, :78].std() / left == pytest.approx(np.sqrt(2 / 18.2), rel=0.15), "degrees of freedom"


def test_the_noise_of_a_line_fades_with_the_distance():
    """Set-up: one column has noise, as at the edge of an object. Expectation: its variance is stated within 2 px of it,
    and at that distance at less than half of what is stated in the column.
    """
    even = pair(np.random.default_rng(11), (1.0, 1.0), (8, 8))
    scale = np.where(np.arange(SHAPE[2]) == 80, 1.0, 0.0)[:, None]
    found = measured(summed([tuple(picture(8, 10 + scale * (each.rate - 10)) for each in even)])).variance
    here, there, beyond = (found[:, :, 80 + distance].mean() for distance in (0, 2, 3))
    assert there < 0.5 * here and beyond == 0


def test_a_ratio_of_sums_has_no_bias():
    """Rationale: a ratio of sums over n samples is off by c / n, which a picture of few samples would show.

    Set-up: ratios of the sums of w z and of w over 8 and over 4 samples; w has the mean 1 and a standard deviation of
    0.5, and z = 1 + 0.4 (w - 1). Expectation: the mean of w z, which is 1.1; the mean of the ratios is off by ten times
    as much.
    """
    random = np.random.default_rng(9)
    parts = []
    for spp in (8, 4):
        w = random.gamma(4.0, 0.25, (spp, *SHAPE))
        rate = (w * (1 + 0.4 * (w - 1))).mean(axis=0) / w.mean(axis=0)
        parts.append(Picture(np.full((SHAPE[0], 1, 1), spp), rate, np.zeros(SHAPE), w.mean(axis=0).astype(np.float32)))
    plain = sum(part.spp[..., None] * part.rate for part in parts) / 12
    assert plain.mean() - 1.1 < -30 * plain.std() / np.sqrt(plain.size)
    assert abs(measured(summed([tuple(parts)])).rate.mean() - 1.1) < 0.1 * abs(plain.mean() - 1.1)


def test_the_variate_takes_out_what_it_shares_with_the_picture():
    """Set-up: noise of 1 beside noise of 3 that the variate repeats with the factor 1.25. Expectation: what is left is
    the noise of 1, and its stated variance; the mean stays 10.
    """
    random = np.random.default_rng(7)

    def one():
        shared = 3 * random.standard_normal(SHAPE)
        return picture(1, 10 + random.standard_normal(SHAPE) + shared, 1.25 * shared)

    found = measured(summed([(one(), one())]))
    expected = 0.5 * (1 + 1 / 23)  # the factor comes from 24 pixels, each of one degree of freedom
    assert found.variance.mean() == pytest.approx(expected, rel=KNOWN)
    assert np.mean((found.rate - 10) ** 2) == pytest.approx(expected, rel=KNOWN)
    assert found.rate.mean() == pytest.approx(10.0, abs=4 * np.sqrt(0.5 / found.rate.size))


def test_a_pair_is_measured_in_little_memory():
    """Rationale: the pictures of a frame of 3 Mpx take 100 MB per stop and array.

    Expectation: beside the two results, some twenty intermediate arrays of a strip in double precision, whatever the
    height of the frame.
    """
    random, shape = np.random.default_rng(8), (2, 8 * rendering_noise.STRIP_ROWS, 40, 3)
    two = [Picture(np.full((2, 1, 1), 2), *random.standard_normal((2, *shape)).astype(np.float32)) for _ in range(2)]
    tracemalloc.start()
    rate, left = mean_and_left(*two)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < rate.nbytes + left.nbytes + 24 * 8 * rendering_noise.STRIP_ROWS * shape[2]


def test_strips_do_not_show(monkeypatch):
    """Expectation: strips of a few rows give what the whole frame gives, at their edges and at the frame's; a pair's
    mean and variance are those of ``measured``.
    """
    random = np.random.default_rng(9)
    two = [picture(2, 10 + random.standard_normal(SHAPE), random.standard_normal(SHAPE)) for _ in range(2)]
    results = []
    for rows in (10 * SHAPE[1], 7):
        monkeypatch.setattr(rendering_noise, "STRIP_ROWS", rows)
        sums = summed([tuple(two)])
        results.append([*measured(sums)[:3], *mean_and_left(*two)])
        np.testing.assert_array_equal(rates(sums), results[-1][0])
    for whole, of_strips in zip(*results, strict=True):
        np.testing.assert_allclose(of_strips, whole, rtol=1e-5, atol=1e-6)
    rate, left = results[0][3:]
    squares = left.astype(float) ** 2
    variance = ndimage.correlate1d(ndimage.correlate1d(squares, WEIGHTS, axis=1), WEIGHTS, axis=2)
    np.testing.assert_allclose(rate, results[0][0], rtol=1e-6)
    np.testing.assert_allclose(variance, results[0][1], rtol=1e-5)


def test_shares_are_percentiles_of_standard_deviations():
    """Expectation: rendering variance 1..100 % of the sensor's; no noise at all where neither has any."""
    variance = np.linspace(0, 1, 201).reshape(1, 201, 1)
    ratio = share(variance, np.ones_like(variance))
    np.testing.assert_allclose(shares_at(ratio)[:, 0], np.sqrt(np.array(PERCENTILES) / 100))
    assert not share(variance * 0, variance * 0).any()


def test_a_picture_without_light_says_nothing():
    """Set-up: a pixel of two pictures, of which one has rays of weight 0 alone, as happens with two samples.

    Expectation: the ratio of the other, which was one and a half times as much.
    """
    shape = (1, 1, 1, 1)

    def of(rate, light):
        return Picture(np.full((1, 1, 1), 1), np.full(shape, rate), np.zeros(shape), np.full(shape, light, np.float32))

    rate, _ = mean_and_left(of(0.0, 0.0), of(8.0, 1.2))
    assert rate[0, 0, 0, 0] == pytest.approx(8.0)


@pytest.mark.parametrize("shared_sd", [0.0, 0.5])
def test_noise_that_all_first_and_all_second_pictures_share_is_stated(shared_sd):
    """Rationale: samples do not reduce the noise of an irradiance that every second picture has, nor do more pairs.

    Set-up: four pairs, whose pixels have noise of their own (standard deviation 1 per picture and stop), and all first
    and all second pictures the same smooth noise through both stops together.
    Expectation: the variance of the mean, known here; the part that neighbours share, within its uncertainty.
    """
    random = np.random.default_rng(8)

    def smooth():
        coarse = random.standard_normal((1, SHAPE[1] // 10, SHAPE[2] // 10, 1))
        return shared_sd * np.repeat(np.repeat(coarse, 10, axis=1), 10, axis=2) * np.ones(SHAPE) / SHAPE[0]

    fields = smooth(), smooth()
    pairs = [tuple(picture(8, 10 + random.standard_normal(SHAPE) + field) for field in fields) for _ in range(4)]
    sums = summed(pairs)
    error = measured(sums).rate.sum(axis=0) - 20
    variance, shared = of_sum(sums)
    assert variance.mean() == pytest.approx((error**2).mean(), rel=0.06)
    wanted = np.mean((fields[0].sum(axis=0) + fields[1].sum(axis=0)) ** 2) / 4
    own = SHAPE[0] / 8  # variance of the mean by noise of the pixels
    assert shared.mean() == pytest.approx(wanted, abs=4 * shared_uncertainty(SHAPE[1:3]) * own + 0.35 * wanted)
