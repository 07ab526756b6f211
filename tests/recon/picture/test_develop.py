"""The picture pipeline of sec. 4 for each kind of mosaic; lens shading; measured crosstalk."""

import dataclasses

import numpy as np
import pytest

import recon
from dasim.base.errors import InputError
from dasim.camera import noise as sensor
from dasim.camera import radiometry, response_curves, specification
from dasim.camera import sensor as sensors
from dasim.camera import specification as cameras
from dasim.camera.crosstalk import electronic_crosstalk
from dasim.spectra import grid, illuminants
from dasim.values import Capture
from recon.picture import colour, develop, field, infrared, mosaic, shading
from tests.support import recon_scenes

CAMERAS = ["da-mobile", "da-4x4", "bayer-mobile"]
SIZE_PX = (128, 96)
TIME_S = 0.01
# A ramp of 10 % over the frame and photon noise of 1,500 electrons and more; the frame's mean is far better known.
FLAT_COLOUR = 0.01
# A digital number is 6 electrons of about 450 in the dimmest corner of the dimmest channel. Without noise neighbours
# are rounded alike: 1.7 electrons rms, 0.4 %, of a block.
SHADING_TOLERANCE = 0.006
# With noise in both: 16 pixels of 300 electrons in a corner of the dimmest channel, 1.5 %, as much again in the fit of
# the flat's own corner; two and a half standard errors. Not undone, a corner is at 0.45.
EVEN_TOLERANCE = 0.05
# Largest spread of the balanced channels over their largest, of a grey. Half a column of the ramp at the clipping edge,
# and noise: a few per cent. Subtracting from clipped values, or keeping them, gives 40 to 60 %.
HIGHLIGHT_CAST = 0.15


def small(name, **changed):
    whole = cameras.load_camera(name)
    camera = cameras.cropped(whole, *SIZE_PX)
    return camera.model_copy(update={"sensor": camera.sensor.model_copy(update=changed)}) if changed else camera


def capture(camera, reflectance, light, *, share=0.8, noise="on", seed=0):
    """A capture of a grey image [h, w] whose value 1 is exposed to ``share`` of the full well in
    the brightest channel.
    """
    signal = grid.integrate(radiometry.response(camera) * illuminants.illuminant(light))
    mean_e = share * camera.sensor.full_well_e * reflectance[..., None] * signal / signal.max()
    raw, _ = sensor.expose(
        electronic_crosstalk(sensor.mosaic(mean_e, camera), camera), camera.sensor, TIME_S, seed, noise=noise
    )
    return Capture(raw, camera, TIME_S, 1.0, seed)


def ramp():
    return np.linspace(0.9, 1.0, SIZE_PX[0])[None, :].repeat(SIZE_PX[1], 0)


@pytest.mark.parametrize("light", ["D65", "A"])
@pytest.mark.parametrize("name", CAMERAS)
def test_grey_is_grey(name, light):
    """Set-up: a noisy grey ramp. Expectation: the white balance identifies the light, and the linear colours after the
    matrix are equal.
    """
    picture = recon.develop(capture(small(name), ramp(), light))
    assert picture.light == light
    linear = (picture.linear_e.reshape(-1, 3) @ picture.matrix.T).mean(axis=0)
    np.testing.assert_allclose(linear / linear[1], 1, atol=FLAT_COLOUR)
    assert (picture.ir_e is None) == (name == "bayer-mobile")
    assert picture.rgb.shape == (SIZE_PX[1], SIZE_PX[0], 3) and picture.rgb.dtype == np.float32


@pytest.mark.parametrize("name", CAMERAS)
def test_both_removals_leave_grey_grey(name):
    camera = small(name)
    settings = recon.PAPER.model_copy(update={"infrared_removal": "matrix"})
    picture = recon.develop(capture(camera, ramp(), "A"), settings)
    linear = (picture.linear_e.reshape(-1, 3) @ picture.matrix.T).mean(axis=0)
    np.testing.assert_allclose(linear / linear[1], 1, atol=FLAT_COLOUR)


@pytest.mark.parametrize("value", [0, 64, 300, 1023])
@pytest.mark.parametrize("name", CAMERAS)
def test_frames_that_hold_nothing_finish(name, value):
    """Black, constant and saturated frames give finite pictures within their range."""
    camera = small(name)
    picture = recon.develop(Capture(np.full(SIZE_PX[::-1], value, np.uint16), camera, TIME_S, 1.0, 0))
    for image in (picture.rgb, picture.linear_e):
        assert np.isfinite(image).all() and image.min() >= 0
    assert picture.rgb.max() <= 1


