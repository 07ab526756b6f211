"""Crosstalk between pixels: charge, single electrons, shares of channels, and its correction."""

from __future__ import annotations

import numpy as np
import pytest

from dasim.base.errors import InputError
from dasim.camera import crosstalk, diffusion, radiometry
from dasim.camera import sensor as sensors
from dasim.camera import specification as cameras
from dasim.spectra import colour_checker, grid, illuminants

SIDE = 250


@pytest.fixture
def make(da_mobile):
    """Da-mobile with changed values of its sensor."""

    def camera(**changes):
        return da_mobile.model_copy(update={"sensor": da_mobile.sensor.model_copy(update=changes)})

    return camera


def sized(camera, shape):
    """The camera with a frame of any shape [h, w], also smaller than a cell of the mosaic; all its pixels are green."""
    changes = {"height_px": shape[0], "width_px": shape[1], "mosaic": (("G",),)}
    return camera.model_copy(update={"sensor": camera.sensor.model_copy(update=changes)})


# --- a number for all wavelengths ----------------------------------------------------------------


def test_crosstalk_of_a_point(make):
    """Expectation: a pixel of 1,000 electrons keeps 600 and gives 100 to each edge neighbour; at the frame's corner it
    has two neighbours and keeps 800.
    """
    image = np.zeros((5, 6))
    image[2, 3] = image[0, 0] = 1000.0
    expected = np.zeros((5, 6))
    expected[2, 3], expected[0, 0] = 600.0, 800.0
    expected[[1, 3, 2, 2, 0, 1], [3, 3, 2, 4, 1, 0]] = 100.0
    camera = sized(make(electronic_crosstalk=0.1), image.shape)
    np.testing.assert_allclose(crosstalk.electronic_crosstalk(image, camera), expected, atol=1e-9)


def test_crosstalk_conserves_charge_and_flat_fields(make):
    """Expectation: the sum of any frame stays, border included, down to a single row; an even field does not change;
    a share of 0 gives back the very same array, so that nothing else changes.
    """
    for value in (0.1, "silicon"):
        for shape in ((12, 9), (1, 7), (7, 1), (1, 1)):
            camera = sized(make(electronic_crosstalk=value), shape)
            image = np.random.default_rng(0).uniform(0, 5000, shape)
            spread = crosstalk.electronic_crosstalk(image, camera)
            assert spread.sum() == pytest.approx(image.sum(), rel=1e-12) and spread.min() >= 0
            even = crosstalk.electronic_crosstalk(np.full(shape, 7.0), camera)
            np.testing.assert_allclose(even, 7.0, rtol=1e-12)
    assert crosstalk.electronic_crosstalk(image, sized(make(electronic_crosstalk=0.0), shape)) is image


def test_crosstalk_before_the_shot_noise_is_that_of_single_electrons(make):
    """Rationale: the way of every single electron, drawn after the shot noise, is the brute-force model.

    Set-up: columns of 4,000 and 0 electrons in turn, c = 0.1; each electron stays or goes to one of four neighbours
    by a multinomial draw. Expectation: means, variances and the covariance of neighbours (none) agree.
    A variance of 31,250 pixels is known to 0.8 %; five of these. A covariance's sigma is the variance / sqrt(31,250).
    """
    share, side = 0.1, SIDE
    image = np.zeros((side, side))
    image[:, ::2] = 4000.0
    rng = np.random.default_rng(1)
    ways = rng.multinomial(rng.poisson(image), [1 - 4 * share, *[share] * 4])
    single = ways[..., 0].copy()
    for way, (axis, shift) in enumerate(((0, 1), (0, -1), (1, 1), (1, -1)), start=1):
        single += np.roll(ways[..., way], shift, axis=axis)
    camera = sized(make(electronic_crosstalk=share), image.shape)
    ours = rng.poisson(crosstalk.electronic_crosstalk(image, camera))
    for start in (0, 1):
        columns = np.s_[1:-1, 2 + start : side - 2 : 2]
        assert ours[columns].mean() == pytest.approx(single[columns].mean(), rel=1e-3)
        assert ours[columns].var() == pytest.approx(single[columns].var(), rel=0.04)
    first, second = single[1:-1, 2:-3:2].ravel(), single[1:-1, 3:-2:2].ravel()
    assert abs(np.corrcoef(first, second)[0, 1]) < 5 / np.sqrt(first.size)


