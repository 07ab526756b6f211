"""The Cramer-Rao bound of blur: against maximum likelihood on simulated patches, exact covariances and closed forms."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import fft, sparse

from dasim.bounds import cramer_rao
from dasim.camera import geometry
from tests.support.transfers import kernel_transfer

SIDE = 31
SHAPE = (SIDE, SIDE)
NARROW = 0.46  # of green's blur
NOISE = (0.02**2, 0.015**2)
GAIN = 0.7
CONTRAST = 0.15
PATCHES = 3200
CHUNK = 400  # of these at a time
BLIND = 1e-4  # of the noise's power: tells nothing, 1e-8 of what a frequency can
MISFIT = 0.05  # of a standard deviation from 3,200 patches, which is good to 1.3 %: four times that
UNBIASED = 4.0  # standard errors of the mean of the patches
EXACT = 1e-9
BOUNDARY = 0.1  # what a patch without periodic borders tells less or more, at a blur of a sixth of its side
HANKEL = 0.01  # of a transfer function: kernels of whole pixels, cut off at the frame's rim


def gaussian(blur, f):
    """Transfer function of a Gaussian of the standard deviation of a disc of diameter ``blur``, c / 4."""
    return np.exp(-2 * (np.pi * blur / 4 * f) ** 2)


def two_channels(blur, shape=SHAPE, spacing=1.0):
    """H and dH/dc of infrared and green, [channel, h, w/2 + 1], by formula."""
    f = np.hypot(np.fft.fftfreq(shape[0], spacing)[:, None], np.fft.rfftfreq(shape[1], spacing)[None])
    transfer = np.stack([gaussian(NARROW * blur, f), gaussian(blur, f)])
    slope = -4 * blur * (np.pi / 4 * f) ** 2 * np.array([NARROW**2, 1])[:, None, None] * transfer
    return transfer, slope


def bound(blur, noise=NOISE, gain=(1.0, GAIN), **options):
    transfer, slope = two_channels(blur)
    power = cramer_rao.natural_power(SHAPE, contrast=CONTRAST)
    return float(cramer_rao.blur_deviation(transfer, slope, power, noise, width=SIDE, gain=gain, **options))


# --- maximum likelihood --------------------------------------------------------------------------


def patches(blur, side, random):
    """Periodograms of noisy pictures in infrared and green, and the real part of their cross-spectrum, each [patch,
    radius].

    Model and texture are round, so that means over the frequencies of one radius hold all information. Frequencies at
    which the texture in infrared is below ``BLIND`` of the noise are left out. Also returned: the radii in cycles/px,
    and the number of frequencies at each.
    """
    shape = (side, side)
    power, transfer = cramer_rao.natural_power(shape, contrast=CONTRAST), two_channels(blur, shape)[0]
    square = np.rint((np.hypot(np.fft.fftfreq(side)[:, None], np.fft.rfftfreq(side)[None]) * side) ** 2).astype(int)
    visible = (power * transfer[0] ** 2 > BLIND * NOISE[0]) & (square > 0)
    squares, ring = np.unique(square[visible], return_inverse=True)
    twice = np.broadcast_to(cramer_rao.multiplicity(side), square.shape)[visible]
    times = np.bincount(ring, twice)
    to_ring = sparse.csr_matrix((twice, (np.arange(ring.size), ring))) / times
    rows = []
    for _ in range(0, PATCHES, CHUNK):
        white = random.standard_normal((3, CHUNK, *shape), np.float32)
        texture, *noises = (fft.rfft2(picture, workers=2)[:, visible].astype(complex) / side for picture in white)
        first, second = (
            g * (np.sqrt(power) * h)[visible] * texture + np.sqrt(n) * noise
            for g, h, n, noise in zip((1.0, GAIN), transfer, NOISE, noises, strict=True)
        )
        cross = (first * np.conj(second)).real
        rows.append([part @ to_ring for part in (np.abs(first) ** 2, np.abs(second) ** 2, cross)])
    return np.concatenate(rows, axis=1), np.sqrt(squares) / side, times


def log_likelihood(theta, data, radius, times):
    """Log likelihood of each patch, [patch], for (blur, ln strength, ln gain) [patch, 3]: two Gaussian channels,
    written out.
    """
    blur, strength, gain = (t[:, None] for t in theta.T)
    side = int(np.rint(1 / radius[0]))
    natural = cramer_rao.natural_power((side, side), contrast=CONTRAST)[0, 1] * radius[0] ** 2 / radius**2
    power = np.exp(strength) * natural
    small, large = gaussian(NARROW * blur, radius), np.exp(gain) * gaussian(blur, radius)
    a, b, c = power * small**2 + NOISE[0], power * large**2 + NOISE[1], power * small * large
    det = a * b - c**2
    return -0.5 * ((np.log(det) + (b * data[0] + a * data[1] - 2 * c * data[2]) / det) @ times)


def most_likely(data, radius, times, start):
    """The maximum for every patch by Newton's method, with the curvature that the patches have on average."""
    step = np.array([0.02, 0.02, 0.005])
    theta = np.tile(start, (PATCHES, 1))

    def shifted(*moves, some=slice(None)):
        moved = theta[some] + sum(sign * step[i] * np.eye(3)[i] for i, sign in moves)
        return log_likelihood(moved, data[:, some], radius, times)

    curvature = np.empty((3, 3))
    for i in range(3):
        for j in range(3):
            signs = [(1, 1, 1), (1, -1, -1), (-1, 1, -1), (-1, -1, 1)]
            total = sum(sign * shifted((i, p), (j, q), some=slice(CHUNK)).mean() for p, q, sign in signs)
            curvature[i, j] = -total / (4 * step[i] * step[j])
    share, reached = np.ones(PATCHES), log_likelihood(theta, data, radius, times)
    for _ in range(7):
        gradient = np.stack([(shifted((i, 1)) - shifted((i, -1))) / (2 * step[i]) for i in range(3)], axis=1)
        move = np.linalg.solve(curvature, gradient.T).T
        likelihood = log_likelihood(theta + share[:, None] * move, data, radius, times)
        better = likelihood >= reached
        theta = np.where(better[:, None], theta + share[:, None] * move, theta)
        reached, share = np.maximum(likelihood, reached), np.where(better, np.minimum(1.5 * share, 1.0), share / 3)
    assert np.abs(move[:, 0]).max() < 0.02 * start[0]  # everywhere at a maximum
    return theta


