"""The sensor model by the methods of EMVA 1288: photon transfer, frame stacks, linearity."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest

from dasim.base.errors import InputError
from dasim.camera import noise as sensor
from dasim.camera import sensor as sensors
from dasim.camera import specification as cameras
from dasim.camera.crosstalk import electronic_crosstalk, noise_gains

SIDE = 250  # 62,500 pixels: a standard deviation is known to 1 / sqrt(2 n) = 0.28 %, a variance to 0.57 %
VARIANCE_LIMIT = 5 * np.sqrt(2) / SIDE  # five standard errors of a variance, relative to it
COVARIANCE_LIMIT = 5 / SIDE  # the same of the covariance of two frames, relative to the variance of one
STD_LIMIT = 0.012  # four of these
STACK = 48  # frames for fixed patterns: what of the temporal noise is left is subtracted


@pytest.fixture
def quiet(da_mobile):
    """A sensor without noise, with 4 electrons per digital number."""

    def make(**changes):
        silent = {"read_noise_e": 0, "dark_current_e_s": 0, "hot_pixel_share": 0, "full_well_e": 4.0 * (1023 - 64)}
        silent |= {"dsnu_e": 0, "row_noise_e": 0, "column_noise_e": 0, "prnu": 0, "dark_current_spread": 0}
        return da_mobile.sensor.model_copy(update=silent | changes)

    return make


def flat(level_e: float, side: int = SIDE) -> np.ndarray:
    return np.full((side, side), level_e)


def stack_e(mean_e, model, frames=STACK, *, gain=4.0, seed=3, first=0) -> np.ndarray:
    """Frames in electrons, through the raw numbers."""
    shots = [
        sensor.expose(mean_e, model, 0.0, seed, gain=gain, frame=first + k)[0].astype(float) for k in range(frames)
    ]
    return (np.stack(shots) - model.black_level_dn) * sensor.electrons_per_dn(model, gain)


def test_without_noise_a_number_is_the_rounded_and_clipped_mean(quiet):
    """Set-up: 4 electrons per digital number, means in thirds of electrons, so that no value lies halfway between
    numbers.

    Expectation: exactly the nearest whole number above black, at most 1,023; those at 1,023 are counted.
    """
    thirds = np.arange(0, 3 * 4200).reshape(120, -1)
    raw, saturated = sensor.expose(thirds / 3, quiet(), 1.0, 0, noise="off")
    expected = [min(64 + round(Fraction(int(third), 12)), 1023) for third in thirds.ravel()]
    halfway = np.abs((thirds.ravel() % 12) - 6) == 0
    difference = np.abs(raw.ravel().astype(int) - expected)
    assert (difference[~halfway] == 0).all() and (difference <= 1).all()
    assert saturated == np.count_nonzero(np.array(expected) == 1023)
    assert raw.dtype == np.uint16


@pytest.mark.parametrize("gain", [1.0, 4.0])
def test_photon_transfer(quiet, gain):
    """Rationale: the central measurement of EMVA 1288: the variance of a Poisson process grows with the mean by 1 / K.

    Set-up: eight levels up to 60 % of full scale, 62,500 pixels each, no other noise.

    Expectation: a slope of gain / 4 DN per electron, and the 1/12 of rounding as intercept. From eight variances of
    0.57 % each, the slope is known to about 0.4 %; the limit is four times that.
    """
    levels = np.linspace(0.05, 0.6, 8) * 4 * 959 / gain
    frames = [sensor.expose(flat(level), quiet(), 1.0, 11 + k, gain=gain)[0] for k, level in enumerate(levels)]
    mean, variance = np.array([(raw.mean() - 64, raw.var()) for raw in frames]).T
    slope, intercept = np.polyfit(mean, variance, 1, w=1 / variance)
    assert slope == pytest.approx(gain / 4, rel=0.016)
    assert intercept == pytest.approx(1 / 12, abs=0.016 * variance[0] * 4)
    np.testing.assert_allclose(mean * 4 / gain, levels, rtol=5 * np.sqrt(1 / levels[0] / SIDE**2) + 1e-4)


def test_read_noise(quiet):
    """Expectation: 3 electrons in the dark, after the rounding's variance (step^2 / 12) is taken off."""
    model = quiet(read_noise_e=3.0)
    electrons = stack_e(flat(0), model, 1)[0]
    step = sensor.electrons_per_dn(model, 4.0)
    assert np.sqrt(electrons.var() - step**2 / 12) == pytest.approx(3.0, rel=STD_LIMIT)
    assert abs(electrons.mean()) < 5 * 3.0 / SIDE


