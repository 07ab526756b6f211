"""Electrons from raw numbers, green replacement and demosaicing."""

import numpy as np
import pytest
import recon_scenes

from dasim import camera as cameras
from dasim import sensor
from dasim.errors import InputError
from dasim.values import Capture
from recon import infrared, mosaic


def with_mosaic(rows, width=64, height=48):
    camera = recon_scenes.da_mobile(width, height)
    return camera.model_copy(update={"sensor": camera.sensor.model_copy(update={"mosaic": rows})})


LAYOUTS = [
    (("G", "R"), ("B", "IR")),
    (("R", "G"), ("IR", "B")),
    (("B", "IR"), ("G", "R")),
    (("IR", "B"), ("R", "G")),
]


def test_linearise_undoes_the_converter():
    """Without noise, electrons come back within half a digital number."""
    camera = recon_scenes.da_mobile(64, 48)
    mean_e = np.random.default_rng(0).uniform(0, 5800, (48, 64))
    raw, _ = sensor.expose(mean_e, camera.sensor, 1e-6, 0, noise="off")
    electrons, saturated = mosaic.linearise(Capture(raw, camera, 1e-6, 1.0, 0))
    assert np.abs(electrons - mean_e).max() <= sensor.electrons_per_dn(camera.sensor) / 2 + 1e-2
    assert not saturated.any()


def test_full_wells_are_marked():
    camera = recon_scenes.da_mobile(64, 48)
    mean_e = np.full((48, 64), 1000.0)
    mean_e[10:20, 10:20] = 20_000
    raw, _ = sensor.expose(mean_e, camera.sensor, 0.01, 0)
    _, saturated = mosaic.linearise(Capture(raw, camera, 0.01, 1.0, 0))
    expected = np.zeros((48, 64), bool)
    expected[10:20, 10:20] = True
    np.testing.assert_array_equal(saturated, expected)


def test_noise_variance_is_that_of_the_sensor():
    """12,288 pixels: the variance is known to 1.3 %; five standard errors."""
    camera = recon_scenes.da_mobile(128, 96)
    for level_e in (20.0, 400.0, 4000.0):
        raw, _ = sensor.expose(np.full((96, 128), level_e), camera.sensor, 0.02, 5)
        capture = Capture(raw, camera, 0.02, 1.0, 5)
        electrons, _ = mosaic.linearise(capture)
        np.testing.assert_allclose(electrons.var(), mosaic.noise_variance(np.array(level_e), capture), rtol=0.065)


@pytest.mark.parametrize(
    "rows",
    [
        (("G", "R"), ("B", "G")),
        (("R", "IR"), ("B", "G")),
        (("G",),),
        (("IR", "G"), ("R", "B"), ("G", "IR"), ("R", "B")),
    ],
)
def test_other_mosaics_are_refused(rows):
    with pytest.raises(InputError, match="2x2 block"):
        mosaic.phases(with_mosaic(rows))


@pytest.mark.parametrize("rows", LAYOUTS)
def test_green_replacement_and_demosaicing_keep_places(rows):
    """G, R and B that differ from a linear infrared by constants: eq. (6) is exact, and so is the demosaic."""
    camera = with_mosaic(rows)
    y, x = np.indices((48, 64), dtype=float)
    ir = 500 + 4 * y + 3 * x
    four = np.stack([ir + 300, ir + 200, ir + 100, ir], axis=-1)
    raw = sensor.mosaic(four, camera).astype(np.float32)
    full_ir = infrared.interpolate(mosaic.planes(raw, camera)["IR"], mosaic.phases(camera)["IR"])
    bayer = mosaic.replace_green(raw, full_ir, camera)
    inner = (slice(8, -8), slice(8, -8))
    place = mosaic.phases(camera)["IR"]
    green = four[..., 1][place[0] :: 2, place[1] :: 2][inner]
    np.testing.assert_allclose(bayer[place[0] :: 2, place[1] :: 2][inner], green, rtol=1e-5)
    rgb = mosaic.demosaic(bayer, camera, np.ones(4))
    np.testing.assert_allclose(rgb[inner], four[..., :3][inner], rtol=2e-3)


def test_a_flat_colour_is_flat_after_demosaicing():
    camera = recon_scenes.da_mobile(64, 48)
    colour = np.array([900.0, 500.0, 200.0, 400.0])
    raw = sensor.mosaic(np.tile(colour, (48, 64, 1)), camera).astype(np.float32)
    bayer = mosaic.replace_green(raw, np.full((48, 64), 400, np.float32), camera)
    rgb = mosaic.demosaic(bayer, camera, np.array([1.5, 1.0, 0.4, 0.8]))
    np.testing.assert_allclose(rgb, np.tile(colour[:3], (48, 64, 1)), rtol=1e-5)


def test_a_picture_of_another_size_is_refused():
    camera = cameras.load_camera("da-mobile")
    with pytest.raises(InputError, match="10 x 8 pixels"):
        mosaic.linearise(Capture(np.zeros((8, 10), np.uint16), camera, 0.01, 1.0, 0))
