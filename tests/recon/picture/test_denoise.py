"""Nonlocal means, compared with a plain transcription of eq. (3)-(5), and its noise model, with simulated noise."""

import numpy as np

from dasim.camera import noise
from dasim.camera.crosstalk import electronic_crosstalk
from dasim.values import Capture
from recon import PAPER
from recon.picture import denoise, develop, mosaic
from tests.support import recon_scenes


def transcription(plane, guide, bandwidth, sigma):
    """Eq. (3)-(5), evaluated pixel by pixel."""
    reach, half = 4, 1
    wide, wide_guide = (np.pad(a.astype(float), reach + half, "symmetric") for a in (plane, guide))
    t = np.arange(-half, half + 1)
    bell = np.exp(-(t[:, None] ** 2 + t[None, :] ** 2) / (2 * sigma**2))
    bell /= bell.sum()

    def patch(y, x):
        return wide_guide[y - half : y + half + 1, x - half : x + half + 1]

    out = np.zeros(plane.shape)
    for y in range(plane.shape[0]):
        for x in range(plane.shape[1]):
            cy, cx = y + reach + half, x + reach + half
            offsets = [(dy, dx) for dy in range(-reach, reach + 1) for dx in range(-reach, reach + 1)]
            distances = [np.sum(bell * (patch(cy, cx) - patch(cy + dy, cx + dx)) ** 2) for dy, dx in offsets]
            weights = np.exp(-np.array(distances) / bandwidth)
            out[y, x] = weights @ np.array([wide[cy + dy, cx + dx] for dy, dx in offsets]) / weights.sum()
    return out


def test_equals_the_transcription():
    """Limit: 1e-5 of the signal, for sums of 81 terms in float32 against float64."""
    random = np.random.default_rng(3)
    plane = random.uniform(100, 200, (14, 17)).astype(np.float32)
    guide = (plane / 20).astype(np.float32)
    result = denoise.nonlocal_means(plane, guide, 2.0, 1.3)
    np.testing.assert_allclose(result, transcription(plane, guide, 2.0, 1.3), rtol=1e-5)


def test_equals_the_transcription_at_the_pipelines_strength():
    """Set-up: a noisy edge in electrons with the guide and the parameters of the preset, as in `reconstruct`."""
    camera = recon_scenes.da_mobile(32, 24)
    mean_e = np.where(np.arange(32) < 13, 300.0, 2500.0)[None, :].repeat(24, 0)
    raw, _ = noise.expose(mean_e, camera.sensor, 0.01, 4)
    capture = Capture(raw, camera, 0.01, 1.0, 4)
    electrons, _ = mosaic.linearise(capture)
    clean = develop.denoised(electrons, capture, PAPER)
    collected = mosaic.collected(electrons, camera)
    for row, column in ((0, 0), (0, 1), (1, 0), (1, 1)):
        plane = electrons[row::2, column::2]
        guide = denoise.stabilise(collected[row::2, column::2], noise.variance(camera.sensor, 0.01))
        expected = transcription(plane, guide, PAPER.denoise_bandwidth, PAPER.denoise_patch_sigma_px)
        np.testing.assert_allclose(clean[row::2, column::2], expected, rtol=1e-5)


def flat_capture(level_e, seed=0):
    camera = recon_scenes.da_mobile(256, 256)
    mean_e = electronic_crosstalk(np.full((256, 256), level_e), camera)
    raw, _ = noise.expose(mean_e, camera.sensor, 0.01, seed)
    return Capture(raw, camera, 0.01, 1.0, seed)


def test_stabilised_noise_has_unit_deviation():
    """Set-up: a flat mosaic, of which each plane is flat, since crosstalk takes more from red than from blue.

    Limit: 3 %, for the curvature of the variance-stabilising curve; 16,384 samples give the deviation to 0.6 %.
    """
    for level_e in (60.0, 500.0, 4000.0):
        capture = flat_capture(level_e)
        electrons, _ = mosaic.linearise(capture)
        collected = mosaic.collected(electrons, capture.camera)
        guide = denoise.stabilise(collected, noise.variance(capture.camera.sensor, capture.exposure_s))
        for row, column in ((0, 0), (0, 1), (1, 0), (1, 1)):
            assert abs(guide[row::2, column::2].std() - 1) < 0.03
        assert abs(electrons.mean() / level_e - 1) < 0.003


def test_flat_field_keeps_its_mean_and_loses_noise():
    """An average of 81 samples of nearly equal weight reduces the noise by far more than half and keeps the mean."""
    capture = flat_capture(800.0)
    electrons, _ = mosaic.linearise(capture)
    guide = denoise.stabilise(electrons, noise.variance(capture.camera.sensor, capture.exposure_s))
    result = denoise.nonlocal_means(electrons, guide, 3.0)
    assert result.std() < 0.4 * electrons.std()
    assert abs(result.mean() - electrons.mean()) < 0.002 * 800


def test_steps_far_above_the_noise_stay():
    """A step of 20 standard deviations remains exactly as it is: weights across it are below exp(-100)."""
    plane = np.where(np.arange(32) < 16, 100.0, 900.0)[None, :].repeat(32, 0).astype(np.float32)
    result = denoise.nonlocal_means(plane, plane / 30, 3.0)
    np.testing.assert_allclose(result, plane, rtol=1e-4)
