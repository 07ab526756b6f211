"""A user's own pictures of a point source: files give the same bank as arrays in memory, and one message lists all
mistakes.
"""

from __future__ import annotations

import csv
import dataclasses
import itertools

import numpy as np
import pytest

import recon
from dasim.base.errors import InputError
from dasim.camera import noise, pointspread
from dasim.camera import sensor as sensors
from dasim.camera import specification as cameras
from dasim.camera.crosstalk import electronic_crosstalk
from dasim.files.png import read_png16, write_png16
from dasim.simulation import calibration
from dasim.spectra import illuminants
from dasim.values import Capture, PointPicture
from recon.calibration import source
from recon.files import point_pictures as point_files

LIGHT = "D55"
LEVELS = 3  # with which the tests make do; the camera has 29
# Positions of the source, in pixels from the frame's middle: anywhere.
PLACES = ((0.31, -1.72), (-2.43, 0.64), (1.18, 2.07), (-0.83, -0.26))
# Encircled energy from four positions: the worst channel of six draws of four had 0.014 at the median and 0.026 at most
# (infrared had 0.036 where the background could not be negative), one position up to 0.1.
SCATTERED_ENERGY = 0.025
# Kernels of a window about an off-centre source against those of the whole small frame: the background comes from
# other pixels, and the tail's begin may move by a ring.
WINDOW_ENERGY = 0.01


@pytest.fixture(scope="module")
def camera(da_mobile):
    return cameras.cropped(da_mobile, 64, 48)


@pytest.fixture(scope="module")
def pictures(camera):
    captures = calibration.calibration_captures(camera, (LIGHT,))
    return list(itertools.takewhile(lambda picture: picture.level < LEVELS, captures))


@pytest.fixture(scope="module")
def bank(camera, pictures):
    return recon.calibrate(pictures, camera)


@pytest.fixture
def folder(tmp_path, camera, pictures):
    """A folder with the pictures of the first two levels."""
    point_files.write_point_pictures(tmp_path / "mine", [p for p in pictures if p.level < 2], camera)
    return tmp_path / "mine"


def read(folder, camera):
    return point_files.read_point_pictures(
        folder, camera, *calibration.levels(camera), known_light=illuminants.illuminant
    )


def table(folder):
    with (folder / "captures.csv").open() as file:
        return list(csv.DictReader(file))


def write_table(folder, rows):
    with (folder / "captures.csv").open("w", newline="") as file:
        writer = csv.DictWriter(file, rows[0])
        writer.writeheader()
        writer.writerows(rows)


