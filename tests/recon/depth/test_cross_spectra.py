"""Cross-spectra: filters, the noise of channels without infrared, and the spectra of a texture of known law."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import ndimage

from recon import fourier
from recon.depth import cross_spectra
from recon.depth.cross_spectra import EDGES, Window

SIDE = 512  # planes
PHASES = ((0, 1), (1, 0))
WHOLE = Window(100.0, 16)


def test_squares_of_the_filters_sum_to_one_between_the_middles_of_the_first_and_the_last_band():
    radius = np.geomspace(np.sqrt(EDGES[0] * EDGES[1]) * 1.001, np.sqrt(EDGES[-2] * EDGES[-1]) * 0.999, 400)
    total = sum(ring**2 for ring in cross_spectra.rings(radius))
    np.testing.assert_allclose(total, 1.0, atol=1e-5)


def test_noise_of_the_channels_is_predicted_with_the_infrared_that_is_subtracted():
    """Set-up: white noise of variances 3 and 5, alpha 0.6. Expectation: the measured matrix is the predicted one within
    its scatter, also its cross term -0.6 x 5.
    """
    random = np.random.default_rng(1)
    variances = [np.full((SIDE // 2, SIDE // 2), value, np.float32) for value in (3.0, 5.0)]
    planes = [100 + np.sqrt(v) * random.standard_normal(v.shape).astype(np.float32) for v in variances]
    (found,) = cross_spectra.measured(planes, PHASES, variances, [0.6], [WHOLE])
    middle = (found.energy.shape[0] // 2, found.energy.shape[1] // 2)
    energy, noise = found.energy[middle], found.noise[middle]
    np.testing.assert_allclose(noise, np.broadcast_to([3 + 0.36 * 5, -3.0, 5.0], noise.shape), rtol=1e-5)
    scatter = 6 / np.sqrt(found.number)[:, None]
    assert (np.abs(energy / noise - 1) < 4 * scatter / 6 * np.sqrt(2)).all()


@pytest.mark.parametrize("shift_px", [0, 2])
def test_spectra_of_a_natural_texture_are_those_of_its_planes_with_aliasing(shift_px):
    """Set-up: a texture of power 1 / f^2 on a grid of raw pixels, the same in both channels, a Gaussian blur of 0.7 px
    in one and of 2.5 px in the other, which is displaced as by a hole beside the axis, sampled at every second pixel at
    the channels' places. Expectation: the matrices
    of all bands in the ratios of the table within 6 %; without aliasing, the highest band would be off by more.
    """
    random = np.random.default_rng(4)
    shape = (2 * SIDE, 2 * SIDE)
    radius = np.hypot(*fourier.frequencies(shape))
    radius[0, 0] = 1.0
    texture = np.fft.irfft2(np.fft.rfft2(random.standard_normal(shape)) / radius, shape)
    sigmas = (0.7, 2.5)
    images = [ndimage.gaussian_filter(texture, sigma, mode="wrap") for sigma in sigmas]
    images[1] = np.roll(images[1], shift_px, axis=1)
    planes = [image[y::2, x::2].astype(np.float32) for image, (y, x) in zip(images, PHASES, strict=True)]
    nothing = [np.zeros((SIDE, SIDE), np.float32)] * 2
    (found,) = cross_spectra.measured(planes, PHASES, nothing, [0.0], [Window(300.0, 16)])
    energy = found.energy.mean(axis=(0, 1))
    point = np.zeros((61, 61))
    point[30, 30] = 1.0
    blurred = [ndimage.gaussian_filter(point, sigma) for sigma in sigmas]
    kernels = np.stack([blurred[0], np.roll(blurred[1], shift_px, axis=1)])[None].astype(np.float32)
    table = cross_spectra.expected(kernels, PHASES, exponent=2.0)[0]
    expected = np.stack([table[:, 0, 0], table[:, 0, 1], table[:, 1, 1]], axis=-1)
    scale = energy[2:, 0].sum() / expected[2:, 0].sum()
    used = slice(2, 6)  # lower bands have few values, higher ones no blurred texture
    np.testing.assert_allclose(energy[used], scale * expected[used], rtol=0.06)
    assert energy[7, 0] == pytest.approx(scale * expected[7, 0], rel=0.06)
    alone = 1.0 / EDGES[7:].mean() ** 2 * np.exp(-2 * (2 * np.pi * EDGES[7:].mean() * sigmas[0]) ** 2 / 2)
    first = 1.0 / EDGES[3:5].mean() ** 2 * np.exp(-2 * (2 * np.pi * EDGES[3:5].mean() * sigmas[0]) ** 2 / 2)
    assert energy[7, 0] / energy[3, 0] > 1.1 * alone / first, "aliasing adds to the highest band"


def test_a_few_strong_edges_do_not_decide_in_an_even_window():
    """Rationale: a window on a wall holds the outlines of what stands before it.

    Set-up: noise of variance 1, the same in both channels; over 6 % of the columns, noise of 100 times that variance in
    the first channel alone. Expectation, from shares of energy: the channels' coherence is 1 / sqrt(1 + 6) = 0.38 in a
    window of equal weights, and about 1 / sqrt(1 + 0.06) = 0.97 in an even one, which weighs the columns by 1 %.
    """
    random = np.random.default_rng(7)
    weak, strong = random.standard_normal((2, SIDE, SIDE))
    strip = np.where(np.arange(SIDE) % 128 < 8, 10.0, 0.0)
    planes = [image.astype(np.float32) for image in (weak + strip * strong, weak)]
    nothing = [np.full((SIDE, SIDE), 1e-3, np.float32)] * 2
    windows = [Window(100.0, 16), Window(100.0, 16, even=True)]
    equal, even = (
        (band[..., 1] / np.sqrt(band[..., 0] * band[..., 2])).mean()
        for band in (
            found.energy[..., -1, :]
            for found in cross_spectra.measured(planes, ((0, 0), (0, 0)), nothing, [0.0], windows)
        )
    )
    assert equal == pytest.approx(0.38, abs=0.06)
    assert even > 0.85