def spread_over_bound(blur, side):
    """Standard deviation of the most likely blur over the bound, and the mean's error in standard errors."""
    data, radius, times = patches(blur, side, np.random.default_rng(3))
    estimate = most_likely(data, radius, times, np.array([blur, 0.0, np.log(GAIN)]))[:, 0]
    transfer, slope = two_channels(blur, (side, side))
    power = cramer_rao.natural_power((side, side), contrast=CONTRAST)
    least = float(cramer_rao.blur_deviation(transfer, slope, power, NOISE, width=side, gain=(1.0, GAIN)))
    return estimate.std() / least, abs(estimate.mean() - blur) / (estimate.std() / np.sqrt(PATCHES))


@pytest.mark.slow
@pytest.mark.parametrize(("blur", "side"), [(3.0, 31), (6.0, 37), (9.0, 55), (20.0, 121)])
def test_maximum_likelihood_reaches_the_bound(blur, side):
    """Rationale: a bound is of use only if an estimator reaches it.

    Set-up: ``PATCHES`` periodic patches with sides of 31 px or six blurs, whichever is larger, because the bound is
    asymptotic in the number of frequencies that blur leaves, which is proportional to (side / blur)^2. Limit: 5 %.
    """
    ratio, off = spread_over_bound(blur, side)
    assert ratio == pytest.approx(1, abs=MISFIT)
    assert off < UNBIASED  # and no bias to speak of


@pytest.mark.slow
def test_what_is_above_the_bound_in_small_patches_goes_with_their_size():
    """At 9 px of blur, patches of 31 px (3.4 blurs) leave too few frequencies: the error is 4 % above the bound; with
    63 px it is not.

    Measured with 6,400 and 3,200 patches: 4.0 +- 1.0 % with 31 px, -0.9 +- 1.2 % with 63 px. At 20 px of blur, the
    likelihood does not always have a maximum with 31 px; 4.2 +- 1.3 % with 63 px (3.2 blurs), 0.5 +- 2.0 % with 127 px.
    """
    small, large = (spread_over_bound(9.0, side)[0] for side in (31, 63))
    assert 1.0 < small < 1 + 2 * MISFIT
    assert large == pytest.approx(1, abs=MISFIT)
    assert large < small