def test_fixed_patterns_are_recovered_from_stacks(quiet):
    """Set-up: 48 frames, dark and at 2,000 electrons, with read noise.

    Expectation: the spread of the mean frame, less the temporal share, is 2 electrons of DSNU and 1 % of PRNU.
    """
    dark = stack_e(flat(0), quiet(read_noise_e=3.0, dsnu_e=2.0))
    bright = stack_e(flat(600), quiet(prnu=0.02))

    def spatial_std(frames):
        return np.sqrt(frames.mean(axis=0).var() - frames.var(axis=0, ddof=1).mean() / len(frames))

    assert spatial_std(dark) == pytest.approx(2.0, rel=1.5 * STD_LIMIT)
    assert spatial_std(bright) / bright.mean() == pytest.approx(0.02, rel=1.5 * STD_LIMIT)


def test_fixed_patterns_stay_and_noise_changes(quiet):
    """Expectation: two stacks of one sensor share their pattern, whatever their frames' seeds; those of two sensors
    have nothing in common, although the seed of their frames is the same.

    The correlation of 62,500 independent pairs has a standard deviation of 1 / 250.
    """

    def pattern(sensor_seed, seed, first=0):
        model = quiet(dsnu_e=2.0, read_noise_e=3.0, sensor_seed=sensor_seed)
        return stack_e(flat(0), model, 12, seed=seed, first=first).mean(axis=0).ravel()

    first = pattern(0, 0)
    expected = 2.0**2 / (2.0**2 + (3.0**2 + 1.0 / 12) / 12)  # fixed over whole variance of a mean of 12 frames
    for other in (pattern(0, 0, first=12), pattern(0, 1)):
        assert np.corrcoef(first, other)[0, 1] == pytest.approx(expected, abs=5 / SIDE)
    assert abs(np.corrcoef(first, pattern(1, 0, first=12))[0, 1]) < 5 / SIDE


def test_dark_signal_doubles_each_7_kelvin_and_grows_with_time(quiet):
    """Expectation: 500 electrons per second at 25 C, twice at 32 C, four times at 39 C; Poisson, so five sigma."""
    for temperature_c, time_s, expected in ((25, 1, 500), (25, 2, 1000), (32, 1, 1000), (39, 0.5, 1000)):
        model = quiet(dark_current_e_s=500.0, temperature_c=temperature_c)
        raw, _ = sensor.expose(flat(0), model, time_s, 5)
        assert (raw.mean() - 64) * 4 == pytest.approx(expected, abs=5 * np.sqrt(expected) / SIDE)


def temporal_and_fixed(mean_e, model, time_s, gain):
    """Variance from frame to frame and from pixel to pixel, electrons^2, of two frames of a flat field."""
    first, second = (
        sensor.expose(flat(mean_e), model, time_s, 8, gain, frame=frame)[0].astype(float) for frame in (0, 1)
    )
    step = sensor.electrons_per_dn(model, gain)
    return (first - second).var() / 2 * step**2, np.cov(first.ravel(), second.ravel())[0, 1] * step**2


@pytest.mark.parametrize(
    ("term", "changes", "mean_e", "time_s", "gain", "temporal", "fixed"),
    [
        ("shot", {}, 1500, 0.0, 1.0, 1500 + 16 / 12, 0),
        ("dark", {"dark_current_e_s": 400.0, "temperature_c": 32.0}, 100, 2.0, 1.0, 1600 + 100 + 16 / 12, 0),
        ("read", {"read_noise_e": 30.0}, 400, 0.0, 1.0, 900 + 400 + 16 / 12, 0),
        ("rounding", {}, 2000, 0.0, 1 / 16, 2000 + 64**2 / 12, 0),
        ("dsnu", {"dsnu_e": 30.0}, 400, 0.0, 1.0, 400 + 16 / 12, 900),
        ("prnu", {"prnu": 0.03}, 1500, 0.0, 1.0, 1500 + 16 / 12, 45**2),
        ("spread", {"dark_current_e_s": 200.0, "dark_current_spread": 0.3}, 0, 1.0, 1.0, 200 + 16 / 12, 60**2),
    ],
)
def test_each_term_of_the_variance_is_that_of_frames(quiet, term, changes, mean_e, time_s, gain, temporal, fixed):
    """Rationale: the law that weighs pixels must be the noise that :func:`expose` draws, term by term.

    Set-up: two frames of a flat field, 62,500 pixels each, one term large beside the shot noise and the rounding of
    4 electrons per number, which cannot be switched off; for the term of rounding, 64 electrons per number.
    Expectation: half the variance of their difference is the temporal law, their covariance the fixed one, one frame's
    variance the sum; all are the numbers written out in the table. Limit: five standard errors. Without the term the
    law would miss by more than twice that.
    """
    model = quiet(**changes)
    laws = sensor.temporal_variance(model, time_s, gain), sensor.fixed_variance(model, time_s)
    np.testing.assert_allclose([law.at(float(mean_e)) for law in laws], [temporal, fixed], rtol=1e-12)
    whole = sensor.variance(model, time_s, gain).at(float(mean_e))
    assert whole == pytest.approx(temporal + fixed, rel=1e-12)
    seen_temporal, seen_fixed = temporal_and_fixed(float(mean_e), model, time_s, gain)
    assert seen_temporal == pytest.approx(temporal, rel=VARIANCE_LIMIT)
    assert seen_fixed == pytest.approx(fixed, abs=COVARIANCE_LIMIT * whole)
    size = {"shot": 1500, "dark": 1600, "read": 900, "rounding": 64**2 / 12}.get(term, fixed)
    assert size > 2 * (COVARIANCE_LIMIT if fixed else VARIANCE_LIMIT) * whole


