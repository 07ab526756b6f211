"""The estimator of all designs against closed forms, and on spectra drawn from its own model and from white noise."""

from __future__ import annotations

import numpy as np
import pytest

import dasim
from validation.rivals import designs, likelihood, windows
from validation.rivals.designs import DESIGNS
from validation.rivals.windows import FOLDED, SAMPLES, SPACING_PX

SIZE_PX = (96, 96)
BLUR_PX = np.arange(0.0, 16.5, 1.0)
NOISE = 1 / 400
CONTRAST = 0.15
DRAWN = 60
BY_NAME = {design.name: design for design in DESIGNS}


def made(name: str) -> likelihood.Model:
    scene = dasim.load_scene("desk")
    return likelihood.model(designs.cameras(BY_NAME[name], SIZE_PX, scene), "D65", BLUR_PX)


@pytest.fixture(scope="module")
def models() -> dict[str, likelihood.Model]:
    return {name: made(name) for name in ("dual-aperture", "open-lens")}


def drawn(known: likelihood.Model, number: int, seed: int = 0) -> windows.Spectra:
    """Windows of a grey texture at one blur, as the model says."""
    random = np.random.default_rng(seed)
    planes = known.covariance.shape[-1]
    root = np.linalg.cholesky(known.covariance[number] * CONTRAST**2 + NOISE * np.eye(planes))
    white = random.standard_normal((2, DRAWN, *root.shape[:2]))
    white = np.where((known.times == 2)[:, None], (white[0] + 1j * white[1]) / np.sqrt(2), white[0])
    noise = np.full((DRAWN, planes), NOISE)
    return windows.Spectra(np.einsum("fij,nfj->nfi", root, white), noise, np.ones(DRAWN, bool))


def test_white_noise_has_its_own_power():
    """Expectation: E |Y|^2 = n at every frequency that is kept, to 4 standard errors of 4,000 windows."""
    random = np.random.default_rng(1)
    patches = 0.3 * random.standard_normal((4000, SAMPLES, SAMPLES)) * windows.taper()
    kept, times = windows.half_plane()
    power = (np.abs(windows.transform(patches)[:, kept]) ** 2).mean(axis=0)
    error = 0.09 * np.sqrt(np.where(times == 2, 1, 2) / 4000)
    assert (np.abs(power - 0.09) < 4.5 * error).all()
    assert times.sum() == FOLDED**2 - 1


def test_texture_has_the_power_of_the_model():
    """Set-up: a periodic texture of 1/f^2 on a large frame, without blur, sampled and windowed as a plane is.
    Expectation: the power of the sharp texture in the model within 10 % in each ring; leakage included.
    """
    side, random = 512, np.random.default_rng(2)
    radius = np.hypot(np.fft.fftfreq(side)[:, None], np.fft.fftfreq(side))
    radius[0, 0] = np.inf
    density = 1 / (2 * np.pi * np.log(2.0)) / radius**2
    noise = np.fft.fft2(random.standard_normal((side, side)))
    image = np.fft.ifft2(noise * np.sqrt(density)).real
    kept, times = windows.half_plane()
    window = windows.taper()
    patches = []
    for y in range(0, side - 64, 16):
        for x in range(0, side - 64, 16):
            part = image[y : y + 64 : SPACING_PX, x : x + 64 : SPACING_PX]
            patches.append((part - (part * window**2).sum() / (window**2).sum()) * window)
    power = (np.abs(windows.transform(np.array(patches))[:, kept]) ** 2).mean(axis=0)
    without_lens = np.ones((1, 1, 2 * SAMPLES, 2 * SAMPLES), complex)
    expected = likelihood.plane_covariance(without_lens)[0, kept, 0, 0].real
    ring = likelihood.rings()
    for number in range(2, likelihood.RINGS):
        inside = ring == number
        assert (power * times)[inside].sum() == pytest.approx((expected * times)[inside].sum(), rel=0.1)


@pytest.mark.parametrize("name", ["dual-aperture", "open-lens"])
def test_estimates_reach_the_bound_without_bias(models, name):
    """Set-up: windows drawn from the model at 4 and 10 px of blur. Expectation: a bias below a third of a px, and an
    rms error between 0.6 and 2 times the bound; the estimate knows less than the bound, and the prior helps it.
    """
    known = models[name]
    for number in (4, 10):
        found = likelihood.estimate(drawn(known, number), known)
        error = found.place - number  # blurs are 1 px apart
        planes = known.covariance.shape[-1]
        bound = likelihood.deviation_px(
            known, np.full(planes, NOISE), BLUR_PX[number], np.full((planes, planes), CONTRAST**2)
        )
        assert abs(np.median(error)) < 1 / 3
        assert 0.6 < 1.4826 * np.median(np.abs(error)) / bound < 2


def test_the_dual_aperture_tells_more_than_one_open_lens(models):
    bounds = {}
    for name, known in models.items():
        planes = known.covariance.shape[-1]
        case = (np.full(planes, NOISE), 8.0, np.full((planes, planes), CONTRAST**2))
        bounds[name] = likelihood.deviation_px(known, *case)
    assert bounds["dual-aperture"] < bounds["open-lens"] < np.inf


def test_textures_are_found_again(models):
    """Expectation: the mean contrast and the coherence, clipped to 0.95, that the windows were drawn with."""
    known = models["dual-aperture"]
    spectra = drawn(known, 6)
    textures = np.array(
        [likelihood.fitted_textures(value, noise, known)[6] for value, noise in zip(*spectra[:2], strict=True)]
    )
    contrast = np.sqrt(np.einsum("npp->np", textures))
    np.testing.assert_allclose(np.median(contrast, axis=0), CONTRAST, rtol=0.15)
    green, infrared = 0, 3
    correlation = textures[:, green, infrared] / contrast[:, green] / contrast[:, infrared]
    assert np.median(correlation) == pytest.approx(likelihood.MOST_COHERENT, abs=0.03)


def test_sharp_texture_is_nearer_than_the_captured_one(models):
    """Set-up: a known texture, blurred and noisy. Expectation: the conditional mean has at most half of the error."""
    known = models["dual-aperture"]
    number, random = 6, np.random.default_rng(5)
    planes = known.covariance.shape[-1]
    # Texture and planes together: covariance of (sharp, planes) at every frequency.
    sharp = known.power * CONTRAST**2
    cross = known.sharp[number] * CONTRAST**2
    own = known.covariance[number] * CONTRAST**2 + NOISE * np.eye(planes)
    whole = np.empty((len(sharp), planes + 1, planes + 1), complex)
    whole[:, 0, 0], whole[:, 0, 1:], whole[:, 1:, 0], whole[:, 1:, 1:] = sharp, cross, np.conj(cross), own
    root = np.linalg.cholesky(whole + 1e-9 * np.eye(planes + 1))
    white = random.standard_normal((2, DRAWN, *root.shape[:2]))
    both = np.einsum("fij,nfj->nfi", root, (white[0] + 1j * white[1]) / np.sqrt(2))
    spectra = windows.Spectra(both[..., 1:], np.full((DRAWN, planes), NOISE), np.ones(DRAWN, bool))
    grey = np.full((DRAWN, planes, planes), CONTRAST**2)
    estimate = likelihood.sharp_texture(spectra, known, likelihood.Found(np.full(DRAWN, number, float), grey))
    before, after = (float((np.abs(one - both[..., 0]) ** 2).sum()) for one in (both[..., 1], estimate))
    assert after < 0.5 * before