def test_a_misfit_of_the_kernels_would_show():
    assert abs(bound(3.0) / bound(3.5) - 1) > 2 * MISFIT


def test_the_periodic_patch_approximates_one_cut_from_a_picture():
    """Slepian and Bangs with the covariances between all pixels of a patch cut out of a larger picture."""
    side, blur, large = 20, 3.0, (80, 80)

    def covariance(theta):
        transfer = two_channels(theta[0], large)[0] * np.array([1.0, np.exp(theta[2])])[:, None, None]
        power = np.exp(theta[1]) * cramer_rao.natural_power(large, contrast=CONTRAST)
        power[np.hypot(np.fft.fftfreq(80)[:, None], np.fft.rfftfreq(80)[None]) < 0.5 / side] = 0
        y, x = (part.ravel() for part in np.indices((side, side)))
        rows, columns = (part[:, None] - part[None, :] for part in (y, x))
        blocks = [
            [np.fft.irfft2(power * transfer[i] * transfer[j], large)[rows, columns] for j in (0, 1)] for i in (0, 1)
        ]
        return np.block(blocks) + np.diag(np.repeat(NOISE, side * side))

    theta, step = np.array([blur, 0.0, np.log(GAIN)]), 1e-3
    inverse = np.linalg.inv(covariance(theta))
    parts = [inverse @ (covariance(theta + s) - covariance(theta - s)) / (2 * step) for s in step * np.eye(3)]
    information = np.array([[0.5 * np.sum(a * b.T) for b in parts] for a in parts])
    transfer, slope = two_channels(blur, (side, side))
    power = cramer_rao.natural_power((side, side), contrast=CONTRAST)
    least = cramer_rao.blur_deviation(transfer, slope, power, NOISE, width=side, gain=(1.0, GAIN))
    assert float(least) == pytest.approx(np.sqrt(np.linalg.inv(information)[0, 0]), rel=BOUNDARY)


# --- closed forms and symmetries -----------------------------------------------------------------


def test_one_known_white_texture_by_hand():
    """Power spectrum P known, one channel, no nuisance: I = sum (P d|H|^2/dc / C)^2 / 2 over all frequencies."""
    transfer, slope = (part[1:] for part in two_channels(5.0, (8, 8)))
    power = np.full((8, 5), 0.3)
    whole = np.fft.fftfreq(8)
    f = np.hypot(whole[:, None], whole[None])
    h = gaussian(5.0, f)
    change = 2 * 0.3 * h * (-4 * 5.0 * (np.pi / 4 * f) ** 2 * h)
    expected = 0.5 * np.sum((change / (0.3 * h**2 + 0.01)) ** 2)
    deviation = cramer_rao.blur_deviation(transfer, slope, power, [0.01], width=8, texture="known")
    assert float(deviation) == pytest.approx(expected**-0.5, rel=EXACT)


def test_noise_and_texture_count_by_their_ratio_alone():
    transfer, slope = two_channels(5.0)
    one, four = (
        cramer_rao.blur_deviation(
            transfer, slope, cramer_rao.natural_power(SHAPE, contrast=s * CONTRAST), s**2 * np.array(NOISE), width=SIDE
        )
        for s in (1.0, 2.0)
    )
    assert float(one) == pytest.approx(float(four), rel=EXACT)


def test_strong_noise_counts_with_its_variance():
    """Far above the signal, information falls with the square of the noise variance, so that the deviation is
    proportional to the variance.
    """
    low, high = (bound(5.0, noise=(v, v)) for v in (1e3, 2e3))
    assert high / low == pytest.approx(2.0, rel=1e-3)


def test_more_noise_tells_less():
    bounds = [bound(5.0, noise=tuple(s * n for n in NOISE)) for s in (0.25, 1.0, 4.0)]
    assert bounds[0] < bounds[1] < bounds[2]


def test_deviation_falls_with_the_root_of_the_area():
    assert bound(5.0, area_px=4.0 * SIDE**2) == pytest.approx(bound(5.0) / 2, rel=EXACT)


