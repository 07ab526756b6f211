"""The network of the all-in-focus picture: photographs that it has not seen, mosaics in any position, tiles."""

from __future__ import annotations

import dataclasses
from functools import cache

import numpy as np
import pytest

import recon
from dasim.camera import noise as sensor
from dasim.camera import radiometry, specification
from dasim.camera.crosstalk import electronic_crosstalk
from dasim.camera.rings import at_pixels, rings
from dasim.spectra import grid, illuminants
from dasim.values import Capture, DepthEstimate
from recon.settings import PRESETS
from recon.sharp import all_in_focus, restoration
from tests.support import recon_scenes
from validation.subjects.conditions import quiet_sensor

RIM_PX = 16
WHITE_E = 4000.0
ROUNDING_DN = 0.001  # of sums in single precision, of which 0.0001 are seen; the limit of seams is 0.5


def exact(scene):
    """True colours without infrared, [h, w, 3] electrons."""
    alpha = specification.crosstalk(scene.capture.camera)
    return np.maximum(scene.sharp_e[..., :3] - alpha * scene.sharp_e[..., 3:], 0)


def gains(scene, result):
    """DB per colour."""
    inner, truth = (slice(RIM_PX, -RIM_PX),) * 2, exact(scene)
    errors = [np.mean((image - truth)[inner] ** 2, axis=(0, 1)) for image in (result.linear_e, result.sharp_e)]
    return 10 * np.log10(errors[0] / errors[1])


def stating(level, sd):
    """A method that states one level and its standard deviation for every pixel."""

    def method(capture, bank):
        level_of_all, sd_of_all = (np.full(capture.raw_dn.shape, value, np.float32) for value in (level, sd))
        return DepthEstimate(level=level_of_all, sd=sd_of_all, joined=True)

    return method


def code(electrons):
    """Digital numbers of 8 bits."""
    return 255 * np.clip(electrons / WHITE_E, 0, 1) ** (1 / 2.2)


@cache
def scene(level=4.0, photo="astronaut", white_e=WHITE_E):
    return recon_scenes.make(np.full((160, 192), level), photo=photo, white_e=white_e)


def test_the_weights_state_their_source():
    from importlib.resources import files

    for file in restoration.FILES:
        with np.load(files("recon.sharp").joinpath(file), allow_pickle=False) as stored:
            assert "Own data of the project" in str(stored["about"])


def test_compression_is_undone():
    electrons = np.linspace(-0.5, 20, 99, dtype=np.float32)
    np.testing.assert_allclose(restoration.expanded(restoration.compressed(electrons)), electrons, rtol=1e-4, atol=1e-6)


@pytest.mark.parametrize("photo", ["astronaut", "coffee", "chelsea"])
@pytest.mark.parametrize(("level", "gain"), [(0.0, 0.0), (4.0, 1.0), (12.0, 2.5)])
def test_photographs_gain(photo, level, gain):
    """Set-up: photographs at one level, which the network has never seen; the level is estimated.
    Expectation: every colour gains, in focus, where noise and the interpolation of the mosaic are all there is to
    mend, at 7 px and at 20 px of blur.
    """
    there = scene(level, photo)
    assert gains(there, recon.reconstruct(there.capture, recon_scenes.bank())).min() > gain


def test_a_wrong_level_costs_less_where_the_model_has_an_error(monkeypatch):
    """Set-up: a photograph at level 4 with a tenth of the noise, taken to be at level 7. Expectation: every colour is
    at least 1 dB nearer to the truth than if sensor noise were the only error of the data.
    """
    usual, factor = scene(), 10
    camera = usual.capture.camera
    camera = camera.model_copy(update={"sensor": quiet_sensor(camera.sensor, factor)})
    collected_e = electronic_crosstalk(sensor.mosaic(factor**2 * usual.mean_e.astype(float), camera), camera)
    raw, _ = sensor.expose(collected_e, camera.sensor, 0.02, seed=1)
    there = dataclasses.replace(usual, capture=Capture(raw, camera, 0.02, 1.0, 1), sharp_e=factor**2 * usual.sharp_e)

    wrong = stating(7.0, 0.5)
    ours = gains(there, recon.reconstruct(there.capture, recon_scenes.bank(), method=wrong))
    monkeypatch.setattr(all_in_focus, "MODEL_ERROR", 0.0)
    theirs = gains(there, recon.reconstruct(there.capture, recon_scenes.bank(), method=wrong))
    assert (ours > theirs + 1).all(), (ours, theirs)


