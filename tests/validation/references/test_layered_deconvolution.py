"""Library deconvolution by level: known gains of gratings, flat pictures, and each pixel at its own level."""

from types import SimpleNamespace

import cv2
import numpy as np
import pytest

from validation.references import layered_deconvolution as rivals

SHAPE = (96, 128)
SIGMAS_PX = (0.0, 0.8, 1.6)  # of the Gaussian kernels of levels 0, 1, 2
INNER = (slice(24, -24), slice(40, -40))
GRATING = 1e-3  # of the mean: single precision, and the grating's phase at the mirrored border
FLAT = 1e-5


def kernels():
    """Gaussian kernels [level, 3, 21, 21]."""
    place = np.arange(21) - 10
    lines = [np.exp(-0.5 * (place / max(sigma, 1e-3)) ** 2) for sigma in SIGMAS_PX]
    return np.stack([np.broadcast_to(np.outer(a, a) / a.sum() ** 2, (3, 21, 21)) for a in lines]).astype(np.float32)


def grating(period_px, amplitude=100.0):
    """Vertical stripes [h, w, 3] about 1000, mirrored evenly at both ends of the frame."""
    wave = np.cos(2 * np.pi * (np.arange(SHAPE[1]) + 0.5) / period_px)
    return (1000 + amplitude * wave)[None, :, None].repeat(SHAPE[0], 0).repeat(3, 2).astype(np.float32)


@pytest.mark.parametrize("level", [0, 1, 2])
@pytest.mark.parametrize("period_px", [4, 8, 16])
def test_a_grating_has_the_gain_of_the_wiener_filter(level, period_px):
    """At a frequency f, the filter is H / (H^2 + balance L^2), with L = 2 - 2 cos(2 pi f) of the Laplacian."""
    kernel, f = kernels()[level, 0].astype(np.float64), 1 / period_px
    half = kernel.shape[-1] // 2
    transfer = np.sum(kernel.sum(axis=0) * np.cos(2 * np.pi * f * (np.arange(2 * half + 1) - half)))
    gain = transfer / (transfer**2 + rivals.BALANCE * (2 - 2 * np.cos(2 * np.pi * f)) ** 2)
    result = rivals.by_level(grating(period_px), np.full(SHAPE, level), kernels())
    expected = 1000 + gain * (grating(period_px) - 1000)
    np.testing.assert_allclose(result[INNER], expected[INNER], atol=1000 * GRATING)


@pytest.mark.parametrize("level", [0.0, 0.4, 1.7])
def test_flat_stays_flat(level):
    flat = np.full((*SHAPE, 3), 700, np.float32)
    np.testing.assert_allclose(rivals.by_level(flat, np.full(SHAPE, level), kernels()), 700, rtol=FLAT)
    np.testing.assert_allclose(rivals.denoised(SimpleNamespace(linear_e=flat)), 700, rtol=FLAT)


def test_each_pixel_is_that_of_its_own_level():
    texture = cv2.GaussianBlur(np.random.default_rng(4).normal(500, 100, (*SHAPE, 3)).astype(np.float32), (0, 0), 1)
    level = np.where(np.arange(SHAPE[1]) < 64, 0.2, 1.8)[None].repeat(SHAPE[0], 0)
    both = rivals.by_level(texture, level, kernels())
    for side, single in ((slice(0, 64), 0), (slice(64, None), 2)):
        alone = rivals.by_level(texture, np.full(SHAPE, single), kernels())
        np.testing.assert_array_equal(both[:, side], alone[:, side])


def test_denoising_removes_noise_and_no_blur():
    """Set-up: 1 % of noise on a flat picture, and on bars blurred by the kernel of level 2. Expectation: less noise of
    the one, and edges of the other as far from the sharp bars as before.
    """
    generator = np.random.default_rng(6)
    noise = generator.normal(0, 7, (*SHAPE, 3))
    noisy = (700 + noise).astype(np.float32)
    assert rivals.denoised(SimpleNamespace(linear_e=noisy)).std() < 0.7 * noisy.std()
    bars = np.where(np.arange(SHAPE[1]) // 8 % 2 == 0, 300.0, 1000.0)[None, :, None].repeat(SHAPE[0], 0).repeat(3, 2)
    captured = (cv2.GaussianBlur(bars, (21, 21), SIGMAS_PX[2]) + noise).astype(np.float32)
    smooth = rivals.denoised(SimpleNamespace(linear_e=captured))
    assert np.mean((smooth - bars) ** 2) > 0.9 * np.mean((captured - bars) ** 2)
