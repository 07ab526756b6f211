"""Electrons from raw values, green replacement and demosaicing."""

import warnings

import numpy as np
import pytest

from dasim.base.errors import InputError
from dasim.camera import noise
from dasim.camera import sensor as sensors
from dasim.camera import specification as cameras
from dasim.camera.crosstalk import electronic_crosstalk
from dasim.spectra.grid import CHANNELS as sensor_names
from dasim.values import Capture
from recon.picture import infrared, menon, mosaic
from tests.support import recon_scenes


def with_mosaic(rows, width=64, height=48):
    camera = recon_scenes.da_mobile(width, height)
    return camera.model_copy(update={"sensor": camera.sensor.model_copy(update={"mosaic": rows})})


LAYOUTS = [
    (("G", "R"), ("B", "IR")),
    (("R", "G"), ("IR", "B")),
    (("B", "IR"), ("G", "R")),
    (("IR", "B"), ("R", "G")),
]

BAYER = [(("G", "R"), ("B", "G")), (("R", "G"), ("G", "B")), (("B", "G"), ("G", "R"))]
SPARSE = (("G", "IR", "G", "IR"), ("R", "G", "B", "G"), ("G", "IR", "G", "IR"), ("B", "G", "R", "G"))
SPARSE_LAYOUTS = [SPARSE, tuple(row[::-1] for row in SPARSE), SPARSE[1:] + SPARSE[:1], tuple(zip(*SPARSE, strict=True))]
RGB_IR_LAYOUTS = LAYOUTS + SPARSE_LAYOUTS
ALL_LAYOUTS = RGB_IR_LAYOUTS + BAYER
POINT = (24.3, 31.7)
REGISTRATION_PX = 0.02


def test_linearise_undoes_the_converter():
    """Without noise, electrons are recovered within half a digital number, times 1 / (1 - 2 s) for the correction of
    crosstalk, with s = 10 % leaving a pixel at most (the norm of the inverse).
    """
    camera = recon_scenes.da_mobile(64, 48)
    mean_e = np.random.default_rng(0).uniform(0, 5300, (48, 64))
    raw, _ = noise.expose(electronic_crosstalk(mean_e, camera), camera.sensor, 1e-6, 0, noise="off")
    electrons, saturated = mosaic.linearise(Capture(raw, camera, 1e-6, 1.0, 0))
    assert np.abs(electrons - mean_e).max() <= noise.electrons_per_dn(camera.sensor) / 2 / 0.8 + 2e-2
    assert not saturated.any()


def test_full_wells_are_marked():
    camera = recon_scenes.da_mobile(64, 48)
    mean_e = np.full((48, 64), 1000.0)
    mean_e[10:20, 10:20] = 20_000
    raw, _ = noise.expose(mean_e, camera.sensor, 0.01, 0)
    _, saturated = mosaic.linearise(Capture(raw, camera, 0.01, 1.0, 0))
    expected = np.zeros((48, 64), bool)
    expected[10:20, 10:20] = True
    np.testing.assert_array_equal(saturated, expected)


def test_noise_variance_is_that_of_the_sensor():
    """Limit: five standard errors; the variance of 12,288 pixels of a channel is known to 1.3 %."""
    camera = recon_scenes.da_mobile(256, 192)
    for level_e in (20.0, 400.0, 4000.0):
        mean_e = electronic_crosstalk(np.full((192, 256), level_e), camera)
        raw, _ = noise.expose(mean_e, camera.sensor, 0.02, 5)
        capture = Capture(raw, camera, 0.02, 1.0, 5)
        electrons, _ = mosaic.linearise(capture)
        for name, plane in mosaic.planes(electrons, camera).items():
            expected = mosaic.noise_variance(capture, name).at(mosaic.planes(mean_e, camera)[name].mean())
            assert plane.var() == pytest.approx(expected, rel=0.065)


@pytest.mark.parametrize(
    "rows",
    [
        (("G", "G"), ("B", "R")),
        (("R", "IR"), ("B", "G")),
        (("G",),),
        (("G", "R", "B"), ("B", "G", "R")),
        (("G", "IR", "G", "IR"), ("R", "G", "B", "G"), ("G", "IR", "G", "IR"), ("R", "G", "B", "G")),
        (("IR", "G", "IR", "G"), ("R", "G", "B", "G"), ("IR", "G", "IR", "G"), ("B", "G", "R", "G")),
        (("IR", "G"), ("R", "B"), ("G", "IR"), ("R", "B")),
    ],
)
def test_other_mosaics_are_refused(rows):
    with pytest.raises(InputError, match="2x2 block"):
        mosaic.phases(with_mosaic(rows))