@pytest.mark.parametrize("level", [2.0, 4.0])
def test_the_spacing_of_levels_does_not_matter(level):
    """Set-up: a photograph at one depth, and the same bank with every level or every second one. Expectation: the same
    picture; the networks and all thresholds know the blur, not the number of its level.
    """
    shot, bank = scene(level), recon_scenes.bank()
    kept = slice(None, None, 2)
    coarse = dataclasses.replace(
        bank, depth_m=bank.depth_m[kept], blur_px=bank.blur_px[kept], kernel=np.ascontiguousarray(bank.kernel[:, kept])
    )

    fine = recon.reconstruct(shot.capture, bank, method=stating(level, 0.3)).sharp_e
    other = recon.reconstruct(shot.capture, coarse, method=stating(level / 2, 0.15)).sharp_e
    assert np.abs(code(fine) - code(other)).mean() < 0.05, "in 8 bits"


def test_a_surface_in_focus_that_is_taken_to_be_blurred_is_damaged_less(monkeypatch):
    """Set-up: a photograph in focus, estimated at level 2 with confidence. Expectation: part of the captured picture
    stays, so that the error of the colours together is smaller than without it. Red gains 0.16 dB and blue 0.04; green,
    which has most samples, loses 0.01 (mean of six draws of the noise, 0.02 at most).
    """
    shot, wrong = scene(0.0), stating(2.0, 0.2)
    ours = gains(shot, recon.reconstruct(shot.capture, recon_scenes.bank(), method=wrong))
    monkeypatch.setattr(all_in_focus, "CAUTION", 0.0)
    theirs = gains(shot, recon.reconstruct(shot.capture, recon_scenes.bank(), method=wrong))
    assert (ours > theirs - 0.03).all() and ours.mean() > theirs.mean() + 0.03, (ours, theirs)


def test_noise_off_the_axis_is_not_taken_for_detail():
    """Set-up: an even grey surface in a window at 29 degrees, where red has a third of its light and the removal of
    infrared multiplies its noise; in focus, and known to be. Expectation: no colour has more noise than captured.
    """
    camera = specification.cropped("da-mobile", 192, 144, at_px=(1840, 1380))
    angles, place = rings(camera)
    white = np.stack([grid.integrate(radiometry.response(camera, a) * illuminants.illuminant("D65")) for a in angles])
    mean_e = 1200 / white[0].max() * at_pixels(white, place)
    raw, _ = sensor.expose(electronic_crosstalk(sensor.mosaic(mean_e, camera), camera), camera.sensor, 0.02, seed=1)

    shot = Capture(raw, camera, 0.02, 1.0, 1)
    found = recon.reconstruct(shot, recon_scenes.bank(), method=stating(0.0, 0.05))
    inner = (slice(RIM_PX, -RIM_PX),) * 2
    captured, ours = (image[inner].std(axis=(0, 1)) for image in (found.linear_e, found.sharp_e))
    assert (ours < 1.05 * captured).all(), (ours, captured)


def test_less_noise_never_costs_quality():
    """Set-up: the same photograph with 6,000 electrons of white, and with 100 times as many in a sensor that holds
    them. Expectation: relative to white, the all-in-focus picture is nearer to the truth with less noise.
    """
    errors = []
    for well in (1, 100):
        there = scene(4.0)
        camera = there.capture.camera
        larger = camera.sensor.model_copy(update={"full_well_e": 6000.0 * well, "adc_bits": 16})
        camera = camera.model_copy(update={"sensor": larger})
        mean_e = well * electronic_crosstalk(sensor.mosaic(there.mean_e.astype(float), camera), camera)
        raw, _ = sensor.expose(mean_e, camera.sensor, 0.02, 1)
        result = recon.reconstruct(Capture(raw, camera, 0.02, 1.0, 1), recon_scenes.bank())
        inner = (slice(RIM_PX, -RIM_PX),) * 2
        errors.append(np.mean((result.sharp_e / well - exact(there))[inner] ** 2))
    assert errors[1] < errors[0]