def test_area_of_a_gaussian_patch():
    """A mean with Gaussian weights has the variance of pi/3 of the box's area."""
    x = np.arange(-100, 101)
    weight = np.exp(-(x**2) / (2 * SIDE**2 / 12))
    weight = np.outer(weight, weight) / weight.sum() ** 2
    assert cramer_rao.window_area_px(SIDE) == pytest.approx(1 / (weight**2).sum(), rel=1e-6)


def test_equal_kernels_tell_nothing_of_a_texture_of_unknown_colour_and_spectrum():
    """Kernels that do not change with blur give an infinite deviation, not a large number."""
    transfer, slope = two_channels(5.0)
    power = cramer_rao.natural_power(SHAPE)
    assert cramer_rao.blur_deviation(transfer, 0 * slope, power, NOISE, width=SIDE) == np.inf


def test_a_change_of_brightness_is_no_blur():
    """Kernels that change by a factor only give an infinite deviation: gain and strength explain the change."""
    transfer, _ = two_channels(5.0)
    slope = transfer * np.array([0.3, -0.2])[:, None, None]
    power = cramer_rao.natural_power(SHAPE)
    assert cramer_rao.blur_deviation(transfer, slope, power, NOISE, width=SIDE) == np.inf
    assert np.isfinite(cramer_rao.blur_deviation(transfer, slope, power, NOISE, width=SIDE, texture="known"))


def test_a_free_spectrum_leaves_the_difference_of_blur_alone():
    """Two channels of equal blur give nearly no information, because power is free in each ring, one frequency wide."""
    power = cramer_rao.natural_power(SHAPE, contrast=CONTRAST)
    same = [np.repeat(part[1:], 2, axis=0) for part in two_channels(5.0)]
    free, spectrum = (
        float(cramer_rao.blur_deviation(*same, power, NOISE, width=SIDE, texture=t)) for t in ("free", "spectrum")
    )
    assert free > 4 * spectrum
    assert free > 4 * bound(5.0, texture="free")
    assert bound(5.0, texture="known") < bound(5.0) < bound(5.0, texture="free") < np.inf