def colours(four, camera, white=(1, 1, 1, 1)):
    """Full-resolution colours [h, w, 3] and infrared, if any, of a picture [h, w, 4] sampled by the camera's mosaic."""
    names = sensors.channels(camera.sensor)
    index = [sensor_names.index(name) for name in names]
    raw = noise.mosaic(four[..., index], camera).astype(np.float32)
    planes, phases = mosaic.planes(raw, camera), mosaic.phases(camera)
    ir = infrared.interpolate(planes["IR"], phases["IR"]) if "IR" in planes else None
    bayer = mosaic.to_bayer(raw, ir, camera, np.array(white, float))
    return mosaic.demosaic(bayer, camera, np.array(white, float)), ir


@pytest.mark.parametrize("rows", ALL_LAYOUTS)
def test_every_pixel_of_the_mosaic_has_its_place(rows):
    """The grids of the channels cover each pixel once, each with the channel of its grid."""
    camera = with_mosaic(rows)
    names = sensors.channels(camera.sensor)
    channel = np.full((48, 64), -1)
    for name, rows_columns in mosaic.grids(camera).items():
        assert (channel[mosaic.sites(rows_columns, channel.shape)] == -1).all()
        channel[mosaic.sites(rows_columns, channel.shape)] = names.index(name)
    np.testing.assert_array_equal(channel, cameras.mosaic_channels(camera))


@pytest.mark.parametrize("rows", ALL_LAYOUTS)
def test_colours_that_differ_by_constants_come_back(rows):
    """Where G, R and B differ from a linear infrared by constants, eq. (6) and the demosaicing are exact."""
    y, x = np.indices((48, 64), dtype=float)
    ir = 500 + 4 * y + 3 * x
    four = np.stack([ir + 200, ir + 300, ir + 100, ir], axis=-1)
    rgb, _ = colours(four, with_mosaic(rows))
    inner = (slice(8, -8), slice(8, -8))
    np.testing.assert_allclose(rgb[inner], four[..., :3][inner], rtol=2e-3)


@pytest.mark.parametrize("rows", LAYOUTS)
def test_green_replacement_keeps_places(rows):
    """Where green differs from a linear infrared by a constant, eq. (6) is exact."""
    camera = with_mosaic(rows)
    y, x = np.indices((48, 64), dtype=float)
    ir = 500 + 4 * y + 3 * x
    raw = noise.mosaic(np.stack([ir + 200, ir + 300, ir + 100, ir], axis=-1), camera).astype(np.float32)
    bayer = mosaic.replace_green(raw, ir.astype(np.float32), camera)
    py, px = mosaic.phases(camera)["IR"]
    inner = slice(8, -8)
    np.testing.assert_allclose(bayer[py::2, px::2][inner, inner], (ir + 300)[py::2, px::2][inner, inner], rtol=1e-5)


@pytest.mark.parametrize("rows", ALL_LAYOUTS)
def test_a_flat_colour_is_flat_after_demosaicing(rows):
    """A constant colour stays constant up to the frame's borders, also if the mosaic is balanced for another white."""
    four = np.tile([900.0, 500.0, 200.0, 400.0], (48, 64, 1))
    rgb, _ = colours(four, with_mosaic(rows), (1.5, 1.0, 0.4, 0.8))
    np.testing.assert_allclose(rgb, four[..., :3], rtol=1e-5)


@pytest.mark.parametrize("pattern", ["RGGB", "BGGR", "GRBG", "GBRG"])
def test_demosaicing_is_that_of_colour_demosaicing(pattern):
    """Set-up: a photograph with noise in a Bayer mosaic, against the library's own implementation of Menon et al.
    Expectation: the same colours, but for rounding. Where both directions are alike to rounding, the other one may be
    chosen, which changes about 30 pixels; fewer than five such places.
    """
    import skimage.data

    with warnings.catch_warnings():  # it imports from a deprecated namespace of SciPy
        warnings.simplefilter("ignore", DeprecationWarning)
        from colour_demosaicing import demosaicing_CFA_Bayer_Menon2007

    photo = skimage.data.astronaut()[100:260, 60:300].astype(np.float32) * 4
    bayer = np.random.default_rng(0).normal(0, 20, photo.shape[:2]).astype(np.float32)
    for place, letter in enumerate(pattern):
        y, x = divmod(place, 2)
        bayer[y::2, x::2] += photo[y::2, x::2, "RGB".index(letter)]
    result = menon.demosaic(bayer, divmod(pattern.index("R"), 2))
    inner = (slice(menon.REACH_PX, -menon.REACH_PX),) * 2
    difference = np.abs(result - demosaicing_CFA_Bayer_Menon2007(bayer.astype(float), pattern)).max(axis=-1)[inner]
    assert np.ptp(result[inner]) > 500
    assert (difference > 1e-2).sum() < 5 * 30