def test_pictures_of_several_networks_are_averaged(monkeypatch):
    """Expectation: the mean of compressed pictures, by one network and by the other."""
    picture, phases = aligned()
    networks = restoration.networks()
    both = restoration.restored(picture, phases)
    alone = []
    for net in networks:
        monkeypatch.setattr(restoration, "networks", lambda net=net: (net,))
        alone.append(restoration.restored(picture, phases, count=1))
    one, other, found = (restoration.compressed(image / picture.unit_e[:3]) for image in (*alone, both))
    positive = (np.minimum(one, other) > 0) & (np.maximum(one, other) < restoration.LARGEST)
    np.testing.assert_allclose(found[positive], (one + other)[positive] / 2, atol=1e-3)
    assert np.abs(one - other).max() > 0.01


def aligned():
    """What the network sees of a capture."""
    there = scene()
    seen = []
    original = restoration.restored
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(restoration, "restored", lambda *call: (seen.append(call), original(*call))[1])
        recon.reconstruct(there.capture, recon_scenes.bank())
    return seen[0][:2]


PLACES = [{"G": (0, 0), "R": (0, 1)}, {"G": (1, 0), "R": (0, 0)}, {"G": (0, 1), "R": (0, 0)}]


@pytest.mark.parametrize("phases", PLACES)
def test_tiles_have_no_seams(monkeypatch, phases):
    """Set-up: channels and levels at random, which differ from pixel to pixel more than those of any capture, in a
    frame of an odd size, and tiles of 96 pixels.

    Expectation: the halo holds all that the network sees, so that tiles differ from the whole by rounding; with half a
    halo they do not.
    """
    random = np.random.default_rng(0)
    height, width = 203, 331
    level, sd = random.uniform(0, 20, (height, width)), random.uniform(0.1, 3, (height, width))
    stack, draft = (random.uniform(0, WHITE_E, (4, height, width)).astype(np.float32) for _ in range(2))
    noise_e, white = np.full(4, 30.0), np.full(4, WHITE_E, np.float32)
    seen = restoration.Picture(stack, draft, level.astype(np.float32), sd.astype(np.float32), noise_e, white, False)
    whole = restoration.restored(seen, phases)
    assert np.ptp(code(whole)) > 100
    assert np.abs(code(restoration.restored(seen, phases, 96)) - code(whole)).max() < ROUNDING_DN
    monkeypatch.setattr(restoration, "HALO_PX", 24)
    assert np.abs(code(restoration.restored(seen, phases, 96)) - code(whole)).max() > 10 * ROUNDING_DN


@pytest.mark.parametrize("turned", [False, True])
@pytest.mark.parametrize("shift", [(0, 1), (1, 0), (1, 1)])
def test_the_mosaic_may_begin_with_any_pixel(shift, turned):
    """Set-up: rows or columns of a frame cut off, so that its block begins with another pixel, and its mirror image
    about the diagonal. Expectation: the same picture away from the border.
    """
    picture, phases = aligned()
    whole = restoration.restored(picture, phases)
    top, left = shift
    maps = {name: getattr(picture, name)[..., top:, left:] for name in restoration.MAPS}
    moved = {name: ((y - top) % 2, (x - left) % 2) for name, (y, x) in phases.items()}
    if turned:
        maps = {name: image.swapaxes(-2, -1) for name, image in maps.items()}
        moved = {name: (x, y) for name, (y, x) in moved.items()}
    found = restoration.restored(picture._replace(**maps), moved)
    found = found.swapaxes(0, 1) if turned else found
    inner = (slice(64, -64),) * 2
    np.testing.assert_allclose(found[inner], whole[top:, left:][inner], rtol=1e-3, atol=0.5)


def test_the_prior_of_gradients_is_a_setting():
    """Expectation: of the settings, the prior alone decides which picture is made, and levels differ only as far as
    their steps follow the picture.
    """
    there = scene()
    settings = PRESETS["best"].model_copy(update={"sharpen_prior": "gradients"})
    by_gradients, by_network = (
        recon.reconstruct(there.capture, recon_scenes.bank(), one) for one in (settings, PRESETS["best"])
    )
    np.testing.assert_array_equal(by_gradients.level_raw, by_network.level_raw)
    assert np.abs(by_gradients.level - by_network.level).mean() < 0.1
    np.testing.assert_array_equal(by_gradients.linear_e, by_network.linear_e)
    assert np.abs(by_gradients.sharp_e - by_network.sharp_e).max() > 1
    assert dataclasses.replace(by_network).settings["sharpen_prior"] == "network"