def test_a_camera_without_infrared_has_no_depth():
    camera = small("bayer-mobile")
    shot = Capture(np.full(SIZE_PX[::-1], 300, np.uint16), camera, TIME_S, 1.0, 0)
    with pytest.raises(InputError, match="no infrared pixels"):
        recon.reconstruct(shot, None)


@pytest.mark.parametrize("name", CAMERAS)
def test_noise_reduction_is_that_of_each_grid(name):
    """On an even field, noise decreases on every pixel of every channel and the mean is unchanged."""
    camera = small(name)
    shot = capture(camera, np.full(SIZE_PX[::-1], 0.5), "D65")
    raw = recon.picture.mosaic.linearise(shot)[0]
    clean = develop.denoised(raw, shot, recon.PAPER)
    index = cameras.mosaic_channels(camera)
    for channel in np.unique(index):
        before, after = raw[index == channel], clean[index == channel]
        assert after.std() < 0.5 * before.std()
        assert abs(after.mean() / before.mean() - 1) < 0.002


# --- saturation ----------------------------------------------------------------------------------


@pytest.mark.parametrize("light", ["D65", "A"])
@pytest.mark.parametrize("name", CAMERAS)
def test_highlights_of_grey_are_grey(name, light):
    """Set-up: a grey ramp up to three times the full well. Expectation: no pink where red is saturated and the others
    are not, nor where all are.
    """
    reflectance = np.linspace(0.2, 3.0, SIZE_PX[0])[None, :].repeat(SIZE_PX[1], 0)
    picture = recon.develop(capture(small(name), reflectance, light))
    linear = np.maximum(picture.linear_e @ picture.matrix.T, 0)
    columns = linear[16:-16].mean(axis=0)  # over the rows: noise of the darkest electrons does not count
    assert (np.ptp(columns, axis=1) / columns.max(axis=1))[8:].max() < HIGHLIGHT_CAST
    brightness = columns.mean(axis=1)
    assert brightness[-1] > 0.9 * brightness.max(), "what is overexposed stays bright"


def test_a_saturated_colour_keeps_its_hue():
    """Saturated red beside weak green and blue is a lower bound, from which red stays red and does not turn white."""
    full = np.array([[[6000.0, 900, 500]]], np.float32)
    clipped = np.array([[[True, False, False]]])
    rows = field.separation(cameras.cropped(small("da-mobile"), 8, 8), "A", recon.PAPER)
    rows = rows._replace(place=np.zeros((1, 1)))
    ir, white = np.full((1, 1), 1500, np.float32), np.array([2.0, 1.0, 0.5, 1.4])
    clean = develop.without_infrared(develop.Demosaiced(full, ir), rows, clipped, white)
    np.testing.assert_allclose(clean, full - 1500 * specification.crosstalk(small("da-mobile")), rtol=1e-5)


def test_infrared_is_removed_alike_in_strips(monkeypatch):
    """Set-up: random channels of which a few are clipped, in strips whose last is cut. Expectation: the same bytes."""
    random = np.random.default_rng(0)
    over_field = field.separation(small("da-mobile"), "D65", recon.PAPER)
    height, width = over_field.place.shape
    image = develop.Demosaiced(*(random.uniform(0, 6000, (height, width, *c)).astype(np.float32) for c in ((3,), ())))
    clipped, white = random.uniform(size=(height, width, 3)) < 0.01, np.array([2.0, 1.0, 0.5, 1.4])
    whole = develop.without_infrared(image, over_field, clipped, white)
    monkeypatch.setattr(develop, "STRIP_PX", 40)
    assert height % 40
    np.testing.assert_array_equal(develop.without_infrared(image, over_field, clipped, white), whole)


# --- infrared ------------------------------------------------------------------------------------


def near_infrared(camera, share=0.5):
    """An even field lit by equal numbers of photons per wavelength from 650 to 810 nm, as LEDs give behind the sensor's
    filter.
    """
    low, high = grid.NEAR_INFRARED_NM
    band = (grid.WAVELENGTH_NM >= low) & (grid.WAVELENGTH_NM <= high)
    curves = sensors.quantum_efficiency(camera.sensor)
    passed = grid.short_pass(camera.sensor.cutoff_nm, camera.sensor.cutoff_width_nm)
    nm = grid.WAVELENGTH_NM[band]
    signal = np.trapezoid((curves * passed)[:, band], nm, axis=-1)
    mean_e = share * camera.sensor.full_well_e * np.ones((*SIZE_PX[::-1], 1)) * signal / signal.max()
    collected_e = electronic_crosstalk(sensor.mosaic(mean_e, camera), camera)
    raw, _ = sensor.expose(collected_e, camera.sensor, TIME_S, 0)
    return Capture(raw, camera, TIME_S, 1.0, 0)


