"""Calibration pictures: light, place and exposure of a point source through the sensor model."""

from __future__ import annotations

import numpy as np
import pytest

from dasim.camera import geometry, noise, radiometry
from dasim.camera import specification as cameras
from dasim.camera.crosstalk import corrected
from dasim.simulation.calibration import EXPOSURE_S, EXPOSURES, FRAMES, calibration_captures
from dasim.spectra import grid, illuminants

LEVEL = 10  # a disc 18.5 px across in the visible: 270 pixels, of which every channel sees a quarter
PLACE_LIMIT_PX = 0.35  # of a centroid from every second pixel, PRNU and shot noise
CHARGE_LIMIT = 0.01  # 1 % PRNU over 270 pixels is 0.06 %, the dark signal 0.1 %; spectra are summed on another grid


@pytest.fixture(scope="module")
def pictures(da_mobile):
    """One light, all levels and positions, geometric kernels, automatic exposure: {(level, shift): picture}."""
    captures = list(calibration_captures(cameras.cropped(da_mobile, 64, 48), ("A",), seed=4, diffraction="off"))
    assert len(captures) == 29 * 4 * len(EXPOSURES)
    return {(picture.level, picture.shift_px): picture for picture in captures if picture.exposure_s == EXPOSURE_S}


def signal(picture, camera) -> np.ndarray:
    return picture.frames_dn.mean(axis=0) - camera.sensor.black_level_dn


def shortest(pictures):
    return next(picture for picture in pictures if picture.exposure_s == EXPOSURE_S)


