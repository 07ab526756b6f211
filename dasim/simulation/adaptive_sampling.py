"""Adaptive number of samples: rendering noise is measured between pictures and compared with the sensor's noise.

Pictures are rendered in pairs with independent random numbers (:mod:`dasim.simulation.rendering_noise`), so that the
noise is measured, not predicted.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from dasim.simulation.rendering_noise import Measured, Pair, measured, share, shares_at
from dasim.typing import FloatArray

NOISE_SHARE = 0.25  # of the sensor's noise: raises the noise of a capture by 3 %
NOISE_AT = 50.0  # percentile of the pixels at which the share is meant: the median
PILOT_SPP = 16  # samples per pixel and stop of each picture of the first pair
MOST_SPP = 8192  # samples per pixel and stop of all pictures together
# Noise falls about as samples ** -0.6 to -0.7 (claims noise-slope-*). If a pair misses the target, another follows.
SLOPE = 0.64
MOST_ROUNDS = 4
BAND = 0.1  # pixels whose share is within this of the percentile's tell which stop makes the noise there


class StopPictures(NamedTuple):
    """One picture per stop, and the irradiance field with which they were rendered, for reuse by further renders."""

    rate: FloatArray  # [stop, h, w, channel] mean electrons per second
    field: Any = None  # see :func:`dasim.render.passes.irradiance_field`


@dataclass(frozen=True)
class AdaptiveRender:
    """The mean of several pictures, and the rendering noise that remains in it."""

    rate: FloatArray  # [h, w, channel] mean electrons per second of all stops together
    variance: FloatArray  # [h, w, channel] of ``rate``
    spp: tuple[int, ...]  # samples per pixel of all pictures together, per stop
    share: tuple[float, ...]  # rendering noise over the sensor's at the percentile, per channel
    field: Any  # irradiance of the last picture


def render_to_noise_target(
    picture: Callable[[int, tuple[int, ...]], StopPictures],
    sensor_variance: Callable[[FloatArray], FloatArray],
    *,
    stops: int,
    target: float = NOISE_SHARE,
    percentile: float = NOISE_AT,
    most_spp: int = MOST_SPP,
) -> AdaptiveRender:
    """Render pairs of pictures until their noise is below the share ``target`` of the sensor's.

    The first pair is small; its noise decides the size of the next. All pairs count in the result, weighted by their
    samples.

    Args:
        picture: ``picture(index, spp)`` renders through each stop with ``spp[stop]`` samples per pixel, its random
            numbers keyed by ``index``.
        sensor_variance: variance of the sensor's noise [h, w, channel] for a sum over stops, in its unit squared.
        stops: how many stops the camera has.
        target: rendering noise over the sensor's noise, at the percentile of the pixels, in the worst channel.
        percentile: of the pixels: this share of them, in per cent, has at most ``target``.
        most_spp: bound on the samples per pixel of a stop.
    """
    pairs: list[Pair] = []
    spp = (PILOT_SPP,) * stops
    for number in range(MOST_ROUNDS):
        first, second = picture(2 * number, spp), picture(2 * number + 1, spp)
        pairs.append(Pair((spp, spp), first.rate, second.rate))
        result = measured(pairs)
        shares = shares_by_stop(result, sensor_variance(result.rate), percentile)
        reached = np.sqrt((shares**2).sum(axis=0))
        if reached.max() <= target or max(result.spp) + 2 * PILOT_SPP > most_spp:
            break
        spp = _next_spp(result.spp, shares, target, most_spp)
    variance = result.variance.sum(axis=0)
    return AdaptiveRender(result.rate, variance, result.spp, tuple(float(value) for value in reached), second.field)


def shares_by_stop(result: Measured, limit: FloatArray, percentile: float) -> FloatArray:
    """Noise of each stop over the sensor's at a percentile of the pixels, [stop, channel]; squares sum to the whole's.

    ``limit`` is the variance of the sensor's noise, [h, w, channel].
    """
    whole = share(result.variance.sum(axis=0), limit)
    reached = shares_at(whole, [percentile])[0]
    away = np.abs(whole - reached)
    near = away <= np.maximum(BAND * reached, away.min(axis=(0, 1)))
    part = np.where(near, result.variance / np.where(limit > 0, limit, 1.0), 0.0).sum(axis=(1, 2))
    total = part.sum(axis=0)
    return np.asarray(reached * np.sqrt(np.divide(part, total, out=np.zeros_like(part), where=total > 0)))


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