@pytest.mark.parametrize("name", ["da-mobile", "da-4x4"])
def test_measured_crosstalk_is_that_of_the_curves(name):
    """Under light with a flat photon spectrum, crosstalk is the ratio of areas of eq. (8), within five standard errors
    of at least 768 pixels (0.5 %).
    """
    camera = small(name)
    np.testing.assert_allclose(
        infrared.measured_crosstalk(near_infrared(camera)), specification.crosstalk(camera), rtol=5e-3
    )


@pytest.mark.parametrize(("lights", "words"), [((), "lights: is empty"), (("D65", "D56"), "D56")])
def test_lights_that_do_not_exist_are_refused(lights, words):
    with pytest.raises(InputError, match=words):
        recon.develop(capture(small("da-mobile"), ramp(), "D65"), lights=lights)


def test_a_frame_without_light_has_no_white():
    """Set-up: a capture with the lens covered. Expectation: a note that it is too dark, not one on another light."""
    dark = capture(small("da-mobile"), np.zeros(SIZE_PX[::-1]), "D65")
    notes = recon.reconstruct(dark, recon_scenes.bank()).notes
    assert any("too dark" in note for note in notes) and not any("far from every light" in note for note in notes)


def test_measured_crosstalk_is_used():
    camera = small("da-mobile")
    settings = recon.PAPER.model_copy(update={"crosstalk": (0.9, 0.2, 0.1)})
    rows = infrared.separation(camera, "D65", settings)
    np.testing.assert_array_equal(rows, [[1, 0, 0, -0.9], [0, 1, 0, -0.2], [0, 0, 1, -0.1]])


def test_crosstalk_cannot_be_measured_everywhere():
    camera = small("da-mobile")
    with pytest.raises(InputError, match="saturated"):
        infrared.measured_crosstalk(near_infrared(camera, share=2.0))
    with pytest.raises(InputError, match="too little infrared"):
        infrared.measured_crosstalk(near_infrared(camera, share=0.001))
    twin = small("bayer-mobile")
    with pytest.raises(InputError, match="no infrared pixels"):
        infrared.measured_crosstalk(capture(twin, ramp(), "A"))


def test_crosstalk_matrix_separates_disjoint_bands_exactly():
    """If the signals are known mixtures of four disjoint bands, the crosstalk matrix is the inverse of the mixture."""
    nm = grid.WAVELENGTH_NM
    edges = [(400, 496), (496, 590), (590, 648), (652, 810)]
    blue, green, red, ir = (((nm >= low) & (nm <= high)).astype(float) for low, high in edges)
    mixture = 0.5 * np.array([[1, 0, 0, 0.9], [0, 1, 0, 0.2], [0, 0, 1, 0.1], [0.05, 0.02, 0.01, 1]])
    curves = mixture @ np.stack([red, green, blue, ir])
    table = {
        "wavelength_nm": tuple(nm),
        "channels": {name: tuple(curve) for name, curve in zip(grid.CHANNELS, curves, strict=True)},
    }
    camera = small("da-mobile", quantum_efficiency=response_curves.Curves(**table))
    matrix = infrared.crosstalk_matrix(camera, "A")
    visible = 0.5 * np.diag([1.0, 1, 1, 1])
    np.testing.assert_allclose(matrix @ mixture, visible, atol=1e-6)


# --- lens shading --------------------------------------------------------------------------------


def shaded(camera, image, **options):
    return capture(camera, image * fall_off(), "D65", **options)


def fall_off():
    """The cos^4 law of a wide lens, 0.38 in the corners."""
    y, x = np.meshgrid(np.linspace(-1, 1, SIZE_PX[1]), np.linspace(-1, 1, SIZE_PX[0]), indexing="ij")
    return (1 + 0.4 * x**2 + 0.22 * y**2) ** -2


def measured_gain(flat, camera):
    return shading.gain(flat, camera, develop.LIGHTS, colour.signatures(camera, develop.LIGHTS))


