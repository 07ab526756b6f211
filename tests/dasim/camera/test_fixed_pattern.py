"""The fixed pattern: its distributions, its windows, its seed."""

from __future__ import annotations

import numpy as np
import pytest

from dasim.camera import specification as cameras
from dasim.camera.fixed_pattern import TILE_PX, FixedPattern, fixed_pattern

SHAPE = (512, 512)  # 262,144 pixels: a standard deviation is known to 0.14 %
STD_LIMIT = 5 / np.sqrt(2 * SHAPE[0] * SHAPE[1])  # five standard errors, relative


@pytest.fixture
def make(da_mobile):
    """The fixed pattern of da-mobile's sensor with changed values."""

    def pattern(shape=SHAPE, **changes) -> FixedPattern:
        return fixed_pattern(da_mobile.sensor.model_copy(update=changes), shape)

    return pattern


def test_sensitivity_and_offsets_have_the_data_sheets_spread(make):
    """Expectation: PRNU 1 %; with one of DSNU, rows and columns at a time, the offsets' standard deviation is its own,
    and rows and columns are stripes. That of 512 rows is known to 3 %; five of these.
    """
    silent = {"dsnu_e": 0.0, "row_noise_e": 0.0, "column_noise_e": 0.0}
    assert make().sensitivity.std() == pytest.approx(0.01, rel=STD_LIMIT)
    assert make().sensitivity.mean() == pytest.approx(1, abs=5 * 0.01 / 512)
    assert make(**silent | {"dsnu_e": 2.0}).offset_e.std() == pytest.approx(2.0, rel=STD_LIMIT)
    rows, columns = (make(**silent | {name: 0.7}).offset_e for name in ("row_noise_e", "column_noise_e"))
    assert (rows == rows[:, :1]).all() and (columns == columns[:1]).all()
    for line in (rows[:, 0], columns[0]):
        assert line.std() == pytest.approx(0.7, rel=5 / np.sqrt(2 * 512))
    assert abs(np.corrcoef(rows[:, 0], columns[0])[0, 1]) < 5 / np.sqrt(512)


def test_dark_current_is_log_normal_about_its_mean(make):
    """Set-up: a spread of 50 %. Expectation: mean 10 electrons per second, standard deviation 5, the logarithm normal:
    its standard deviation is sqrt(ln 1.25). Twice the current 7 K warmer. The fourth moment of this distribution makes
    its standard deviation three times less certain than a normal one's.
    """
    dark = make(dark_current_spread=0.5, hot_pixel_share=0.0).dark_e_s
    assert dark.mean() == pytest.approx(10, abs=5 * 5 / 512)
    assert dark.std() == pytest.approx(5, rel=3 * STD_LIMIT)
    assert np.log(dark).std() == pytest.approx(np.sqrt(np.log(1.25)), rel=STD_LIMIT)
    warm = make(dark_current_spread=0.5, hot_pixel_share=0.0, temperature_c=32.0).dark_e_s
    np.testing.assert_allclose(warm, 2 * dark, rtol=1e-6)


def test_hot_pixels_are_as_many_and_as_hot_as_stated(make):
    """Set-up: 1 % of the pixels hot, without other dark current. Expectation: their number is binomial, their current
    exponential: mean and standard deviation 500 electrons per second. Limits: five standard errors (the variance of
    an exponential law's standard deviation is twice that of its mean).
    """
    dark = make(hot_pixel_share=0.01, dark_current_e_s=0.0).dark_e_s
    hot = dark[dark > 0]
    assert hot.size == pytest.approx(0.01 * dark.size, abs=5 * np.sqrt(0.01 * dark.size))
    assert hot.mean() == pytest.approx(500, rel=5 / np.sqrt(hot.size))
    assert hot.std() == pytest.approx(500, rel=5 * np.sqrt(2 / hot.size))
    assert (make(hot_pixel_share=0.0, dark_current_e_s=0.0).dark_e_s == 0).all()


@pytest.mark.parametrize("size", [(96, 128), (10, 300), (512, 8)])
def test_central_crop_sees_the_pattern_of_the_whole_sensor(make, size):
    """Expectation: exactly the same numbers, also where the crop's border cuts tiles."""
    whole, crop = make(), make(size)
    assert size[0] % TILE_PX or size[1] % TILE_PX
    top, left = (512 - size[0]) // 2, (512 - size[1]) // 2
    for part, of in zip(crop, whole, strict=True):
        np.testing.assert_array_equal(part, of[top : top + size[0], left : left + size[1]])


def test_a_window_sees_the_pattern_of_its_part_of_the_sensor(da_mobile):
    """Expectation: exactly the same numbers, in a window anywhere and in a part of that window."""
    whole = fixed_pattern(da_mobile.sensor, (1536, 2048))
    window = cameras.cropped(da_mobile, 200, 100, at_px=(1410, 36))
    for camera, (x, y) in ((window, (1410, 36)), (cameras.cropped(window, 64, 48), (1478, 62))):
        size = camera.sensor.height_px, camera.sensor.width_px
        for part, of in zip(fixed_pattern(camera.sensor, size), whole, strict=True):
            np.testing.assert_array_equal(part, of[y : y + size[0], x : x + size[1]])


def test_patterns_of_two_sensors_and_of_two_kinds_are_independent(make):
    """Expectation: correlations of 262,144 independent pairs below five standard deviations of 1 / 512."""
    first, second = make(sensor_seed=0), make(sensor_seed=1)
    pairs = [(a, b) for a, b in zip(first, second, strict=True)]
    pairs += [(first.sensitivity, first.offset_e), (first.sensitivity, first.dark_e_s)]
    for a, b in pairs:
        assert abs(np.corrcoef(a.ravel(), b.ravel())[0, 1]) < 5 / 512


def test_sensor_seed_follows_from_the_name_unless_it_is_given(da_mobile):
    """Expectation: cameras of two names have two sensors; crops and other focus keep the sensor; a key decides."""
    twin = cameras.load_camera("da-8mm")
    assert da_mobile.sensor.sensor_seed != twin.sensor.sensor_seed
    for same in (cameras.cropped(da_mobile, 64, 48), cameras.refocused(da_mobile, 0.2)):
        assert same.sensor.sensor_seed == da_mobile.sensor.sensor_seed
    data = da_mobile.model_dump()
    data["sensor"]["sensor_seed"] = 7
    assert cameras.Camera.model_validate(data).sensor.sensor_seed == 7
    data["sensor"]["sensor_seed"] = None
    assert cameras.Camera.model_validate(data) == da_mobile
