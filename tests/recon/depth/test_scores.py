"""Raw levels: no bias on clean pictures and the planned error on noisy ones; and regularisation of the level map."""

import cv2
import numpy as np
import pytest

from recon import fourier
from recon.depth import peak, raw_levels, scores
from recon.depth.channels import Channel
from recon.depth.regularise import regularise
from recon.picture import mosaic
from recon.settings import PAPER
from tests.support import recon_scenes

CLEAN_BIAS_LEVELS = 0.1  # a tenth of a level: interpolation between kernels half a level apart, and the parabola
NOISY_MEDIAN_LEVELS = 0.8  # of pixels with an estimate, away from steps; the prototype had 0.5 without a mosaic
STEP_MARGIN_PX = 35
BORDER_BLOCKS = 24  # where the blur reaches beyond the frame


def grey(height, width, seed=0):
    """A texture with a natural 1/f amplitude spectrum, values 0.1 to 1, equal in all channels."""
    random = np.random.default_rng(seed)
    fy, fx = np.fft.fftfreq(height)[:, None], np.fft.rfftfreq(width)[None, :]
    spectrum = np.fft.rfft2(random.standard_normal((height, width))) / np.maximum(np.hypot(fy, fx), 0.01)
    texture = np.fft.irfft2(spectrum, (height, width))
    return 0.55 + 0.45 * np.clip(texture / (2.5 * texture.std()), -1, 1)


@pytest.mark.parametrize("level", [3.0, 8.0, 15.0, 24.0])
def test_clean_pictures_have_no_bias(level):
    """On noise-free planes of a grey texture at one level, the median level is the true one."""
    bank = recon_scenes.bank()
    margin = recon_scenes.MARGIN_PX
    texture = grey(256 + 2 * margin, 256 + 2 * margin)
    true = np.full((256, 256), level)
    mean_e = 4000 * recon_scenes.blurred(np.repeat(texture[..., None], 4, -1), texture, true, "D65")
    light = bank.lights.index("D65")

    def channel(index, phase):
        plane = np.ascontiguousarray(mean_e[phase[0] :: 2, phase[1] :: 2, index])
        return Channel(plane, phase, np.full(plane.shape, 1.0, np.float32), bank.kernel[light, :, index])

    score, ncc, offset, snr, _ = scores.match(channel(3, (1, 1)), channel(1, (0, 0)), PAPER)
    estimate, _ = peak.best_level(score, ncc, offset, PAPER.window_px)
    textured = snr > 50
    textured[:BORDER_BLOCKS] = textured[-BORDER_BLOCKS:] = False
    textured[:, :BORDER_BLOCKS] = textured[:, -BORDER_BLOCKS:] = False
    assert textured.mean() > 0.25
    assert abs(np.median(estimate[textured]) - level) < CLEAN_BIAS_LEVELS


SUBJECTS = (("D65", recon_scenes.slanted(384, 512, 2, 26)), ("A", recon_scenes.staircase(384, 512, 3, 24, 4)))


def estimated(light, level, seed=1):
    """True level, estimate and confidence, one value per block, of a picture with noise of its own."""
    bank = recon_scenes.bank()
    scene = recon_scenes.make(level, light=light, white_e=3500 if light == "D65" else 2500, seed=seed)
    raw, saturated = mosaic.linearise(scene.capture)
    index = bank.lights.index(light)
    variances = raw_levels.variances(raw, scene.capture)
    kernels, white = bank.kernel[index], bank.signature[index]
    frame = raw_levels.Frame(raw, variances, saturated, scene.capture.camera, kernels, white)
    estimate, confidence = raw_levels.raw_levels(frame, PAPER)
    true = cv2.resize(level.astype(np.float32), estimate.shape[::-1], interpolation=cv2.INTER_AREA)
    return true, estimate, confidence


@pytest.fixture(scope="module")
def noisy():
    """A slanted plane over all levels and a staircase, see :func:`estimated`."""
    return [estimated(light, level) for light, level in SUBJECTS]