def encircled(kernel):
    y, x = np.indices(kernel.shape) - len(kernel) // 2
    radius = np.hypot(y, x)
    return np.array([kernel[radius <= r + 1e-3].sum() for r in range(1, len(kernel) // 2 + 1)])


def energy_error(kernel, other):
    size = min(len(kernel), len(other))
    first, second = (k[(len(k) - size) // 2 :][:size, (len(k) - size) // 2 :][:, :size] for k in (kernel, other))
    return np.abs(encircled(first / first.sum()) - encircled(second / second.sum())).max()


def test_a_bank_of_files_is_that_of_memory(tmp_path, camera, pictures, bank):
    """Rationale: the files are lossless: raw values are integers, and the table states its numbers in full.

    Expectation: kernels, white and depths are equal to the last bit.
    """
    point_files.write_point_pictures(tmp_path / "mine", pictures, camera)
    measurement = read(tmp_path / "mine", camera)
    again = recon.calibrate(measurement.pictures, camera)
    for name in ("kernel", "signature", "depth_m"):
        np.testing.assert_array_equal(getattr(again, name), getattr(bank, name))
    np.testing.assert_allclose(again.blur_px, bank.blur_px, atol=1e-6)  # from the depth, float32
    assert again.lights == (LIGHT,) and "signal-to-noise" in measurement.notes[0]


def test_large_frames_with_the_source_aside_and_hot_pixels(tmp_path, camera, pictures, bank):
    """Set-up: the same pictures within frames of 240 x 200 pixels of background, below and to the right of the centre,
    with three hot pixels that hold from a third to all of the electrons, one of them ten pixels from the source. The
    pixels at the border of the small frames are left out: they keep the electrons that those inside lose to others.

    Expectation: the kernels of the small frames; the hot pixels leave no trace.
    """
    rng = np.random.default_rng(1)
    black, per_e = camera.sensor.black_level_dn, 1 / noise.electrons_per_dn(camera.sensor)
    large = []
    for picture in pictures:
        count, side, _ = picture.frames_dn.shape
        frames = np.empty((count, 200, 240))
        for row, column in itertools.product(range(2), range(2)):  # stray light goes on
            edge = picture.frames_dn[:, row::2, column::2][:, [1, -2], 1:-1]
            frames[:, row::2, column::2] = rng.choice(edge.ravel(), (count, 100, 120))
        frames[:, 100 : 96 + side, 122 : 118 + side] = picture.frames_dn[:, 2:-2, 2:-2]
        for place, electrons in (((98 + side // 2 + 10, 120 + side // 2), 6000), ((3, 9), 6000), ((101, 30), 2000)):
            frames[(slice(None), *place)] = black + electrons * per_e
        large.append(dataclasses.replace(picture, frames_dn=np.clip(np.rint(frames), 0, 1023).astype(np.uint16)))
    wide = cameras.cropped(cameras.load_camera("da-mobile"), 240, 200)
    point_files.write_point_pictures(tmp_path / "mine", large, wide)
    measured_bank = recon.calibrate(read(tmp_path / "mine", wide).pictures, wide)
    for level, channel in itertools.product(range(LEVELS), range(4)):
        assert energy_error(measured_bank.kernel[0, level, channel], bank.kernel[0, level, channel]) < WINDOW_ENERGY


def anywhere(camera, level, places, exposures, side=60):
    """Pictures, in several exposures, of a source of constant brightness at places (y, x) in pixels from the centre."""
    depths, blurs = calibration.levels(camera)
    local = cameras.cropped(cameras.load_camera(camera.name), side, side)
    local = local.model_copy(update={"sensor": camera.sensor.model_copy(update={"width_px": side, "height_px": side})})
    at = pointspread.kernels(camera, blurs[: level + 1], illuminants.illuminant(LIGHT), side - 1, "wave")
    kernel, signal = at(level, (0.0, 0.0), ...)
    brightest = (kernel * signal[:, None, None]).max()
    for number, place in enumerate(places):
        whole = np.rint(place).astype(int)
        kernel, signal = at(level, tuple(np.array(place) - whole), ...)
        flux = np.zeros((side, side, 4))
        flux[:-1, :-1] = np.moveaxis(kernel * signal[:, None, None], 0, -1) / brightest
        mean_e = 0.8 * noise.saturation_e(local.sensor, max(gain for _, gain in exposures))
        mean_e = electronic_crosstalk(mean_e * (noise.mosaic(np.roll(flux, whole, axis=(0, 1)), local) + 1e-3), local)
        for step, (times, gain) in enumerate(exposures):
            frames = [
                noise.expose(times * mean_e, local.sensor, 0.01 * times, 3, gain=gain, frame=100 * number + shot)[0]
                for shot in (10 * step, 10 * step + 1)
            ]
            yield PointPicture(
                np.stack(frames), LIGHT, level, float(depths[level]), float(blurs[level]), None, 0.01 * times, gain,
                f"place {number}",
            )  # fmt: skip


@pytest.mark.slow
def test_a_source_that_stood_anywhere(tmp_path, camera):
    """Rationale: nobody moves a pinhole by whole pixels.

    Set-up: four irregular places, two levels and two frames of each exposure; at the second level one exposure has
    twice the gain.

    Expectation: the camera's own kernels, in encircled energy, for every channel; a single place gives a note that
    there are too few.
    """
    exposures = (((64.0, 1.0), (1.0, 1.0)), ((64.0, 1.0), (2.0, 1.0), (1.0, 2.0)))
    photos = [p for level in range(2) for p in anywhere(camera, level, PLACES, exposures[level])]
    point_files.write_point_pictures(tmp_path / "mine", photos, camera)
    measurement = read(tmp_path / "mine", camera)
    assert len(measurement.notes) == 1
    bank = recon.calibrate(measurement.pictures, camera)
    for level, channel in itertools.product(range(2), sensors.channels(camera.sensor)):
        measured = bank.kernel[0, level, sensors.channels(camera.sensor).index(channel)]
        true = pointspread.psf(camera, float(bank.depth_m[level]), channel, LIGHT, size=len(measured))
        assert energy_error(measured, true) < SCATTERED_ENERGY, (level, channel)
    few = [p for p in photos if p.position == "place 1"]
    point_files.write_point_pictures(tmp_path / "few", few, camera)
    assert "1 position of the source" in read(tmp_path / "few", camera).notes[1]


def capture_of(picture, camera):
    height, width = picture.frames_dn.shape[1:]
    sized = cameras.cropped(cameras.load_camera(camera.name), width, height)
    return Capture(picture.frames_dn[0], sized, picture.exposure_s, picture.gain, 0)


def test_a_wide_blur_is_found_in_every_exposure(camera):
    """Set-up: the widest blur in a frame that is hardly larger; the longest exposure is saturated over all of it.

    Expectation: no exposure is refused, and the window, whose sides are multiples of the mosaic's period, contains the
    source.
    """
    photos = list(anywhere(camera, 28, [(3.4, -2.2)], ((256.0, 1.0), (16.0, 1.0), (1.0, 1.0)), side=84))
    captures = [capture_of(picture, camera) for picture in photos]
    for capture in captures:
        source.check(capture, capture.camera, photos[0].blur_px, shortest=capture is captures[-1])
    rows, columns = source.window(captures, captures[0].camera, photos[0].blur_px, 36)
    for span, at in ((rows, 41 + 3.4), (columns, 41 - 2.2)):
        assert span.stop - span.start == 72 and span.start % 2 == 0
        assert abs((span.start + span.stop - 1) / 2 - at) < 2  # the mosaic's period


@pytest.mark.parametrize("light_e", [300.0, 3000.0])
def test_uneven_light_is_no_source(light_e):
    """Set-up: an even surface whose corners receive 60 % of the light of its centre; then a point of 4 x 4 pixels on
    it.

    Expectation: the surface alone is refused; the point is located in front of the dimmer surface, and reported as
    saturated in front of the full one.
    """
    wide = cameras.cropped(cameras.load_camera("da-mobile"), 240, 200)
    y, x = np.indices((200, 240)) - np.array([100, 120])[:, None, None]
    even_e = light_e * (1 - 0.4 * (y**2 + x**2) / (100**2 + 120**2))

    def check(point_e):
        mean_e = even_e.copy()
        mean_e[60:64, 71:75] += point_e
        raw, _ = noise.expose(mean_e, wide.sensor, 0.01, 1)
        source.check(Capture(raw, wide, 0.01, 1.0, 0), wide, 0.0, shortest=True)

    with pytest.raises(InputError, match="shows no point source"):
        check(0.0)
    if light_e < 1000:
        check(4000.0)
        with pytest.raises(InputError, match="16 pixels are saturated in the shortest exposure"):
            check(9000.0)


def test_all_problems_are_in_one_message(folder, camera):
    """Expectation: one line that names each faulty file with its own fault, and no other file."""
    rows = table(folder)
    short = [row for row in rows if row["exposure_s"] == "0.01"]
    dark, full, small, cut = (folder / row["file"] for row in (short[0], short[1], short[2], short[3]))
    shape = read_png16(dark).shape
    write_png16(dark, np.random.default_rng(0).normal(64, 1, shape).astype(np.uint16))
    bright = read_png16(full).astype(int)
    write_png16(full, np.minimum(64 + 3 * (bright - 64), 1023).astype(np.uint16))
    cut.write_bytes(cut.read_bytes()[:-200])
    rows[-1]["file"] = rows[-2]["file"]
    rows[-3]["light"] = "D55-lamp"
    rows[-4]["depth_m"] = "0.36"
    rows[-5]["exposure_s"] = "-1"
    rows[-6]["shift_x_px"] = "half"
    rows[-7]["file"] = "none.png"
    write_table(folder, rows)
    with pytest.raises(InputError) as refused:
        read(folder, camera)
    message = str(refused.value)
    for part in (
        "occurs twice", "D55-lamp", "depth_m 0.36 is not the distance of a level", "0.4, 0.3151", "exposure_s '-1'",
        "must be whole numbers", "none.png: no such file", f"{short[0]['file']}: ", "saturated in the shortest",
        "truncated",
    ):  # fmt: skip
        assert part in message, (part, message)
    assert "\n" not in message and small.name not in message


def spoil(rows, case):
    if case == "level":
        return [row for row in rows if row["depth_m"] == "0.4"]
    if case == "gap":
        return [row | {"depth_m": "0.2599"} if row["depth_m"] != "0.4" else row for row in rows]
    if case == "depths":
        return [row | ({"depth_m": "0.316"} if row["depth_m"] != "0.4" and n % 2 else {}) for n, row in enumerate(rows)]
    if case == "lights":
        return [row | ({"light": "A"} if row["depth_m"] != "0.4" and n % 2 else {}) for n, row in enumerate(rows)]
    if case == "column":
        return [row | {"colour": "red"} for row in rows]
    if case == "both":
        return [row | {"position": "here"} for row in rows]
    return [{key: value for key, value in row.items() if key != "light"} for row in rows]


@pytest.mark.parametrize(
    ("case", "message"),
    [
        ("level", "two levels or more"),
        ("gap", "D55 has no pictures of level 1"),
        ("depths", "level 1 has the depths"),
        ("lights", "A has no pictures of level 0"),
        ("column", "unknown column 'colour'"),
        ("both", "give position, or shift_x_px"),
        ("no column", "no column 'light'"),
    ],
)
def test_tables_that_do_not_make_a_bank(folder, camera, case, message):
    write_table(folder, spoil(table(folder), case))
    with pytest.raises(InputError, match=message) as refused:
        read(folder, camera)
    assert "\n" not in str(refused.value) and "mine" in str(refused.value)


def test_a_folder_without_table_and_frames_of_two_sizes(folder, camera):
    rows = table(folder)
    write_png16(folder / rows[0]["file"], read_png16(folder / rows[0]["file"])[:-2])
    with pytest.raises(InputError, match="have different sizes"):
        read(folder, camera)
    (folder / "captures.csv").unlink()
    with pytest.raises(InputError, match=r"no table captures\.csv"):
        read(folder, camera)


def test_light_that_drowns_in_noise_is_no_source(folder, camera):
    """Set-up: a picture whose infrared pixels receive no light. Expectation: the message names the channel."""
    for row in table(folder):
        raw = read_png16(folder / row["file"])
        raw[1::2, 1::2] = camera.sensor.black_level_dn
        write_png16(folder / row["file"], raw)
    with pytest.raises(InputError, match="IR has a signal-to-noise ratio"):
        read(folder, camera)