def test_a_free_spectrum_by_hand():
    """Weak noise: green over infrared is T, known to (n_G + T^2 n_I) / |I|^2 at each frequency, the gain unknown."""
    transfer, slope = two_channels(3.0)
    power, noise = cramer_rao.natural_power(SHAPE, contrast=1.0), np.array([1e-7, 1e-7])
    low = np.hypot(np.fft.fftfreq(SIDE)[:, None], np.fft.rfftfreq(SIDE)[None]) < 0.25
    power = power * low
    ratio = transfer[1] / transfer[0]
    change = slope[1] / transfer[0] - ratio * slope[0] / transfer[0]
    weight = power * transfer[0] ** 2 / (noise[1] + ratio**2 * noise[0])
    twice = np.r_[1.0, np.full(SIDE // 2, 2.0)]
    blur, gain, both = ((weight * a * b * twice).sum() for a, b in ((change,) * 2, (ratio,) * 2, (change, ratio)))
    deviation = cramer_rao.blur_deviation(transfer, slope, power, noise, width=SIDE, texture="free")
    # of each ring the power is learnt from both channels, which costs a part in a thousand here
    assert float(deviation) == pytest.approx((blur - both**2 / gain) ** -0.5, rel=0.01)


def test_with_equal_blur_in_both_channels_only_the_texture_informs():
    """Both channels alike and no noise to speak of: the second adds nothing but an average of the noise."""
    transfer, slope = (np.repeat(part[1:], 2, axis=0) for part in two_channels(5.0))
    power = cramer_rao.natural_power(SHAPE, contrast=CONTRAST)
    both = cramer_rao.blur_deviation(transfer, slope, power, [2e-4, 2e-4], width=SIDE, texture="known")
    one = cramer_rao.blur_deviation(transfer[:1], slope[:1], power, [1e-4], width=SIDE, texture="known")
    assert float(both) == pytest.approx(float(one), rel=EXACT)


def test_the_order_of_the_channels_is_no_matter():
    transfer, slope = two_channels(5.0)
    power = cramer_rao.natural_power(SHAPE)
    mine = cramer_rao.blur_deviation(transfer, slope, power, NOISE, width=SIDE, gain=(1.0, GAIN))
    power = power * GAIN**2
    other = cramer_rao.blur_deviation(transfer[::-1], slope[::-1], power, NOISE[::-1], width=SIDE, gain=(1.0, 1 / GAIN))
    assert float(mine) == pytest.approx(float(other), rel=EXACT)


def test_a_third_channel_never_harms():
    transfer, slope = two_channels(5.0)
    third, third_slope = (np.concatenate([part, part[1:]]) for part in (transfer, slope))
    power = cramer_rao.natural_power(SHAPE, contrast=CONTRAST)
    two = cramer_rao.blur_deviation(transfer, slope, power, NOISE, width=SIDE)
    for noise in (1e-4, 1e2):
        three = cramer_rao.blur_deviation(third, third_slope, power, (*NOISE, noise), width=SIDE)
        assert three < two * (1 + EXACT)
    assert float(three) == pytest.approx(float(two), rel=1e-4)  # one that sees nothing


def test_levels_are_computed_together_as_one_by_one():
    stack = [np.stack(parts) for parts in zip(*(two_channels(b) for b in (2.0, 5.0, 9.0)), strict=True)]
    power = cramer_rao.natural_power(SHAPE, contrast=CONTRAST)
    together = cramer_rao.blur_deviation(*stack, power, NOISE, width=SIDE, gain=(1.0, GAIN))
    np.testing.assert_allclose(together, [bound(b) for b in (2.0, 5.0, 9.0)], rtol=EXACT)


# --- spectra and transfer functions --------------------------------------------------------------


@pytest.mark.parametrize("lowest", [0.0625, 0.125, 0.2])
def test_contrast_is_that_of_an_octave(lowest):
    shape = (256, 256)
    f = np.hypot(np.fft.fftfreq(256)[:, None], np.fft.rfftfreq(256)[None])
    power = cramer_rao.natural_power(shape, contrast=0.2) * ((f >= lowest) & (f < 2 * lowest))
    variance = 2 * power[:, 1:-1].sum() + power[:, [0, -1]].sum()
    assert np.sqrt(variance / 256**2) == pytest.approx(0.2, rel=0.01)


def test_power_of_a_picture_is_that_of_its_texture():
    random = np.random.default_rng(0)
    white = cramer_rao.picture_power(0.3 * random.standard_normal((400, 400)), SHAPE)
    assert white[0, 0] == 0
    assert white[2:-2, 2:-2].mean() == pytest.approx(0.09, rel=0.02)


def test_coarser_samples_see_the_same_density():
    fine = cramer_rao.natural_power((32, 32))[:8, :8]
    coarse = cramer_rao.natural_power((16, 16), spacing_px=2.0)[:8, :8]
    np.testing.assert_allclose(coarse, fine / 4, rtol=EXACT)


def test_camera_transfers_are_those_of_its_kernels(da_mobile):
    from dasim.camera import pointspread

    blur = 9.0
    transfer, slope = cramer_rao.camera_transfers(da_mobile, [blur], "D65", SHAPE)
    depth = float(geometry.depth_of_blur_m(da_mobile, blur))
    for index, name in ((1, "G"), (3, "IR")):
        kernel = pointspread.psf(da_mobile, depth, name, "D65", size=45)
        known = kernel_transfer(kernel / kernel.sum(), SHAPE)
        low = np.hypot(np.fft.fftfreq(SIDE)[:, None], np.fft.rfftfreq(SIDE)[None]) < 0.4
        np.testing.assert_allclose((transfer[0, index] - known) * low, 0, atol=HANKEL)
    step = 0.5
    low, high = (cramer_rao.camera_transfers(da_mobile, [blur + s], "D65", SHAPE)[0] for s in (-step, step))
    np.testing.assert_allclose((high - low) / (2 * step), slope, atol=0.1 * np.abs(slope).max())


def test_depth_follows_from_blur(da_mobile):
    """The derivative of the camera's own blur at a depth."""
    near, far = (float(geometry.blur_px(da_mobile, 0.2 + s)) for s in (-1e-5, 1e-5))
    expected = 2e-5 / (near - far) * 0.3
    assert float(cramer_rao.depth_deviation_m(da_mobile, 0.2, 0.3)) == pytest.approx(expected, rel=1e-6)


def test_levels_are_steps_of_blur(da_mobile):
    assert float(cramer_rao.level_deviation(da_mobile, geometry.level_blur_px(da_mobile)[2])) == pytest.approx(2.0)