def away_from_steps(true):
    size = np.ones((STEP_MARGIN_PX // 2 + 1,) * 2)
    return cv2.dilate(true, size) - cv2.erode(true, size) < 3


@pytest.fixture(scope="module")
def draws():
    """Five draws of the noise of each of them: median errors differ by up to a sixth, since a frame has few windows."""
    return [[estimated(light, level, seed) for seed in range(5)] for light, level in SUBJECTS]


@pytest.mark.slow
def test_noisy_mosaics_keep_the_planned_error(draws):
    for of_subject in draws:
        errors = []
        for true, estimate, _ in of_subject:
            good = np.isfinite(estimate) & away_from_steps(true)
            assert good.mean() > 0.2
            errors.append(np.median(np.abs(estimate - true)[good]))
        assert np.mean(errors) < NOISY_MEDIAN_LEVELS


@pytest.mark.slow
def test_no_bin_of_levels_is_biased(draws):
    """In each bin of six levels, from where blur is visible, the median signed error, the mean of the draws, stays
    below the limit of the absolute error.
    """
    for low in (2, 8, 14, 20):
        biases = []
        for true, estimate, _ in draws[0]:
            inside = np.isfinite(estimate) & away_from_steps(true) & (true >= low) & (true < low + 6)
            biases.append(np.median((estimate - true)[inside]) if inside.sum() > 300 else 0.0)
        assert abs(np.mean(biases)) < NOISY_MEDIAN_LEVELS


def test_confidence_ranks_errors(noisy):
    """The more confident half of the pixels has the smaller mean error."""
    for true, estimate, confidence in noisy:
        good = np.isfinite(estimate) & away_from_steps(true)
        error = np.minimum(np.abs(estimate - true)[good], 5)
        sure = confidence[good] > np.median(confidence[good])
        assert error[sure].mean() < error[~sure].mean()
        assert confidence.min() >= 0 and confidence.max() <= 1


def test_blended_border_has_no_step():
    """Neighbouring pixels of the added strip differ by no more than a ramp between the opposite edges requires."""
    image = np.linspace(0, 100, 40, dtype=np.float32)[None, :].repeat(30, 0)
    padded = fourier.pad_blended(image, (45, 60))
    closed = np.concatenate([padded, padded[:, :1]], axis=1)
    assert np.abs(np.diff(closed[:30], axis=1)).max() < 3 * 100 / 20
    np.testing.assert_array_equal(padded[:30, :40], image)


def test_regularisation_keeps_a_constant_and_fills_gaps():
    random = np.random.default_rng(2)
    level = np.where(random.random((96, 128)) < 0.1, 7.0, np.nan).astype(np.float32)
    confidence = np.where(np.isfinite(level), 0.8, 0).astype(np.float32)
    result, evidence = regularise(level, confidence, random.normal(0, 1, (96, 128)).astype(np.float32), 60.0)
    np.testing.assert_allclose(result, 7.0, rtol=1e-4)
    assert 0 <= evidence.min() and evidence.max() <= 1


def test_regularisation_keeps_the_edges_of_the_guide():
    """Between two halves whose guide differs by 40 standard deviations of the noise, no level leaks across."""
    random = np.random.default_rng(4)
    left = np.arange(128) < 64
    true = np.where(left, 5.0, 20.0)[None, :].repeat(96, 0)
    guide = (np.where(left, 20.0, 60.0)[None, :] + random.normal(0, 0.5, (96, 128))).astype(np.float32)
    level = np.where(random.random((96, 128)) < 0.2, true + random.normal(0, 0.5, true.shape), np.nan)
    confidence = np.where(np.isfinite(level), 0.7, 0)
    result, _ = regularise(level.astype(np.float32), confidence.astype(np.float32), guide, 60.0)
    assert np.abs(result - true).max() < 1.0  # a few dozen estimates of deviation 0.5 average below 0.25


def test_regularisation_without_any_estimate():
    empty = np.full((32, 48), np.nan, np.float32)
    result, evidence = regularise(empty, np.zeros((32, 48), np.float32), np.zeros((32, 48), np.float32), 60.0)
    assert not result.any() and not evidence.any()


def test_estimates_without_any_confidence_have_equal_weights():
    """Set-up: a user's estimates whose standard deviation is unknown, that is infinite."""
    level = np.full((32, 48), 7, np.float32)
    result, evidence = regularise(level, np.zeros((32, 48), np.float32), np.zeros((32, 48), np.float32), 60.0)
    np.testing.assert_allclose(result, 7, rtol=1e-6)
    assert not evidence.any()
