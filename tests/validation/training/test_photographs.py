"""Photographs of the training: soft, and softer away from what they are focused on."""

from __future__ import annotations

import numpy as np
import pytest

from validation.training import photographs
from validation.training.patterns import softened
from validation.training.rooms import FAMILIES

SIZE_PX = 64


def detail(image):
    """Root mean square of the finest differences over that of the picture's variation."""
    return np.diff(image, axis=-1).std() / image.std()


@pytest.mark.slow
def test_a_photograph_is_softer_than_what_it_shows(monkeypatch):
    """Expectation: in each of some photographs less detail than in the same room without blur, and nearly none beyond
    what its largest blur leaves.
    """
    for seed in range(4):
        soft = photographs.photograph(np.random.default_rng(seed), SIZE_PX, FAMILIES["textured"])
        with monkeypatch.context() as patch:
            patch.setattr(photographs, "softened", lambda image, sigma_px, periodic: image)
            sharp = photographs.photograph(np.random.default_rng(seed), SIZE_PX, FAMILIES["textured"])
        assert soft.shape == sharp.shape == (3, 2 * SIZE_PX, 2 * SIZE_PX)
        assert soft.mean() == pytest.approx(sharp.mean(), rel=0.1)
        assert detail(soft) < 0.9 * detail(sharp)


def test_blur_grows_with_the_distance_from_the_focus(monkeypatch):
    """Set-up: a fine pattern whose level rises from the left to the right, in place of a room; no other blur.

    Expectation: where the focus is, the pattern keeps its contrast; farther from it, less and less is left.
    """
    stripes = np.tile(np.array([0.0, 1.0, 1.0, 0.0], np.float32), (4, 128, 32))
    seen = photographs.room(np.random.default_rng(0), SIZE_PX, SIZE_PX, 10.0, FAMILIES["plain"])
    ramp = np.tile(np.linspace(0, 10, 128, dtype=np.float32), (128, 1))
    monkeypatch.setattr(photographs, "room", lambda *_: seen._replace(radiance=stripes, level=ramp))
    monkeypatch.setattr(photographs, "SIGMA_PX", (1e-3, 1e-3))
    monkeypatch.setattr(photographs, "DEFOCUS_PX", (4.0, 4.0))
    random = np.random.default_rng(3)
    focus = np.random.default_rng(3).integers(0, ramp.shape)[1]
    contrast = photographs.photograph(random, SIZE_PX, FAMILIES["plain"])[0].reshape(128, 16, 8).std(axis=(0, 2))
    away = np.abs(np.arange(16) * 8 + 3.5 - focus)
    assert contrast[np.argmin(away)] > 0.35
    assert (np.diff(contrast[np.argsort(away)])[2:] < 0.03).all() and contrast[np.argmax(away)] < 0.05


def test_softening_keeps_the_mean_and_its_variance_is_that_of_a_gaussian():
    """Set-up: white noise, repeated. Expectation: its variance falls to 1 / (4 pi sigma^2)."""
    noise = np.random.default_rng(1).standard_normal((2, 256, 256)).astype(np.float32)
    soft = softened(noise, 2.0, periodic=True)
    np.testing.assert_allclose(soft.mean(axis=(1, 2)), noise.mean(axis=(1, 2)), atol=1e-4)
    assert soft.var() == pytest.approx(1 / (4 * np.pi * 4), rel=0.05)
    assert softened(noise, 0.0, periodic=True) is noise
