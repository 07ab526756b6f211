"""True levels reach the reconstruction as they are, and a quiet exposure has a tenth of the noise."""

from __future__ import annotations

import dataclasses
from types import SimpleNamespace

import numpy as np
import pytest

from dasim.camera import noise, specification
from dasim.camera.crosstalk import electronic_crosstalk
from dasim.camera.fixed_pattern import fixed_pattern
from dasim.simulation.exposure import Shot
from dasim.values import Capture
from recon.depth.method import run_method
from tests.support import surfaces
from validation.subjects import conditions

SIZE = (128, 160)
MEAN_E = 900.0
TIME_S = 0.02
ROUNDING = 0.01  # of 10 bits in the variance of the sensor; that of 16 bits is smaller
SAMPLE = 0.05  # standard deviations of 5,000 pixels per channel are good to 1 %


@pytest.fixture(scope="module")
def shot() -> Shot:
    """A uniform wall with sensor noise."""
    camera = specification.cropped(specification.load_camera("da-mobile"), SIZE[1], SIZE[0])
    truth = surfaces.truth(camera, np.full(SIZE, -2.0), np.full((*SIZE, 4), MEAN_E))
    truth = dataclasses.replace(truth, focus_e=truth.sharp_e)
    collected = electronic_crosstalk(noise.mosaic(truth.mean_e.astype(float), camera), camera)
    raw, _ = noise.expose(collected, camera.sensor, TIME_S, 0)
    return Shot(Capture(raw, camera, TIME_S, 1.0, 0, "D65", {"diffraction": "wave"}), truth)


@pytest.mark.parametrize("dn_per_e", [None, 0.2])
@pytest.mark.parametrize("mean_e", [10.0, 1000.0])
def test_the_variance_of_the_quiet_sensor_is_a_hundredth(shot, mean_e, dn_per_e):
    """Expectation: relative to the square of the signal, at 100 times the signal and the time, but for rounding."""
    sensor = shot.capture.camera.sensor.model_copy(update={"dn_per_e": dn_per_e, "dark_current_e_s": 500.0})
    quiet = conditions.quiet_sensor(sensor)
    was = noise.variance(sensor, TIME_S).at(mean_e) - noise.electrons_per_dn(sensor) ** 2 / 12
    now = noise.variance(quiet, 100 * TIME_S).at(100 * mean_e) - noise.electrons_per_dn(quiet) ** 2 / 12
    assert now / 100**2 == pytest.approx(was / 100)
    assert noise.full_scale_e(quiet) == pytest.approx(100 * noise.full_scale_e(sensor))
    assert noise.electrons_per_dn(quiet) < 10 * noise.electrons_per_dn(sensor) / 5


def test_hot_pixels_are_a_tenth_as_bright(shot):
    """Expectation: of the pattern of dark current, in 100 times the time and relative to 100 times the signal."""
    sensor = shot.capture.camera.sensor.model_copy(update={"hot_pixel_share": 0.01, "dark_current_e_s": 0.0})
    was, now = (fixed_pattern(one, SIZE).dark_e_s for one in (sensor, conditions.quiet_sensor(sensor)))
    np.testing.assert_allclose(now, was / 10)


def test_a_quiet_exposure_has_a_tenth_of_the_noise_and_100_times_the_electrons(shot):
    quiet = conditions.quiet(shot)
    np.testing.assert_allclose(quiet.truth.focus_e, 100 * shot.truth.focus_e, rtol=1e-5)
    np.testing.assert_allclose(quiet.truth.mean_e, 100 * shot.truth.mean_e, rtol=1e-5)
    relative = []
    for one in (shot, quiet):
        sensor = one.capture.camera.sensor
        collected = noise.collected_e(one.capture.raw_dn.astype(float), sensor)[2:-2, 2:-2]
        green = collected[specification.mosaic_channels(one.capture.camera)[2:-2, 2:-2] == 1]
        relative.append(green.std() / green.mean())
    assert relative[1] == pytest.approx(relative[0] / 10, rel=SAMPLE + ROUNDING)


@pytest.mark.parametrize("behind", [None, "levels"])
def test_true_levels_are_those_of_the_truth(shot, behind):
    """Expectation: behind the focus with their sign where a bank has levels there; else those of the same blur."""
    valid = np.ones(SIZE, bool)
    valid[:, :10] = False
    level = np.where(valid, -2.0 - 0.01 * np.arange(SIZE[1]), np.nan).astype(np.float32)
    truth = dataclasses.replace(shot.truth, level=level, valid=valid)
    estimate = run_method(conditions.true_levels(truth), shot.capture, SimpleNamespace(behind=behind))
    sign = 1 if behind else -1
    np.testing.assert_array_equal(estimate.level[:, 10:], sign * level[:, 10:])
    np.testing.assert_array_equal(estimate.level[:, :10], np.broadcast_to(sign * level[:, 10:11], (SIZE[0], 10)))
    assert estimate.joined and estimate.coverage == 1 and estimate.side == ("estimated" if behind else "assumed")
