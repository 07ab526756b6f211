"""Modified conditions for a second reconstruction of a capture, which show whether depth or noise limits the result."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy import ndimage

import dasim
from dasim.camera.noise import Exposure, full_scale_e
from dasim.camera.sensor import Sensor
from dasim.simulation.exposure import Shot
from dasim.values import Capture, DepthEstimate, PsfBank, Truth
from recon.depth.method import Method

TRUE_LEVEL_SD = 0.05  # levels: what a map of true levels states, below what any estimate reaches
QUIET_FACTOR = 10.0
QUIET_BITS = 16


def true_levels(truth: Truth) -> Method:
    """Depth method that returns the truth's levels: the one place where the truth enters a reconstruction.

    Where a bank has no levels behind the focus, those there are given as the levels in front of it with the same blur.
    Pixels that see nothing have the level of the nearest one that sees something.
    """
    nearest = ndimage.distance_transform_edt(~truth.valid, return_distances=False, return_indices=True)
    level = truth.level[tuple(nearest)]

    def method(capture: Capture, bank: PsfBank) -> DepthEstimate:
        """The true levels, already joined."""
        known = np.abs(level) if bank.behind is None else level
        sd = np.full(level.shape, TRUE_LEVEL_SD, np.float32)
        return DepthEstimate(level=known, sd=sd, joined=True, side="assumed" if bank.behind is None else "estimated")

    return method


def quiet(shot: Shot, factor: float = QUIET_FACTOR) -> Shot:
    """The shot exposed anew with the noise of the sensor divided by ``factor`` in relation to the signal.

    The exposure is ``factor``^2 times as long, on a sensor (:func:`quiet_sensor`) that holds as many times the
    electrons. The noise of ``mean_e`` by rendering stays: beside a tenth of the sensor's it is no longer small.
    """
    capture = shot.capture
    sensor = quiet_sensor(capture.camera.sensor, factor)
    camera = capture.camera.model_copy(update={"sensor": sensor})
    exposure = Exposure(time_s=factor**2 * capture.exposure_s, gain=capture.gain)
    return dasim.expose(Shot(replace(capture, camera=camera), shot.truth), exposure=exposure)


def quiet_sensor(sensor: Sensor, factor: float = QUIET_FACTOR) -> Sensor:
    """The sensor with ``factor``^2 times the full well, and a noise of 1 / ``factor`` relative to as large a signal.

    Relative shot noise falls by itself with the larger signal. Noise in electrons (read noise, offsets) is multiplied
    by ``factor``, relative noise (PRNU, spread of dark current, hot pixels) is divided by it, and the converter has 16
    bits, so that rounding is smaller.
    """
    electrons = ("read_noise_e", "dsnu_e", "row_noise_e", "column_noise_e")
    relative = ("prnu", "dark_current_spread", "hot_pixel_e_s")
    changes = {name: getattr(sensor, name) * factor for name in electrons}
    changes |= {name: getattr(sensor, name) / factor for name in relative}
    changes |= {"full_well_e": sensor.full_well_e * factor**2, "adc_bits": QUIET_BITS}
    if sensor.dn_per_e is not None:
        steps = 2**QUIET_BITS - 1 - sensor.black_level_dn
        changes["dn_per_e"] = steps / (full_scale_e(sensor) * factor**2)
    return sensor.model_copy(update=changes)