# --- by absorption depth -------------------------------------------------------------------------


def test_shares_of_channels_against_the_full_spectra(make):
    """Rationale: pictures hold the electrons of a channel, not their wavelengths.

    Set-up: even patches of the ColorChecker; electrons at each place of the mosaic with the shares of every wavelength,
    and with those of the channels. Expectation: what the docstring states.
    """
    camera = make(electronic_crosstalk="silicon")
    names = sensors.channels(camera.sensor)
    block = np.array([[names.index(name) for name in row] for row in camera.sensor.mosaic])
    spectral, response = sensors.spectral_shares(camera.sensor), radiometry.response(camera)
    area = np.tile(block, (3, 3))

    def at_places(per_channel, edge, corner):
        spread = diffusion.spread(per_channel[area], edge[area], corner[area])[2:4, 2:4]
        return np.array([spread[block == index].mean() for index in range(len(names))])

    channel = crosstalk.channel_shares(camera)
    for light, limits in (("D65", (0.025, 0.032)), ("A", (0.025, 0.015)), ("energy-saving-3500K", (0.025, 0.10))):
        worst = np.zeros(4)
        for patch in colour_checker.PATCHES:
            electrons = response * illuminants.illuminant(light) * colour_checker.curve(patch)
            by_wavelength = [
                at_places(electrons[:, k], *(np.full(4, share[k]) for share in spectral))
                for k in range(electrons.shape[1])
            ]
            full = grid.integrate(np.array(by_wavelength).T)
            worst = np.maximum(worst, np.abs(at_places(grid.integrate(electrons), *channel) / full - 1))
        assert worst[:3].max() < limits[0] and worst[3] < limits[1], light


# --- correction ----------------------------------------------------------------------------------


@pytest.mark.parametrize("value", [0.03, 0.1, "silicon"])
def test_correction_is_the_inverse(make, value):
    """Expectation: electrons before crosstalk, to 1e-5 of the largest times the norm of the inverse, at most
    1 / (1 - 8 e) = 5; a share of 0 changes nothing.
    """
    camera = cameras.cropped(make(electronic_crosstalk=value), 64, 48)
    image = np.random.default_rng(0).uniform(0, 5000, (48, 64))
    back = crosstalk.corrected(crosstalk.electronic_crosstalk(image, camera), camera)
    np.testing.assert_allclose(back, image, atol=5e-5 * 5000)
    plain = cameras.cropped(make(electronic_crosstalk=0.0), 64, 48)
    assert crosstalk.corrected(image, plain) is image


@pytest.mark.parametrize(("name", "value"), [("da-mobile", "silicon"), ("da-mobile", 0.05), ("da-4x4", "silicon")])
def test_noise_gains_are_those_of_corrected_noise(name, value):
    """Set-up: white noise of one spread in all raw pixels. Expectation: after the correction, the variance of each
    channel is larger by its gain. The variance of 32,768 pixels is known to 0.8 %; limit: four of these.
    """
    camera = cameras.cropped(cameras.load_camera(name), 512, 512)
    camera = camera.model_copy(update={"sensor": camera.sensor.model_copy(update={"electronic_crosstalk": value})})
    corrected = crosstalk.corrected(np.random.default_rng(0).standard_normal((512, 512)), camera)
    for channel, gain in enumerate(crosstalk.noise_gains(camera)):
        assert corrected[cameras.mosaic_channels(camera) == channel].var() == pytest.approx(gain, rel=0.032)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"electronic_crosstalk": "much"}, "electronic_crosstalk"),
        ({"electronic_crosstalk": 0.12}, "0.1"),
        ({"depletion_um": 0.0}, "deplete it deeper, or give electronic_crosstalk"),
        ({"silicon_um": 10.0, "depletion_um": 0.5}, "silicon of 10 um that is depleted to depletion_um = 0.5"),
    ],
)
def test_crosstalk_that_cannot_be_undone_is_refused(da_mobile, changes, words):
    with pytest.raises(InputError, match=words) as refused:
        cameras.parse(sensors.Sensor, da_mobile.sensor.model_dump() | changes, "test")
    assert "\n" not in str(refused.value)
