"""Averages of point pictures: the stated noise is the noise that they have."""

from __future__ import annotations

import numpy as np
import pytest

from dasim.camera import noise
from dasim.camera import specification as cameras
from dasim.camera.crosstalk import electronic_crosstalk
from dasim.values import PointPicture
from recon.calibration import pictures

SIDE = 192


@pytest.mark.parametrize("name", ["da-mobile", "da-4x4"])
@pytest.mark.parametrize(
    "changes", [{"prnu": 0.05}, {"dsnu_e": 30.0, "prnu": 0.0}, {"read_noise_e": 30.0, "prnu": 0.0}]
)
def test_stated_noise_is_the_spread_of_a_flat_field(name, changes):
    """Rationale: the fit of the kernels weights pixels by 1 / sigma^2 and tests with sigma whether a kernel is round.

    Set-up: a flat field of 300 electrons and one of 1,200 in four times the time, two frames each, at every position of
    the mosaic's period; either the fixed pattern or the read noise is large. A green pixel of the 4x4 mosaic stands for
    eight pixels of the sensor, whose patterns are independent; the frames at one position share them.

    Expectation: the spread of each channel's average equals the stated standard deviation.

    Limit: four standard errors; the standard deviation of n independent pixels is known to 1 / sqrt(2 n). The fixed
    pattern of a channel repeats with the mosaic's period, so n is the number of periods.
    """
    camera = cameras.cropped(cameras.load_camera(name), SIDE, SIDE)
    camera = camera.model_copy(update={"sensor": camera.sensor.model_copy(update=changes)})
    rows, columns = len(camera.sensor.mosaic), len(camera.sensor.mosaic[0])
    group = []
    for number, shift in enumerate(np.ndindex(rows, columns)):
        for k, times in enumerate((1, 4)):
            mean_e = electronic_crosstalk(np.full((SIDE, SIDE), 300.0 * times), camera)
            first = 4 * number + 2 * k
            frames = [noise.expose(mean_e, camera.sensor, 0.01 * times, 3, frame=first + i)[0] for i in (0, 1)]
            group.append(PointPicture(np.stack(frames), "D65", 0, 1.0, 0.0, shift, 0.01 * times))
    image, sigma_e, visible = pictures.averaged(group, camera, 0.01)
    assert visible.all()
    limit = 4 / np.sqrt(2 * SIDE**2 / (rows * columns))
    for plane, sigma in zip(image, sigma_e, strict=True):
        assert plane.std() == pytest.approx(np.sqrt(np.mean(sigma**2)), rel=limit)
