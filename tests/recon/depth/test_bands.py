"""Levels by frequency bands: energies of white noise, bias caused by noise, and the standard error of a known
likelihood.
"""

import numpy as np
import pytest
from scipy import signal

import recon
from dasim.values import Capture
from recon import fourier
from recon.depth import bands, channels, grid, peak, scores
from recon.settings import PRESETS
from tests.support import recon_scenes

BANDS = PRESETS["bands"]
WINDOW = scores.window_of(BANDS)
BORDER_PX = 45
WEAK_BIAS_LEVELS = 0.5  # at a noise where the NCC's weight for the frame misses by levels


def test_rings_share_the_power():
    """The squared weights of the rings add up to one between the centres of the first and the last ring."""
    total = np.sum([ring**2 for ring in bands.filters((96, 128), 2.0)], axis=0)
    radius = np.hypot(*fourier.frequencies((96, 128), 2.0))
    inside = (radius > 0.04) & (radius < 0.2)
    np.testing.assert_allclose(total[inside], 1, atol=1e-5)


def test_energies_of_white_noise_are_its_variances():
    """Independent white noise of variance 4 and 9 has these energies in every band and no cross product, within 5
    sigma.
    """
    random = np.random.default_rng(5)
    shape = (256, 256)
    noise = [s * random.standard_normal(shape).astype(np.float32) for s in (2, 3)]
    spectra = (fourier.forward(noise[0]), fourier.forward(noise[1]))
    variance = (np.full(shape, 4, np.float32), np.full(shape, 9, np.float32))
    (pair,) = bands.energies(spectra, variance, shape, WINDOW, 2.0)
    values = 256**2 * pair.values / (4 * np.pi * (BANDS.window_px / 2) ** 2 / 12)  # independent ones in the frame
    for index, count in enumerate(values):
        # the bands' middles have at least 100 values; five standard deviations of a mean square
        slack = 5 * np.sqrt(2 / max(count, 1))
        assert abs(pair.sharper[index].mean() / 4 - 1) < slack
        assert abs(pair.green[index].mean() / 9 - 1) < slack
        assert abs(pair.product[index].mean() / 6) < slack


def planes(level, noise, size=224, seed=0):
    """Infrared and green planes of a natural texture at a level of the bank, sampled at every pixel; ``noise`` is
    relative to the contrast.
    """
    bank = recon_scenes.bank()
    kernels = bank.kernel[bank.lights.index("D65")]
    random = np.random.default_rng(seed)
    side = size + kernels.shape[-1] - 1
    fy, fx = fourier.frequencies((side, side))
    spectrum = np.fft.rfft2(random.standard_normal((side, side))) / np.maximum(np.hypot(fy, fx), 0.01)
    texture = np.fft.irfft2(spectrum, (side, side))
    texture = 10 + texture / texture.std()
    pair = []
    for index in (3, 1):
        plane = signal.fftconvolve(texture, kernels[level, index].astype(float), "valid")
        plane = (plane + noise * random.standard_normal(plane.shape)).astype(np.float32)
        variance = np.full(plane.shape, noise**2, np.float32)
        pair.append(channels.Channel(plane, (0, 0), variance, kernels[:, index]))
    return pair


def estimates(level, noise):
    score = scores.match(*planes(level, noise), BANDS, 1.0)
    value, confidence = peak.best_level(score.score, score.ncc, score.offset, BANDS.window_px)
    inner = slice(BORDER_PX, -BORDER_PX)
    return value[inner, inner], confidence[inner, inner]


@pytest.mark.parametrize("level", [0, 4, 8])
def test_noise_causes_no_bias(level):
    """With noise of a tenth of the texture's contrast in both channels, the median level stays near the true one."""
    value, _ = estimates(level, 0.1)
    assert abs(np.median(value) - level) < WEAK_BIAS_LEVELS


def test_confidence_falls_with_noise():
    means = [estimates(8, noise)[1].mean() for noise in (0.1, 0.5, 2.0)]
    assert means[0] > means[1] > means[2]


def test_infrared_leak_is_subtracted():
    """Green that contains half of the infrared, and a leak that states this, give the same level as green without
    infrared.
    """
    infrared, green = planes(8, 0.02)
    mixed = channels.Channel(
        green.plane + 0.5 * infrared.plane,
        green.phase,
        green.variance * 1.25,
        (green.kernels + 0.5 * infrared.kernels) / 1.5,
    )
    score = scores.match(infrared, mixed, BANDS, 1.0, leak=channels.Leak(0.5, 1 / 1.5))
    value, _ = peak.best_level(score.score, score.ncc, score.offset, BANDS.window_px)
    assert abs(np.median(value[45:-45, 45:-45]) - 8) < WEAK_BIAS_LEVELS


def test_standard_error_of_a_parabola():
    """A Gaussian likelihood with a deviation of 1.5 levels has a standard error of 1.5 levels."""
    k = np.arange(29, dtype=np.float32)[:, None, None]
    score = -((k - 14) ** 2) / (2 * 1.5**2) * np.ones((1, 2, 3), np.float32)
    np.testing.assert_allclose(bands.standard_error(score.astype(np.float32)), 1.5, rtol=1e-3)


def test_plane_mean_counts_both_halves():
    """The mean of a constant spectrum is that constant, for even and odd widths."""
    for width in (8, 9):
        assert grid.plane_mean(np.ones((6, width // 2 + 1)), width) == pytest.approx(1)


@pytest.mark.parametrize("fill", ["black", "saturated", "constant"])
def test_frames_without_texture_end_with_no_confidence(fill):
    """Black, saturated and constant frames give finite results and no confidence."""
    camera = recon_scenes.da_mobile(128, 96)
    sensor = camera.sensor
    value = {"black": sensor.black_level_dn, "saturated": 2**sensor.adc_bits - 1, "constant": 300}[fill]
    capture = Capture(np.full((96, 128), value, np.uint16), camera, 0.02, 1.0, 0)
    result = recon.reconstruct(capture, recon_scenes.bank(), BANDS)
    for name in ("rgb", "sharp_rgb", "linear_e", "sharp_e", "ir_e", "level", "depth_m", "confidence"):
        assert np.isfinite(getattr(result, name)).all(), name
    assert not result.confidence.any()


def test_patches_end_where_the_material_does():
    """Two halves of energy 1 and 100 that differ in their ratio of channels each keep their own energy.

    Only the blur of the guide (2.4 samples) lets energy across: at the border less than half of what a plain patch (5
    samples) takes over, and nothing far from it.
    """
    left = np.arange(96) < 48
    stack = np.where(left, 1, 100).astype(np.float32) * np.ones((1, 64, 96), np.float32)
    likeness = np.where(left, 0, 10).astype(np.float32) * np.ones((1, 64, 96), np.float32)
    of = bands.taps(stack.shape[1:], WINDOW, 2.0)
    apart = bands.patch_means(grid.gaussian_means(stack, bands.TAP_BLUR * of.step), likeness, of)[0]
    mixed = grid.window_mean(stack[0], WINDOW)
    assert ((apart - 1)[:, 44:48] < 0.5 * (mixed - 1)[:, 44:48]).all()
    assert ((100 - apart)[:, 48:52] < 0.5 * (100 - mixed)[:, 48:52]).all()
    np.testing.assert_allclose(apart[:, :24], 1, rtol=0.01)
    np.testing.assert_allclose(apart[:, 72:], 100, rtol=0.01)
