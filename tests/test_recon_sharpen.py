"""Deconvolution: its shrinkage against brute force, its gain on a known blur, and what it must leave alone."""

import numpy as np
import recon_scenes
from scipy.optimize import minimize_scalar

from recon import fourier, sharpen
from recon.settings import PAPER

NOISE_E = 10.0


def test_shrinkage_is_the_minimum():
    """The table against a bounded scalar search of |u|^0.8 + (u - v)^2 / 2."""
    table = sharpen.shrink_table()
    step = sharpen.TABLE_LIMIT / (len(table) - 1)
    for index in (0, 100, 180, 260, 700, 3000, len(table) - 1):
        v = index * step
        candidates = np.linspace(0, v + 1e-9, 4001)
        start = candidates[np.argmin(candidates**0.8 + (candidates - v) ** 2 / 2)]
        found = minimize_scalar(
            lambda u: abs(u) ** 0.8 + (u - v) ** 2 / 2,  # noqa: B023
            bounds=(max(start - 0.1, 0), start + 0.1),
            method="bounded",
            options={"xatol": 1e-7},
        )
        best = found.x if found.fun < v**2 / 2 else 0.0
        assert abs(table[index] - best) < 1e-3


def captured(level, photo="astronaut"):
    margin = recon_scenes.MARGIN_PX
    shape = level.shape
    visible, infrared = recon_scenes.textures(shape[0] + 2 * margin, shape[1] + 2 * margin, photo)
    mean = 4000 * recon_scenes.blurred(visible, infrared, level, "D65")
    _, _, signal = recon_scenes.stop_kernels("D65")
    inner = slice(margin, -margin)
    sharp = 4000 * (signal[0] * visible[inner, inner] + signal[1] * infrared[inner, inner, None])
    noise = NOISE_E * np.random.default_rng(1).standard_normal(mean.shape)
    return (mean + noise).astype(np.float32), sharp


def decibel(image, truth):
    return -10 * np.log10(np.mean((image - truth)[8:-8, 8:-8] ** 2))


def test_a_known_blur_is_undone():
    """Blur of 4 to 8 px, noise of 10 electrons: at least 2.5 dB in green, and every channel gains."""
    bank = recon_scenes.bank()
    for level_value in (2.0, 3.5, 4.5):
        level = np.full((192, 256), level_value, np.float32)
        image, truth = captured(level)
        result = sharpen.sharpen(image, level, bank.kernel[0], np.full(4, NOISE_E), PAPER)
        gain = [decibel(result[..., c], truth[..., c]) - decibel(image[..., c], truth[..., c]) for c in range(4)]
        assert gain[1] > 2.5 and min(gain) > 0, (level_value, gain)


def test_layers_gain_on_both_sides_of_a_step():
    """Two depths meet: each side's own pixels are sharper than captured, away from the step."""
    bank = recon_scenes.bank()
    level = np.where(np.arange(256) < 128, 3.0, 14.0)[None, :].repeat(192, 0).astype(np.float32)
    image, truth = captured(level)
    result = sharpen.sharpen(image, level, bank.kernel[0], np.full(4, NOISE_E), PAPER)
    for part in (slice(8, 118), slice(138, 248)):
        before = decibel(image[:, part, 1], truth[:, part, 1])
        assert decibel(result[:, part, 1], truth[:, part, 1]) > before + 1


def test_what_is_in_focus_stays_as_captured():
    bank = recon_scenes.bank()
    level = np.zeros((64, 96), np.float32)
    image, _ = captured(level)
    np.testing.assert_array_equal(
        sharpen.sharpen(image, level, bank.kernel[0], np.full(4, NOISE_E), PAPER), np.maximum(image, 0)
    )


def test_a_flat_picture_stays_flat():
    """Kernels have unit sum: a constant is its own deconvolution, up to float32."""
    bank = recon_scenes.bank()
    level = np.linspace(0, 28, 128, dtype=np.float32)[None, :].repeat(96, 0)
    image = np.full((96, 128, 4), 1000, np.float32)
    result = sharpen.sharpen(image, level, bank.kernel[0], np.full(4, NOISE_E), PAPER)
    np.testing.assert_allclose(result, 1000, rtol=1e-4)


def test_transfer_of_a_kernel_is_its_dft():
    """The DFT sums against a padded, rolled FFT of the same kernel."""
    kernel = np.random.default_rng(0).random((9, 9))
    padded = np.zeros((32, 40))
    padded[:9, :9] = kernel
    reference = np.fft.rfft2(np.roll(padded, (-4, -4), (0, 1)))
    np.testing.assert_allclose(fourier.transfer(kernel, (32, 40)), reference, atol=1e-4)