def channel_at(shape, camera) -> np.ndarray:
    block = [[grid.CHANNELS.index(name) for name in row] for row in camera.sensor.mosaic]
    return np.tile(block, (shape[0] // 2, shape[1] // 2))


def test_pictures_are_taken_at_their_place_of_the_sensor(da_mobile):
    """Expectation: the sensor's window, whose fixed pattern is in the pictures, lies within 32 periods of the mosaic of
    the stated place of the field, on its own side of the axis.
    """
    places = []

    def model(mean_e, sensor, time_s, seed, gain):
        x, y = sensor.principal_point_px
        places.append((sensor.width_px / 2 - x, sensor.height_px / 2 - y))
        return np.zeros(mean_e.shape, np.uint16), 0

    next(iter(calibration_captures(da_mobile, ("A",), diffraction="off", noise=model, field_px=(700, -500))))
    assert np.abs(np.array(places) - (700, -500)).max() <= 2 * 32 + 2


def test_each_level_and_position_of_the_mosaic_is_taken_once(da_mobile, pictures):
    shifts = {shift for _, shift in pictures}
    assert shifts == {(0, 0), (0, 1), (1, 0), (1, 1)}
    depths = [pictures[level, (0, 0)].depth_m for level in range(29)]
    assert depths[0] == pytest.approx(da_mobile.lens.focus_distance_m)
    assert (np.diff(depths) < 0).all(), "levels come nearer"
    for level, blur in enumerate(geometry.level_blur_px(da_mobile)):
        picture = pictures[level, (1, 0)]
        assert picture.blur_px == pytest.approx(blur) and picture.light == "A"
        assert picture.frames_dn.shape[0] == FRAMES
        assert picture.frames_dn.dtype == np.uint16


def test_charge_of_the_channels_is_that_of_the_light(da_mobile, pictures):
    """Rationale: calibration recovers white balance from the pictures alone.

    Set-up: over the four positions every channel sees every part of the kernel, so its numbers sum to its light, once
    the crosstalk between pixels is taken back.
    Expectation: relative to green, the integral of illuminant times response, on a grid of 1 nm.
    """
    total = np.zeros(4)
    for shift in ((0, 0), (0, 1), (1, 0), (1, 1)):
        values = signal(pictures[LEVEL, shift], da_mobile)
        size = {"width_px": values.shape[1], "height_px": values.shape[0]}
        local = da_mobile.model_copy(update={"sensor": da_mobile.sensor.model_copy(update=size)})
        values, channels = corrected(values, local), channel_at(values.shape, da_mobile)
        total += [values[channels == index].sum() for index in range(4)]
    nm = np.arange(400.0, 830.5, 1.0)
    light = np.interp(nm, grid.WAVELENGTH_NM, illuminants.illuminant("A"))
    electrons = np.array([np.interp(nm, grid.WAVELENGTH_NM, row) @ light for row in radiometry.response(da_mobile)])
    np.testing.assert_allclose(total / total[1], electrons / electrons[1], rtol=CHARGE_LIMIT)


def test_the_source_moves_by_whole_pixels(da_mobile, pictures):
    """Expectation: each channel's centroid moves down by shift y and right by shift x; the same unknown rest within
    half a pixel of the frame's centre for all positions.
    """
    places = {}
    for shift in ((0, 0), (0, 1), (1, 0), (1, 1)):
        values = signal(pictures[LEVEL, shift], da_mobile)
        green = np.where(channel_at(values.shape, da_mobile) == 1, values, 0.0)
        green = np.where(green > 0.2 * green.max(), green, 0.0)
        y, x = np.indices(values.shape)
        places[shift] = np.array([(green * y).sum(), (green * x).sum()]) / green.sum()
    middle = (pictures[LEVEL, (0, 0)].frames_dn.shape[1] - 1) // 2
    for shift, place in places.items():
        np.testing.assert_allclose(place - places[0, 0], shift, atol=PLACE_LIMIT_PX)
        assert (np.abs(place - middle - shift) < 0.5 + PLACE_LIMIT_PX).all()


def test_exposure_is_at_85_percent_of_full_scale(da_mobile, pictures):
    """Expectation: over all positions the brightest pixel has 85 % of full scale, to 1 % of PRNU and the noise."""
    for level in (0, LEVEL, 28):
        brightest = max(signal(pictures[level, shift], da_mobile).max() for shift in ((0, 0), (0, 1), (1, 0), (1, 1)))
        full_scale = 2**da_mobile.sensor.adc_bits - 1 - da_mobile.sensor.black_level_dn
        assert brightest / full_scale == pytest.approx(noise.Exposure().auto_level, rel=0.05)


def test_frames_differ_and_seeds_repeat(da_mobile, pictures):
    """Expectation: the same seed gives the same bytes; frames have their own shot noise; another seed moves the
    source.
    """
    small = cameras.cropped(da_mobile, 64, 48)
    again = shortest(calibration_captures(small, ("A",), seed=4, diffraction="off"))
    np.testing.assert_array_equal(again.frames_dn, pictures[0, (0, 0)].frames_dn)
    assert (again.frames_dn[0] != again.frames_dn[1]).mean() > 0.3
    other = shortest(calibration_captures(small, ("A",), seed=5, diffraction="off"))
    assert (other.frames_dn != again.frames_dn).mean() > 0.3


@pytest.mark.parametrize("centre", [(0.54, 0.0), (-0.3, -0.4)])
def test_frames_hold_the_pictures_of_displaced_stops(da_mobile, centre):
    """Set-up: the hole moved to the rim of the lens, one light, geometric kernels. Expectation: infrared's centroid
    lies at -rho c / 2 from the frame's middle, to the point's own place of half a pixel, and what lies on the frame's
    outermost pixels is the stray background and noise: the picture is inside.
    """
    hole = da_mobile.stops[1].model_copy(update={"centre_ratio": centre})
    camera = cameras.cropped(da_mobile.model_copy(update={"stops": (da_mobile.stops[0], hole)}), 64, 48)
    pictures = {}
    for picture in calibration_captures(camera, ("A",), frames=2, seed=4, diffraction="off"):
        if picture.exposure_s != EXPOSURE_S:
            continue
        pictures[picture.level, picture.shift_px] = picture
    infrared = grid.CHANNELS.index("IR")
    for level in (0, 14, 28):
        place, total, rim = np.zeros(2), 0.0, []
        brightest = max(signal(pictures[level, shift], camera).max() for shift in ((0, 0), (0, 1), (1, 0), (1, 1)))
        for dy, dx in ((0, 0), (0, 1), (1, 0), (1, 1)):
            values = signal(pictures[level, (dy, dx)], camera)
            here = channel_at(values.shape, camera) == infrared
            background = np.median(values[here])
            light = np.where(here, values - background, 0.0)
            light[light < 0.03 * brightest] = 0.0
            y, x = np.indices(values.shape)
            middle = (len(values) - 2) / 2  # kernels fill all but the last row and column
            place += [(light * (y - dy - middle)).sum(), (light * (x - dx - middle)).sum()]
            total += light.sum()
            rim += [light[:2].max(), light[-2:].max(), light[:, :2].max(), light[:, -2:].max()]
        blur = pictures[level, (0, 0)].blur_px
        np.testing.assert_allclose((place / total)[::-1], -np.array(centre) * blur / 2, atol=0.5 + PLACE_LIMIT_PX)
        assert max(rim) == 0


def test_a_noise_model_of_ones_own_makes_the_pictures(da_mobile):
    """Expectation: it is called once per frame, with a seed of its own, and its numbers are the frames; the pictures
    have no fingerprint, so that their bank is not cached.
    """
    seeds = []

    def model(mean_e, sensor, time_s, seed, gain):
        seeds.append(seed)
        return np.full(mean_e.shape, 70 + len(seeds), np.uint16), 0

    pictures = calibration_captures(cameras.cropped(da_mobile, 64, 48), ("A",), diffraction="off", noise=model)
    first = next(iter(pictures))
    assert first.frames_dn.shape[0] == FRAMES == len(set(seeds)) and set(np.unique(first.frames_dn)) == {71, 72}
    assert pictures.fingerprint is None


def test_pictures_of_two_levels_meet_other_pixels_of_one_sensor(da_mobile):
    """Rationale: the fixed pattern is the sensor's; the image of a source that is put up anew lies elsewhere on it.

    Expectation: one sensor in all pictures, one window on it for all pictures of a level, others for other levels (29
    of 4,225 windows at random).
    """
    places = []

    def model(mean_e, sensor, time_s, seed, gain):
        places.append((sensor.sensor_seed, sensor.principal_point_px))
        return np.zeros(mean_e.shape, np.uint16), 0

    small = cameras.cropped(da_mobile, 64, 48)
    pictures = list(calibration_captures(small, ("A",), diffraction="off", noise=model))
    assert {seed for seed, _ in places} == {da_mobile.sensor.sensor_seed}
    per_level = len(places) // 29
    levels = [set(places[k * per_level : (k + 1) * per_level]) for k in range(29)]
    assert len(pictures) == 29 * 4 * len(EXPOSURES) and all(len(level) == 1 for level in levels)
    assert len(set.union(*levels)) > 20
