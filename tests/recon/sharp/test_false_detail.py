"""Detail that the samples of the mosaic do not confirm goes; what they confirm, and what they cannot tell, stays."""

from __future__ import annotations

import numpy as np
import pytest

from recon.sharp import false_detail
from recon.sharp import samples as of_mosaic
from recon.sharp.samples import Samples

HEIGHT, WIDTH = 96, 128
SHAPE = (HEIGHT, WIDTH)
SD = 30.0
PX_PER_LEVEL = 1.85
SITES = [(0, 1), (0, 0), (1, 1)]  # of R, G, B in the paper's block
MEAN = 1000.0


def texture(size: float, seed: int) -> np.ndarray:
    """Grey texture without order, [h, w, 3] electrons."""
    one = MEAN + size * np.random.default_rng(seed).normal(0, 1, SHAPE)
    return np.repeat(one[..., None], 3, axis=2).astype(np.float32)


def samples_of(truth: np.ndarray, seed: int = 5) -> list[Samples]:
    noise = np.random.default_rng(seed).normal(0, SD, truth.shape)
    value = (truth + noise).astype(np.float32)
    variance = np.full((HEIGHT // 2, WIDTH // 2), SD**2, np.float32)
    result = []
    for channel, (row, column) in enumerate(SITES):
        mask = np.zeros(SHAPE, bool)
        mask[row::2, column::2] = True
        result.append(Samples(mask, value[..., channel], variance))
    return result


def removed(picture: np.ndarray, truth: np.ndarray, captured: np.ndarray, level: float = 0.0) -> np.ndarray:
    changed = picture.copy()
    false_detail.remove(changed, samples_of(truth), captured, np.full(SHAPE, PX_PER_LEVEL * level, np.float32))
    return changed


def test_texture_that_is_not_in_the_samples_goes():
    """Set-up: a picture with texture of the size of the noise on a uniform surface; the captured picture is uniform.
    Expectation: less than a fifth of the texture is left in focus, all of it from the last blur on.
    """
    truth, picture = np.full((*SHAPE, 3), MEAN, np.float32), texture(SD, 1)
    assert (removed(picture, truth, truth) - truth).std() < 0.2 * SD
    np.testing.assert_array_equal(removed(picture, truth, truth, of_mosaic.BLURS_PX[1] / PX_PER_LEVEL), picture)


@pytest.mark.parametrize("size", [0.3 * SD, SD, 3 * SD])
def test_texture_that_is_in_the_samples_stays(size: float):
    """Set-up: a picture that is the truth; noise reduction has taken the texture from the captured picture.
    Expectation: a tenth of the texture is lost, if it is as strong as the noise, and a quarter of weaker ones.
    """
    truth, smooth = texture(size, 1), np.full((*SHAPE, 3), MEAN, np.float32)
    left = removed(truth, truth, smooth)
    assert (left - truth).std() < (0.1 if size >= SD else 0.25) * size


def test_a_smooth_picture_stays():
    """Set-up: a smooth picture, and a captured one with the noise that is left. Expectation: nothing changes."""
    picture = np.full((*SHAPE, 3), MEAN, np.float32)
    np.testing.assert_array_equal(removed(picture, picture, texture(0.3 * SD, 2)), picture)


def test_each_channel_is_judged_by_its_own_samples():
    """Set-up: a picture with the texture of red in all channels. Expectation: it stays in red alone."""
    picture = texture(2 * SD, 1)
    truth = np.full((*SHAPE, 3), MEAN, np.float32)
    truth[..., 0] = picture[..., 0]
    left = (removed(picture, truth, np.full_like(truth, MEAN)) - MEAN).std(axis=(0, 1)) / (2 * SD)
    assert left[0] > 0.9
    assert left[1:].max() < 0.2


def test_strips_leave_no_seams(monkeypatch: pytest.MonkeyPatch):
    truth, picture = np.full((*SHAPE, 3), MEAN, np.float32), texture(SD, 1)
    whole = removed(picture, truth, truth)
    monkeypatch.setattr(of_mosaic, "STRIP_PX", 32)
    np.testing.assert_allclose(removed(picture, truth, truth), whole, atol=2e-3)
