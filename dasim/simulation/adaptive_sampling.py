"""Enough samples, and no more: rendering noise measured between pictures, against the sensor's own noise."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from dasim.typing import FloatArray

NOISE_SHARE = 0.2  # of the sensor's noise: adds 2 % to it
PILOT_SPP = 16  # of each of the first two pictures
MOST_SPP = 8192  # of a stop
SLOPE = 0.6  # noise falls about as samples ** -0.6 to -0.7 (claims noise-slope-*); too few are added to
MOST_ROUNDS = 4
# Median of |x| for a normal x of spread 1: turns the median difference of two pictures into a standard deviation.
_MEDIAN_OF_ABSOLUTE = 0.6745


@dataclass(frozen=True)
class Quiet:
    """A picture as the mean of several, and what is left of their noise."""

    rate: FloatArray  # [h, w, channel] mean electrons a second
    spp: tuple[int, ...]  # of all pictures together, a stop
    share: tuple[float, ...]  # rendering noise over the sensor's at the median pixel, a channel


Pair = tuple[tuple[int, ...], FloatArray, FloatArray]  # samples of each stop in one picture, and two, [stop, h, w, ch]


def quiet_picture(
    picture: Callable[[int, tuple[int, ...]], FloatArray],
    sensor_noise: Callable[[FloatArray], FloatArray],
    *,
    stops: int,
    wanted: float = NOISE_SHARE,
    most_spp: int = MOST_SPP,
) -> Quiet:
    """Render pairs of pictures until their noise is below the share ``wanted`` of the sensor's.

    ``picture(index, spp)`` renders one through each stop with so many samples, electrons a second, [stop, h, w,
    channel], its randomness keyed by ``index``; ``sensor_noise`` gives the sensor's noise in the same unit for their
    sum. The first pair is small and tells how large the next must be; all count in the result, by their samples. The
    noise of a pair's mean is half the difference of its pictures.
    """
    pairs: list[Pair] = []
    spp = (PILOT_SPP,) * stops
    for number in range(MOST_ROUNDS):
        pairs.append((spp, picture(2 * number, spp), picture(2 * number + 1, spp)))
        rate, taken, shares = _joined(pairs, sensor_noise)
        whole = np.sqrt((shares**2).sum(axis=0))
        if whole.max() <= wanted or max(taken) + 2 * PILOT_SPP > most_spp:
            break
        spp = _next_spp(taken, shares, wanted, most_spp)
    return Quiet(rate, taken, tuple(float(share) for share in whole))


def _next_spp(taken: tuple[int, ...], shares: FloatArray, wanted: float, most_spp: int) -> tuple[int, ...]:
    """Samples of each stop in the next two pictures: more where that helps the worst channel most, until it does."""
    spp = [PILOT_SPP for _ in taken]

    def expected(counts: list[int]) -> FloatArray:
        grown = np.array([(have + 2 * more) / have for have, more in zip(taken, counts, strict=True)])
        return (shares * grown[:, None] ** -SLOPE) ** 2

    while (expected(spp).sum(axis=0) > wanted**2).any():
        worst = int(expected(spp).sum(axis=0).argmax())
        free = [i for i, have in enumerate(taken) if have + 2 * _more(spp[i]) <= most_spp]
        if not free:
            break
        stop = max(free, key=lambda i: float(expected(spp)[i, worst]) / spp[i])
        spp[stop] = _more(spp[stop])
    return tuple(spp)


def _more(spp: int) -> int:
    """The next of 16, 20, 24, 28, 32, 40, ...: quarters of powers of two, over which Sobol' points are even."""
    return spp + (1 << (spp.bit_length() - 3))


def _joined(
    pairs: list[Pair], sensor_noise: Callable[[FloatArray], FloatArray]
) -> tuple[FloatArray, tuple[int, ...], FloatArray]:
    """Mean picture, samples of each stop in it, and noise over the sensor's at the median pixel, [stop, channel]."""
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