def test_strips_leave_no_seams(monkeypatch):
    """White noise, the hardest texture, demosaiced in strips equals that demosaiced in one piece, up to float32
    rounding.
    """
    camera = with_mosaic(BAYER[0])
    raw = np.random.default_rng(2).uniform(0, 1000, (48, 64)).astype(np.float32)
    whole = mosaic.demosaic(raw, camera, np.ones(3))
    monkeypatch.setattr(mosaic, "STRIP_PX", 10)
    np.testing.assert_allclose(mosaic.demosaic(raw, camera, np.ones(3)), whole, rtol=1e-6, atol=1e-3)


def blob(y, x):
    """A smooth point, 3 px wide, at a sub-pixel position."""
    return np.exp(-((y - POINT[0]) ** 2 + (x - POINT[1]) ** 2) / (2 * 3.0**2))


def edge(y, x):
    """A smooth slanted edge through the same position."""
    return 0.5 + 0.5 * np.tanh((x - POINT[1] + 0.2 * (y - POINT[0])) / 3.0)


def place_of_blob(image):
    """Centre of mass of an image that is zero outside its blob."""
    y, x = np.indices(image.shape)
    return np.array([(image * y).sum(), (image * x).sum()]) / image.sum()


def place_of_edge(image):
    """Mean over the central rows of the position where each crosses one half, projected to the row of the point."""
    rows = np.arange(16, 32)
    crossing = []
    for row in rows:
        first = int(np.argmax(image[row] > 0.5))
        low, high = image[row, first - 1], image[row, first]
        crossing.append(first - 1 + (0.5 - low) / (high - low) + 0.2 * (row - POINT[0]))
    return np.array([np.mean(crossing)])


@pytest.mark.parametrize("shift", [(0.0, 0.0), (0.3, 0.7), (0.5, 0.5)])
@pytest.mark.parametrize("what", ["blob", "edge"])
@pytest.mark.parametrize("rows", ALL_LAYOUTS)
def test_the_channels_lie_on_each_other(rows, what, shift, monkeypatch):
    """One smooth picture, with a different brightness in every channel, comes out of the mosaic at the same position in
    each.

    A half-pixel offset of a plane would show as 0.5 px. The exact position is known, so that a common shift is detected
    too.
    """
    monkeypatch.setattr(f"{__name__}.POINT", (24.0 + shift[0], 31.0 + shift[1]))
    picture, place = (blob, place_of_blob) if what == "blob" else (edge, place_of_edge)
    image = picture(*np.indices((48, 64), dtype=float))
    white = np.array([0.8, 1.0, 0.5, 0.3])
    rgb, ir = colours(image[..., None] * white * 1000, with_mosaic(rows), white)
    channels = [*np.moveaxis(rgb, -1, 0), *([] if ir is None else [ir])]
    position = np.array(POINT) if what == "blob" else np.array(POINT)[1:]
    for channel, brightness in zip(channels, white, strict=False):
        np.testing.assert_allclose(place(channel / (1000 * brightness)), position, atol=REGISTRATION_PX)


@pytest.mark.parametrize("name", ["R", "G", "B", "IR"])
@pytest.mark.parametrize("rows", RGB_IR_LAYOUTS)
def test_each_plane_is_interpolated_to_its_place(rows, name):
    """The bicubic interpolation of sec. 4.2 alone, of half-resolution planes with their own phases."""
    camera = with_mosaic(rows)
    raw = blob(*np.indices((48, 64), dtype=float)).astype(np.float32)
    full = infrared.interpolate(mosaic.planes(raw, camera)[name], mosaic.phases(camera)[name])
    np.testing.assert_allclose(place_of_blob(full), POINT, atol=REGISTRATION_PX)


def test_a_picture_of_another_size_is_refused():
    camera = cameras.load_camera("da-mobile")
    with pytest.raises(InputError, match="10 x 8 pixels"):
        mosaic.linearise(Capture(np.zeros((8, 10), np.uint16), camera, 0.01, 1.0, 0))