def test_whole_variance_of_the_bundled_camera(da_mobile):
    """Set-up: da-mobile as it is, 1,500 electrons, 0.02 s. Expectation: variances add."""
    model, step = da_mobile.sensor, sensor.electrons_per_dn(da_mobile.sensor)
    raw, _ = sensor.expose(flat(1500), model, 0.02, 8)
    expected = 1500 + 0.2 + 3.0**2 + 2.0**2 + 0.2**2 + 0.3**2 + 0.02**2 + (0.01 * 1500) ** 2 + step**2 / 12
    assert sensor.variance(model, 0.02).at(1500.0) == pytest.approx(expected, rel=1e-12)
    assert (raw * step).var() == pytest.approx(expected, rel=VARIANCE_LIMIT)


def test_all_users_give_a_pixel_the_same_variance(da_mobile):
    """Rationale: all parts that weigh pixels must use one noise model.

    Set-up: a flat raw picture of da-mobile, exposed for 2 s so that its dark current counts.

    Expectation: the reconstruction, the calibration's pictures, its search for the source and its signal-to-noise ratio
    use the variance that is written out here; so do the bounds of the claims and studies at their own mean, and the
    exposure steps of EMVA frames.
    """
    from dasim.simulation import emva
    from dasim.values import Capture, PointPicture
    from recon.calibration import pictures, source
    from recon.picture import mosaic
    from validation.studies import criteria
    from validation.subjects import texture

    def by_hand(x, time_s):
        pattern = 2.0**2 + 0.2**2 + 0.3**2 + (0.1 * 10 * time_s) ** 2 + (0.01 * x) ** 2
        return x + 10 * time_s + 3.0**2 + step**2 / 12 + pattern

    camera, time_s = cameras.cropped(da_mobile, 64, 48), 2.0
    step, raw = 6000 / 959, np.full((48, 64), 364, np.uint16)
    mean_e = 300 * step - 10 * time_s
    capture = Capture(raw, camera, time_s, 1.0, 0)
    gains = noise_gains(camera)  # of the correction of crosstalk, for R, G, B, IR; tested in test_crosstalk.py
    for name, gain in zip(sensors.channels(camera.sensor), gains, strict=True):
        expected = gain * by_hand(mean_e, time_s)
        assert mosaic.noise_variance(capture, name).at(mean_e) == pytest.approx(expected, rel=1e-9)

    def point(raw_dn):
        return PointPicture(raw_dn[None], "D65", 0, 1.0, 0.0, (0, 0), time_s)

    _, sigma_e, seen = pictures.averaged([point(raw)], camera, time_s)
    gain_of_seen = np.repeat(gains, raw.size // 4)  # each pixel is seen in its own channel
    np.testing.assert_allclose(sigma_e[seen] ** 2, gain_of_seen * by_hand(mean_e, time_s), rtol=1e-9)
    np.testing.assert_allclose(source._electrons(capture)[1] ** 2, by_hand(mean_e, time_s), rtol=1e-9)

    y, x = np.indices(raw.shape)
    disc = np.hypot(y - 23.5, x - 31.5) < 2 * pictures.RIM_PX
    fewest = min(np.count_nonzero(disc[row::2, column::2]) for row in (0, 1) for column in (0, 1))
    ratio, _ = source.signal_to_noise([point(np.where(disc, 364, 64).astype(np.uint16))], camera, 0.0)
    assert ratio == pytest.approx(np.sqrt(fewest / by_hand(mean_e, time_s)) * 300 * step, rel=1e-9)

    white, short_s = texture.white_electrons(da_mobile, "D65", 500.0)
    patch = criteria.texture_patch(da_mobile, "D65", 500.0)
    even = np.full((48, 64, 4), criteria.MEAN_SHARE * white)
    collected = electronic_crosstalk(sensor.mosaic(even, camera), camera)[2:4, 2:4]  # a cell away from the border
    green_and_infrared = np.array([collected[0, 0], collected[1, 1]])
    np.testing.assert_allclose(patch.noise, gains[[1, 3]] * by_hand(green_and_infrared, short_s), rtol=1e-9)

    ladder = emva.plan(da_mobile)
    assert ladder.mean_e[-1] == pytest.approx(6000 + 3 * np.sqrt(by_hand(6000, ladder.exposure_s[-1])), rel=1e-9)


def test_seeds_frames_and_stages(quiet):
    """Expectation: same seed and frame, same bytes; another seed or frame, others; seed 0 is a seed.

    One stage's draws do not depend on another's: switching DSNU on changes each pixel by its DSNU alone, although
    shot noise is 20 times larger.
    """
    model = quiet(dsnu_e=0, read_noise_e=0)
    first = sensor.expose(flat(1600), model, 1.0, 0)[0]
    assert (first == sensor.expose(flat(1600), model, 1.0, 0)[0]).all()
    for other in (sensor.expose(flat(1600), model, 1.0, 1)[0], sensor.expose(flat(1600), model, 1.0, 0, frame=1)[0]):
        assert np.corrcoef(first.ravel(), other.ravel())[0, 1] < 5 / SIDE
    with_pattern = sensor.expose(flat(1600), quiet(dsnu_e=8.0), 1.0, 0)[0]
    change_e = (with_pattern.astype(float) - first) * 4
    # two roundings of 4 electrons: 2 * 16 / 12
    assert np.std(change_e) == pytest.approx(np.sqrt(64 + 32 / 12), rel=4 * STD_LIMIT)


@pytest.mark.parametrize("gain", [1.0, 0.5, 4.0])
def test_overexposed_pixels_are_all_counted(da_mobile, gain):
    """Rationale: saturation is counted and reported, never silent.

    Set-up: twice the full well everywhere, at gain 1 and, since gains down to 1/16 are allowed, at gain 1/2, where
    the well is full long before the converter is. Expectation: every pixel counts as saturated.
    """
    model = da_mobile.sensor
    assert sensor.expose(flat(2 * 6000, 50), model, 0.01, 0, gain=gain)[1] == 50 * 50
    assert sensor.expose(flat(3000 / gain if gain > 1 else 3000, 50), model, 0.01, 0, gain=gain)[1] == 0, (
        "half the full well saturates nothing"
    )


@pytest.mark.parametrize("gain", [1.0, 4.0])
def test_automatic_exposure_puts_the_brightest_channel_at_85_percent(da_mobile, gain):
    """Set-up: uniform channels of 10, 200, 50 and 20 e-/s; red is 1e6 where no red pixel looks.

    Expectation: green's raw numbers are 85 % of the way from black to full scale.
    """
    camera = cameras.cropped(da_mobile, 32, 24)
    camera = camera.model_copy(update={"sensor": camera.sensor.model_copy(update={"electronic_crosstalk": 0.0})})
    rate = np.ones((24, 32, 4)) * [10.0, 200.0, 50.0, 20.0]
    rate[0::2, 0::2, 0] = 1e6  # green's places
    time_s = sensor.auto_exposure_s(rate, camera, sensor.Exposure(gain=gain))
    raw, _ = sensor.expose(sensor.mosaic(rate * time_s, camera), camera.sensor, time_s, 0, gain=gain, noise="off")
    assert abs(raw.max() - (64 + 0.85 * 959)) <= 0.5
    assert sensor.auto_exposure_s(np.zeros_like(rate), camera, sensor.Exposure()) == 1.0
    with pytest.raises(InputError, match="at least 1e-09 s is allowed"):
        sensor.auto_exposure_s(1e12 * (rate + 1), camera, sensor.Exposure())


def test_automatic_exposure_never_overfills_the_well(da_mobile):
    """Rationale: below gain 1 the well is full before the converter is, so 85 % of full scale can not be reached."""
    camera = cameras.cropped(da_mobile, 32, 24)
    rate = np.full((24, 32, 4), 100.0)
    time_s = sensor.auto_exposure_s(rate, camera, sensor.Exposure(gain=0.25))
    assert 100.0 * time_s <= camera.sensor.full_well_e


def test_automatic_exposure_ignores_a_few_highlights(da_mobile):
    """Expectation: a highlight of 0.2 % of the pixels changes nothing, one of 2 % does (percentile 99.5)."""
    camera = cameras.cropped(da_mobile, 80, 50)
    rate = np.full((50, 80, 4), 100.0)
    plain = sensor.auto_exposure_s(rate, camera, sensor.Exposure())
    rate[0, :4] = 1e4
    assert sensor.auto_exposure_s(rate, camera, sensor.Exposure()) == pytest.approx(plain)
    rate[:4, :20] = 1e4
    assert sensor.auto_exposure_s(rate, camera, sensor.Exposure()) == pytest.approx(plain / 100)


# --- impossible but legal ------------------------------------------------------------------------


def test_no_light_and_far_too_much_finish(da_mobile):
    """Expectation: no light gives the black level and its noise, none saturated; 1e30 electrons, or a dark current
    beyond all bounds, saturate every pixel at the top number or just below it (read noise after the full well).
    """
    model = da_mobile.sensor
    raw, full = sensor.expose(flat(0, 50), model, 1e-3, 0)
    assert full == 0 and abs(raw.mean() - 64) < 5 * 0.7 / 50
    for noise in ("on", "off"):
        raw, full = sensor.expose(flat(1e30, 50), model, 3600.0, 0, noise=noise)
        assert full == 50 * 50 and raw.min() >= 1023 - 5
    hot = model.model_copy(update={"dark_current_e_s": 1e300, "temperature_c": 150.0, "dark_doubling_k": 1.0})
    assert sensor.expose(flat(0, 50), hot, 3600.0, 0)[1] == 50 * 50


# --- a noise model of one's own -------------------------------------------------------------------


def test_a_model_of_ones_own_gets_the_exposure_and_gives_the_frame(da_mobile):
    """Expectation: the arguments arrive as they are documented, and the model's frame is the result, unchanged."""

    def model(*arguments):
        assert arguments[0].shape == (5, 7) and arguments[1:] == (da_mobile.sensor, 0.02, 9, 2.0)
        return np.full((5, 7), 77, np.uint16), 3

    raw, saturated = sensor.apply(model, np.ones((5, 7)), da_mobile.sensor, 0.02, 9, 2.0)
    assert (raw == 77).all() and saturated == 3
    ours = sensor.apply(sensor.expose, np.ones((5, 7)), da_mobile.sensor, 0.02, 9, 2.0)[0]
    np.testing.assert_array_equal(ours, sensor.expose(np.ones((5, 7)), da_mobile.sensor, 0.02, 9, gain=2.0)[0])


@pytest.mark.parametrize(
    ("result", "words"),
    [
        (np.zeros((5, 7), np.uint16), "the count of saturated pixels, not one ndarray"),
        ((np.zeros((5, 7)), 0), "an array of uint16 [5, 7], not float64 [5, 7]"),
        ((np.zeros((7, 5), np.uint16), 0), "not uint16 [7, 5]"),
        (([[0]], 0), "not list"),
        ((np.full((5, 7), 1024, np.uint16), 0), "a raw number is 1024; the sensor has 10 bits, 0 to 1023"),
        ((np.zeros((5, 7), np.uint16), 36), "must be 0 to 35, not 36"),
        ((np.zeros((5, 7), np.uint16), None), "must be 0 to 35, not None"),
    ],
)
def test_what_is_no_frame_is_refused_in_one_line(da_mobile, result, words):
    with pytest.raises(InputError) as caught:
        sensor.apply(lambda *_: result, np.ones((5, 7)), da_mobile.sensor, 0.02, 9, 1.0)
    assert words in str(caught.value) and "noise model '" in str(caught.value)


def test_a_model_that_raises_says_where(da_mobile):
    def model(mean_e, sensor, time_s, seed, gain):
        raise ValueError("no such thing")

    with pytest.raises(InputError, match=r"model': raised ValueError: no such thing \(test_noise.py, line \d+\)"):
        sensor.apply(model, np.ones((5, 7)), da_mobile.sensor, 0.02, 9, 1.0)
