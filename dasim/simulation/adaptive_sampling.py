"""Adaptive number of samples: rendering noise is measured between pictures and compared with the sensor's noise.

Pictures are rendered in pairs with independent random numbers. Half the difference of a pair has the noise of its mean,
so that the noise is measured, not predicted.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from dasim.typing import FloatArray

NOISE_SHARE = 0.2  # of the sensor's noise: raises the noise of a capture by 2 %
PILOT_SPP = 16  # samples per pixel and stop of each picture of the first pair
MOST_SPP = 8192  # samples per pixel and stop of all pictures together
# Noise falls about as samples ** -0.6 to -0.7 (claims noise-slope-*). Where a pair misses the target, another follows.
SLOPE = 0.6
MOST_ROUNDS = 4
# Median of |x| for a normal x of standard deviation 1: turns a median difference into a standard deviation.
_MEDIAN_OF_ABSOLUTE = 0.6745


class StopPictures(NamedTuple):
    """One picture per stop, and the irradiance field with which they were rendered, for reuse by further renders."""

    rate: FloatArray  # [stop, h, w, channel] mean electrons per second
    field: Any = None  # see :func:`dasim.render.passes.irradiance_field`


@dataclass(frozen=True)
class AdaptiveRender:
    """The mean of several pictures, and the rendering noise that remains in it."""

    rate: FloatArray  # [h, w, channel] mean electrons per second of all stops together
    spp: tuple[int, ...]  # samples per pixel of all pictures together, per stop
    share: tuple[float, ...]  # rendering noise over the sensor's at the median pixel, per channel
    field: Any  # irradiance of the last picture


Pair = tuple[tuple[int, ...], FloatArray, FloatArray]  # samples of each stop in one picture, two pictures


def render_to_noise_target(
    picture: Callable[[int, tuple[int, ...]], StopPictures],
    sensor_noise: Callable[[FloatArray], FloatArray],
    *,
    stops: int,
    target: float = NOISE_SHARE,
    most_spp: int = MOST_SPP,
) -> AdaptiveRender:
    """Render pairs of pictures until their noise is below the share ``target`` of the sensor's.

    The first pair is small; its noise decides the size of the next. All pairs count in the result, weighted by their
    samples.

    Args:
        picture: ``picture(index, spp)`` renders through each stop with ``spp[stop]`` samples per pixel, its random
            numbers keyed by ``index``.
        sensor_noise: standard deviation of the sensor's noise [h, w, channel] for a sum over stops, in its unit.
        stops: how many stops the camera has.
        target: rendering noise over the sensor's noise, at the median pixel of the worst channel.
        most_spp: bound on the samples per pixel of a stop.
    """
    pairs: list[Pair] = []
    spp = (PILOT_SPP,) * stops
    for number in range(MOST_ROUNDS):
        first, second = picture(2 * number, spp), picture(2 * number + 1, spp)
        pairs.append((spp, first.rate, second.rate))
        rate, total, shares = _combined(pairs, sensor_noise)
        share = np.sqrt((shares**2).sum(axis=0))
        if share.max() <= target or max(total) + 2 * PILOT_SPP > most_spp:
            break
        spp = _next_spp(total, shares, target, most_spp)
    return AdaptiveRender(rate, total, tuple(float(value) for value in share), second.field)


def _next_spp(total: tuple[int, ...], shares: FloatArray, target: float, most_spp: int) -> tuple[int, ...]:
    """Samples per stop of the next two pictures; each step increases those of the stop that helps the worst channel
    most.
    """
    spp = [PILOT_SPP for _ in total]

    def expected(counts: list[int]) -> FloatArray:
        grown = np.array([(have + 2 * more) / have for have, more in zip(total, counts, strict=True)])
        return (shares * grown[:, None] ** -SLOPE) ** 2

    while (expected(spp).sum(axis=0) > target**2).any():
        worst = int(expected(spp).sum(axis=0).argmax())
        free = [i for i, have in enumerate(total) if have + 2 * _more(spp[i]) <= most_spp]
        if not free:
            break
        stop = max(free, key=lambda i: float(expected(spp)[i, worst]) / spp[i])
        spp[stop] = _more(spp[stop])
    return tuple(spp)


def _more(spp: int) -> int:
    """The next of 16, 20, 24, 28, 32, 40, ...: quarters of powers of two, for which Sobol' points are even."""
    return spp + (1 << (spp.bit_length() - 3))


def _combined(
    pairs: list[Pair], sensor_noise: Callable[[FloatArray], FloatArray]
) -> tuple[FloatArray, tuple[int, ...], FloatArray]:
    """Mean picture, samples per stop, and noise over the sensor's at the median pixel, [stop, channel]."""
    spp = np.array([pair[0] for pair in pairs], dtype=float)
    part = spp / spp.sum(axis=0)
    means = [(first + second) / 2 for _, first, second in pairs]
    rate = np.sum([weight[:, None, None, None] * mean for weight, mean in zip(part, means, strict=True)], axis=(0, 1))
    limit = sensor_noise(rate)
    squares = np.zeros((spp.shape[1], rate.shape[-1]))
    for weight, (_, first, second) in zip(part, pairs, strict=True):
        ratio = np.divide(np.abs(first - second) / 2, limit, out=np.zeros_like(first), where=limit > 0)
        median = np.median(ratio.reshape(len(first), -1, rate.shape[-1]), axis=1) / _MEDIAN_OF_ABSOLUTE
        squares += (weight[:, None] * median) ** 2
    return rate, tuple(int(2 * total) for total in spp.sum(axis=0)), np.sqrt(squares)
