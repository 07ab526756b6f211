"""Enough samples, and no more: rendering noise measured between pictures, against the sensor's own noise."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from dasim.camera import Sensor
from dasim.sensor import dark_rate_e_s, electrons_per_dn
from dasim.spectra import FloatArray

NOISE_SHARE = 0.2  # of the sensor's noise: adds 2 % to it
PILOT_SPP = 16  # of each of the first two pictures
MOST_SPP = 8192  # altogether
SLOPE = 0.6  # noise falls at least as samples ** -0.6 (claims noise-slope-*)
MARGIN = 1.1
MOST_ROUNDS = 4
# Median of |x| for a normal x of spread 1: turns the median difference of two pictures into a standard deviation.
_MEDIAN_OF_ABSOLUTE = 0.6745


@dataclass(frozen=True)
class Quiet:
    """A picture as the mean of several, and what is left of their noise."""

    rate: FloatArray  # [h, w, channel] mean electrons a second
    spp: int  # of all pictures together
    share: tuple[float, ...]  # rendering noise over the sensor's at the median pixel, a channel


def temporal_noise_e(mean_e: FloatArray, sensor: Sensor, time_s: float, gain: float = 1.0) -> FloatArray:
    """Standard deviation of a pixel from frame to frame, electrons: shot, dark current, read-out and rounding.

    EMVA 1288 release 4.0, eq. (16), without the fixed patterns DSNU and PRNU.
    """
    dark_e = dark_rate_e_s(sensor) * time_s
    rounding = electrons_per_dn(sensor, gain) ** 2 / 12
    return np.sqrt(np.maximum(mean_e, 0.0) + dark_e + sensor.read_noise_e**2 + rounding)


def quiet_picture(
    picture: Callable[[int, int], FloatArray],
    sensor_noise: Callable[[FloatArray], FloatArray],
    *,
    wanted: float = NOISE_SHARE,
    most_spp: int = MOST_SPP,
) -> Quiet:
    """Render pairs of pictures until their noise is below the share ``wanted`` of the sensor's.

    ``picture(index, spp)`` renders one, electrons a second, its randomness keyed by ``index``; ``sensor_noise`` gives
    the sensor's noise in the same unit for a picture. The first pair is small and tells how large the next must be;
    all count in the result, by their samples. The noise of a pair's mean is half the difference of its pictures.
    """
    pairs: list[tuple[int, FloatArray, FloatArray]] = []
    spp = PILOT_SPP
    for number in range(MOST_ROUNDS):
        pairs.append((2 * spp, picture(2 * number, spp), picture(2 * number + 1, spp)))
        found = _joined(pairs, sensor_noise)
        worst = max(found.share)
        left = most_spp - found.spp
        if worst <= wanted or left < 2 * PILOT_SPP:
            break
        total = found.spp * (MARGIN * worst / wanted) ** (1 / SLOPE)
        # Sobol' points are most even in powers of two.
        spp = min(1 << int(np.ceil(np.log2(max((total - found.spp) / 2, PILOT_SPP)))), left // 2)
    return found


def _joined(pairs: list[tuple[int, FloatArray, FloatArray]], sensor_noise: Callable[[FloatArray], FloatArray]) -> Quiet:
    total = sum(spp for spp, _, _ in pairs)
    rate = sum(spp / total * (first + second) / 2 for spp, first, second in pairs)
    assert isinstance(rate, np.ndarray)
    limit = sensor_noise(rate)
    squares = np.zeros(rate.shape[-1])
    for spp, first, second in pairs:
        ratio = np.divide(np.abs(first - second) / 2, limit, out=np.zeros_like(limit), where=limit > 0)
        median = np.median(ratio.reshape(-1, rate.shape[-1]), axis=0) / _MEDIAN_OF_ABSOLUTE
        squares += (spp / total * median) ** 2
    return Quiet(rate, total, tuple(float(share) for share in np.sqrt(squares)))
