"""Detail that the samples show comes back near focus, and nothing else changes."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from recon.sharp import lost_detail
from recon.sharp import samples as of_mosaic
from recon.sharp.samples import Samples

HEIGHT, WIDTH = 96, 128
SD = 30.0
PX_PER_LEVEL = 1.85
SITES = [(0, 1), (0, 0), (1, 1)]  # of R, G, B in the paper's block


@pytest.fixture
def sites():
    masks = []
    for row, column in SITES:
        mask = np.zeros((HEIGHT, WIDTH), bool)
        mask[row::2, column::2] = True
        masks.append(mask)
    return masks


def captured(stripes: float, seed: int = 0):
    """Channels with noise [3, h, w] of stripes of 8 px, their truth [h, w, 3], and a picture without the stripes."""
    wave = stripes * np.sign(np.sin(2 * np.pi * (np.arange(WIDTH) + 0.5) / 8))
    truth = np.broadcast_to((1000 + wave)[None, :, None], (HEIGHT, WIDTH, 3)).astype(np.float32)
    noise = np.random.default_rng(seed).normal(0, SD, (3, HEIGHT, WIDTH))
    return (np.moveaxis(truth, -1, 0) + noise).astype(np.float32), truth, np.full_like(truth, 1000.0)


def restored(picture, samples, sites, level, sd=0.1):
    changed = picture.copy()
    variance = np.full((HEIGHT // 2, WIDTH // 2), SD**2, np.float32)
    channels = [Samples(mask, value, variance) for mask, value in zip(sites, samples, strict=True)]
    levels, sds = (np.full((HEIGHT, WIDTH), value, np.float32) for value in (level, sd))
    lost_detail.restore(changed, channels, PX_PER_LEVEL * levels, PX_PER_LEVEL * sds)
    return changed


def test_stripes_that_a_picture_lacks_come_back(sites):
    """Set-up: stripes of five times the noise, which the picture does not show. Expectation: in focus, less than 0.4 of
    their error is left, noise and interpolation included; from the last blur on nothing changes.
    """
    samples, truth, flat = captured(5 * SD)
    assert np.abs(restored(flat, samples, sites, 0.0) - truth).mean() < 0.4 * np.abs(flat - truth).mean()
    np.testing.assert_array_equal(restored(flat, samples, sites, of_mosaic.BLURS_PX[1] / PX_PER_LEVEL), flat)


def test_noise_is_not_brought_back(sites):
    """Set-up: a picture that is the truth. Expectation: it gets a tenth of the samples' noise at most."""
    samples, truth, flat = captured(0.0)
    assert (restored(flat, samples, sites, 0.0) - truth).std() < 0.1 * SD


def test_a_sharper_picture_than_the_captured_one_is_left(sites):
    """Set-up: at level 1, a step that the captured picture shows blurred. Expectation: the sharp step stays, since its
    blur is what was captured, also where the level is known to lie between -0.2 and 1.
    """
    truth = np.full((HEIGHT, WIDTH, 3), 500.0, np.float32)
    truth[:, WIDTH // 2 :] = 1500.0
    blurred = cv2.GaussianBlur(truth, (0, 0), of_mosaic.DISC * PX_PER_LEVEL)
    samples = np.moveaxis(blurred, -1, 0) + np.random.default_rng(1).normal(0, SD, (3, HEIGHT, WIDTH)).astype(
        np.float32
    )
    wrong, exact, unsure = (
        (restored(truth, samples, sites, level, sd) - truth).std() for level, sd in ((0.0, 0.0), (1.0, 0.0), (0.4, 0.6))
    )
    assert max(exact, unsure) < 0.4 * wrong, (exact, unsure, wrong)


def test_strips_leave_no_seams(sites, monkeypatch):
    samples, _, flat = captured(2 * SD)
    whole = restored(flat, samples, sites, 0.3)
    monkeypatch.setattr(of_mosaic, "STRIP_PX", 32)
    np.testing.assert_allclose(restored(flat, samples, sites, 0.3), whole, atol=1e-3)


def test_a_channel_without_samples_is_left():
    """Expectation: what the 4x4 mosaic has of red is too far apart; the other channels are as with it."""
    random = np.random.default_rng(0)
    value = random.normal(1000, 100, (64, 64)).astype(np.float32)
    samples = Samples(np.ones((64, 64), bool), value, np.ones((32, 32), np.float32))
    level = np.zeros((64, 64), np.float32)
    all_of_them, some = (np.full((64, 64, 3), 1000, np.float32) for _ in range(2))
    lost_detail.restore(all_of_them, [samples] * 3, level, level)
    lost_detail.restore(some, [None, samples, None], level, level)
    np.testing.assert_array_equal(some[..., ::2], 1000)
    np.testing.assert_array_equal(some[..., 1], all_of_them[..., 1])
    assert np.abs(some[..., 1] - 1000).mean() > 10
