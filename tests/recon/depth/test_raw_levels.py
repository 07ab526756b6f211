"""The noise that raw levels assume is that of simulated frames."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

import dasim
from dasim.camera import sensor as sensors
from dasim.camera import specification as cameras
from recon.depth import raw_levels
from recon.picture import mosaic

DRAWS = 12
SIZE_PX = (256, 192)
LIMIT = 0.02  # five of the 0.4 % to which 12,288 pixels in 12 draws give a variance, sqrt(2 / 135,168)


def redrawn(shot, sensor_seed):
    """A capture of the shot by another sensor of the same kind, with noise of its own."""
    camera = shot.capture.camera
    sensor = camera.sensor.model_copy(update={"sensor_seed": sensor_seed})
    other = dataclasses.replace(shot.capture, camera=camera.model_copy(update={"sensor": sensor}))
    return dasim.exposed(dataclasses.replace(shot, capture=other), 1.0, sensor_seed)


@pytest.mark.slow
@pytest.mark.parametrize("light", ["D65", "energy-saving-3500K"])
def test_assumed_noise_is_the_spread_between_simulated_frames(light):
    """Rationale: the correction of crosstalk raises the noise of each channel by another factor, and the noise is that
    of the electrons that a pixel collected, which under a lamp without near-infrared are mostly its neighbours'.

    Set-up: the flat scene through da-mobile-thin, rendered once; twelve sensors and frames. Expectation: in each
    channel, the variance from draw to draw is the variance that the reconstruction assumes.
    """
    camera = cameras.cropped("da-mobile-thin", *SIZE_PX)
    shot = dasim.simulate(dasim.lit_by("flat", light), camera, spp=16)
    captures = [redrawn(shot, seed) for seed in range(DRAWS)]
    linear = [mosaic.linearise(capture)[0] for capture in captures]
    planes = [mosaic.planes(raw_e, camera) for raw_e in linear]
    assumed = [raw_levels.variances(raw_e, capture) for raw_e, capture in zip(linear, captures, strict=True)]
    for name in sensors.channels(camera.sensor):
        measured = np.var([plane[name] for plane in planes], axis=0, ddof=1).mean()
        expected = np.mean([variances[name] for variances in assumed])
        assert measured == pytest.approx(expected, rel=LIMIT), name