@pytest.mark.parametrize("name", CAMERAS)
def test_shading_is_measured(name):
    """Without noise, the measured gain of each channel is 1 over the law."""
    camera = small(name)
    gain = measured_gain(shaded(camera, np.ones(SIZE_PX[::-1]), noise="off"), camera)
    np.testing.assert_allclose(gain, 1 / fall_off(), rtol=SHADING_TOLERANCE)


@pytest.mark.parametrize("name", CAMERAS)
def test_shading_is_undone(name):
    """With noise in picture and flat field, the corners of an even surface come out as bright as its centre."""
    camera = small(name)
    flat = shaded(camera, np.ones(SIZE_PX[::-1]), seed=1)
    shot = shaded(camera, np.full(SIZE_PX[::-1], 0.7), seed=2)
    before, after = (recon.develop(shot, flat=field).linear_e for field in (None, flat))
    corners = [(y, x) for y in (slice(8), slice(-8, None)) for x in (slice(8), slice(-8, None))]
    for image, corner, tolerance in ((before, 0.45, 0.1), (after, 1.0, EVEN_TOLERANCE)):
        middle = image[40:56, 56:72].mean(axis=(0, 1))
        for place in corners:
            np.testing.assert_allclose(image[place].mean(axis=(0, 1)) / middle, corner, atol=tolerance)


@pytest.mark.parametrize(("name", "width", "height"), [("da-mobile", 1088, 1004), ("da-4x4", 1100, 1100)])
def test_the_rest_of_a_flat_is_of_its_last_block(name, width, height):
    """Rationale: a rest of one row has no pixel of some channels."""
    camera = cameras.cropped(cameras.load_camera(name), width, height)
    raw = np.random.default_rng(0).integers(380, 386, (height, width)).astype(np.uint16)
    gain = measured_gain(Capture(raw, camera, TIME_S, 1.0, 0), camera)
    assert gain.min() >= 1 and gain.max() < 1.3  # but for the change of infrared over the field


def test_flats_that_do_not_fit_are_refused():
    camera = small("da-mobile")
    even = np.ones(SIZE_PX[::-1])
    with pytest.raises(InputError, match="mosaic"):
        measured_gain(shaded(small("da-4x4"), even), camera)
    with pytest.raises(InputError, match="saturated"):
        measured_gain(shaded(camera, even, share=2.0), camera)
    with pytest.raises(InputError, match="too dark"):
        measured_gain(shaded(camera, even, share=0.002), camera)
    half = even * (np.arange(SIZE_PX[0]) > 64)
    with pytest.raises(InputError, match="not lit everywhere"):
        measured_gain(shaded(camera, half), camera)
    leaves = even * np.random.default_rng(0).uniform(0.5, 1, (SIZE_PX[1] // 16, SIZE_PX[0] // 16)).repeat(16, 0).repeat(
        16, 1
    )
    with pytest.raises(InputError, match="from a smooth shading"):
        measured_gain(shaded(camera, leaves), camera)
    cut = dataclasses.replace(shaded(camera, even), camera=cameras.cropped(camera, 64, 48))
    with pytest.raises(InputError, match="width_px"):
        measured_gain(cut, camera)
    elsewhere = cameras.cropped(cameras.load_camera("da-mobile"), *SIZE_PX, at_px=(0, 0))
    with pytest.raises(InputError, match="principal_point_px"):
        measured_gain(dataclasses.replace(shaded(camera, even), camera=elsewhere), camera)


def test_noise_of_a_mosaic_with_corrected_shading():
    """Set-up: noise in every pixel, a gain that differs from corner to corner. Expectation: the variance measured."""
    camera = recon_scenes.da_mobile(64, 48)
    random = np.random.default_rng(0)
    gain = np.linspace(1, 3, 64 * 48, dtype=np.float32).reshape(48, 64)
    frames = random.normal(0, 5, (400, 48, 64)).astype(np.float32)
    shaded = np.stack([develop.shaded(frame, gain) for frame in frames])
    plain = {name: np.full((24, 32), 25, np.float32) for name in "RGB"}
    found = develop.shaded_variances(plain, gain, camera)
    for name in "RGB":
        y, x = mosaic.phases(camera)[name]
        np.testing.assert_allclose(found[name], shaded.var(axis=0)[y::2, x::2], rtol=0.4)
        np.testing.assert_allclose(found[name].mean(), shaded.var(axis=0)[y::2, x::2].mean(), rtol=0.02)
    assert develop.shaded_variances(plain, None, camera) is plain
