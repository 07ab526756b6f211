"""Adaptive sampling: rendering noise is measured between pictures and compared with the sensor's noise.

Pictures are rendered in pairs with independent random numbers (:mod:`dasim.simulation.rendering_noise`), so that the
noise is measured, not predicted. The first pair, the pilot, takes a few samples in every pixel: ``FEWEST_SPP`` per
picture where the geometry shows one depth, more where layers have to be told apart. Each pixel then gets
the additional samples that the pilot's noise in the surrounding pixels requires. The pixel's own samples are excluded
from that decision, because they would bias its mean: a bright outlier that brought its pixel more samples would get
less weight. (They do enter the control variate's factor of neighbouring pixels; 71 pictures of glossy surfaces show no
bias from this, to 0.01 %.) Noise measured later is excluded, too, because the samples of a pixel determine the sample
counts of its neighbours, and these would determine its own. If the target is missed, all sample counts grow by one
factor, the smallest that is expected to bring the noise down to the target. Large sample counts are taken in two parts,
the second according to the noise that remains after the first.

A pilot that requires many samples is followed by another pilot with a finer irradiance field, which costs less than the
samples: nodes of a noisy field seem to disagree, and rays are then traced further without need.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from dasim.simulation.rendering_noise import (
    Picture,
    Sums,
    add,
    around,
    measured,
    no_pairs,
    of_sum,
    rates,
    share,
    shared_uncertainty,
    shares_at,
)
from dasim.typing import Float32Array

NOISE_SHARE = 0.25  # of the sensor's noise: raises the noise of a capture by 3 %
NOISE_AT = 50.0  # percentile of the pixels at which the share is meant: the median
# Samples per pixel and stop of each picture: fewest where one depth is seen, and fewest from which layers in depth are
# separated. With 4, pixels that see several depths are up to 1 % off.
FEWEST_SPP, FEWEST_OF_LAYERS, MOST_SPP = 4, 8, 4096
# Allowed sample counts: powers of two, for which Sobol' points are most even, and the values halfway between them.
STEPS = np.array(sorted({*(4 << k for k in range(11)), *(6 << k for k in range(10))}))
MOST_ROUNDS = 4
SLOPE = 1.1  # variance falls about as samples ** -1.0 to -1.2 (claim fewer-rays)
# If the pilot requires more than FAR times its own samples, only a part of them is taken first, because the noise
# cannot be predicted that far ahead.
FAR, PART_OF_FAR = 8.0, 0.5
AIM = 0.98  # of the target: the noise for which a further round is planned
MOST_MORE, MORE_BISECTIONS = 8.0, 8  # largest factor of a further round, and bisection steps to find it
NEARLY = 1.05  # a round is not enlarged to get below this multiple of the least noise that it can reach
# Largest noise correlated between neighbours, as a fraction of the target standard deviation, in the pilot and in later
# pairs, which have cost more. Above it, further pictures use an irradiance field with up to MOST_FINER times the
# directions.
SHARED, SHARED_LATER, MOST_FINER = 0.5, 0.7, 16
CERTAIN = 3.0  # standard errors by which it must exceed that fraction
# Noise of the irradiance field causes unnecessary rays in proportion to 1 / f, and a field with f times the directions
# costs in proportion to f. For N required rays per pixel, the best f is therefore sqrt(N / constant). Of the constants
# 40 and 160, tried on four random scenes, 160 took less time.
RAYS_PER_FINENESS = 160.0
LEAST_LIGHT = 0.1  # of the mean, added to the light that noise is compared with: saves samples in nearly black pixels
# The scale that gives the mean number of samples is found by bisection, from every third row and column.
SPARSE, BISECTIONS = slice(None, None, 3), 24
LARGE_FRAME_PX = 600_000


@dataclass(frozen=True)
class AdaptiveRender:
    """Several pictures together, and the rendering noise that remains in their mean."""

    sums: Sums  # :func:`rendering_noise.rates` has their mean
    variance: NDArray[np.floating]  # of the sum over stops, [h, w, channel], mean over a few pixels
    share: tuple[float, ...]  # rendering noise over the sensor's at the percentile, per channel


def render_to_noise_target(
    picture: Callable[[int, int, NDArray[np.int64], int], Picture],
    sensor_variance: Callable[[NDArray[np.floating]], NDArray[np.floating]],
    fewest_spp: NDArray[np.int64],
    *,
    target: float = NOISE_SHARE,
    percentile: float = NOISE_AT,
    most_spp: int = MOST_SPP,
    kept: Sequence[float] | None = None,
) -> AdaptiveRender:
    """Render pairs of pictures until their noise is below the share ``target`` of the sensor's.

    The result is the mean of all pairs with the finest irradiance field, weighted by their samples. Noise that is
    correlated between neighbouring pixels comes from the irradiance field, and more samples do not reduce it. Once it
    is significantly too large, all pairs so far are discarded, and new ones use a finer field. A pilot that is followed
    by another pilot is discarded, too.

    Args:
        picture: ``picture(number, index, spp, finer)`` renders the stop of a ``number`` with its part of ``spp``
            samples, [stop, h, w], with random numbers keyed by ``index``, and with an irradiance of ``finer`` times as
            many directions, which every second picture shares. The result has this stop alone.
        sensor_variance: variance of the sensor's noise [h, w, channel] for a sum over stops, in its unit squared.
        fewest_spp: samples per pixel of each picture of the first pair, and fewest of a further one, [stop, h, w].
        target: rendering noise over the sensor's noise, at the percentile of the pixels, in the worst channel.
        percentile: of the pixels: this share of them, in per cent, has at most ``target``.
        most_spp: bound on the samples per pixel and stop of a picture.
        kept: share of each stop's light that glare does not spread; 1 by default.
    """
    sums: Sums | None = None
    spp, shape = fewest_spp, fewest_spp.shape
    factor, number, rounds, pilot_wants, finer = 1.0, 0, 0, np.zeros(shape, np.float32), 1
    while True:
        for stop in range(shape[0]):  # apart: pictures of large frames take gigabytes
            first, second = (picture(stop, index, spp, finer) for index in (2 * number, 2 * number + 1))
            sums = no_pairs(first, shape[0]) if sums is None else sums
            add(sums.of_stop(stop), first, second)
            del first, second
        assert sums is not None
        limit, noise = sensor_variance(_total_rate(sums)), _Noise(*of_sum(sums, kept))
        of_all, of_samples, of_irradiance = (
            max(_shares(part, limit, percentile)) for part in (noise.of_all, noise.of_samples, noise.of_irradiance)
        )
        # The part of the target that remains for the noise of the samples, besides that of the irradiance field.
        most = SHARED_LATER if rounds else SHARED
        own_target = float(np.sqrt(max(target**2 - of_irradiance**2, (1 - most**2) * target**2)))
        uncertain = CERTAIN * shared_uncertainty(shape[1:]) * of_all**2
        is_fine = finer == MOST_FINER or of_irradiance**2 <= (most * target) ** 2 + uncertain
        if of_all <= target or (of_samples <= own_target and is_fine) or rounds == MOST_ROUNDS - 1:
            break
        number += 1
        needs_pilot = False
        if rounds and is_fine:
            left = _left(pilot_wants, sums, noise, limit, fewest_spp, kept)
            factor = _least_factor(left, AIM * own_target, percentile, most_spp, factor)
            del left
        elif not rounds:
            pilot_wants = wanted_spp(sums, noise, sensor_variance, own_target, percentile)
            is_far = pilot_wants.mean() > FAR * sums.spp.mean()
            factor = PART_OF_FAR if is_far else 1.0
            worthwhile = _worthwhile_fineness(pilot_wants)
            needs_pilot = is_far and finer < worthwhile
        if needs_pilot:
            finer, sums = worthwhile, None
        elif is_fine:
            spp = next_spp(factor * pilot_wants - sums.spp, fewest_spp, most_spp)
        else:  # begin anew
            wanted = finer * (of_irradiance / (SHARED * target)) ** 2
            finer, sums = int(min(2 ** np.ceil(np.log2(wanted)), MOST_FINER)), None
            spp = np.maximum(next_spp(factor * pilot_wants, fewest_spp, most_spp), fewest_spp)
        if not spp.any():
            break
        rounds += not needs_pilot
        del noise, limit  # before the next pictures
    assert sums is not None
    return AdaptiveRender(sums, noise.variance, tuple(_shares(noise.of_all, limit, percentile)))


class _Noise(NamedTuple):
    """Variance of the sum over stops, and the part of it that is correlated between neighbours, [h, w, channel].

    The methods return the channel of an index, [h, w, 1]: what is computed of all channels of a large frame together
    takes gigabytes.
    """

    variance: Float32Array
    shared: Float32Array

    def of_all(self, channel: int) -> Float32Array:
        """The whole variance."""
        return self.variance[..., channel : channel + 1]

    def of_irradiance(self, channel: int) -> Float32Array:
        """The part that more samples do not reduce."""
        return self.shared[..., channel : channel + 1]

    def of_samples(self, channel: int) -> Float32Array:
        """The part that more samples reduce."""
        return self.of_all(channel) - self.of_irradiance(channel)


def _total_rate(sums: Sums) -> Float32Array:
    """Mean electrons per second of all stops together, [h, w, channel]."""
    channels = range(sums.rate.shape[-1])
    return np.concatenate([rates(sums.of_channel(channel)).sum(axis=0) for channel in channels], axis=-1)


def _shares(part: Callable[[int], Float32Array], limit: NDArray[np.floating], percentile: float) -> list[float]:
    """Rendering noise over the sensor's at the percentile, by channel; ``part`` is a method of :class:`_Noise`."""
    channels = range(limit.shape[-1])
    ratios = (share(part(channel), limit[..., channel : channel + 1]) for channel in channels)
    return [float(shares_at(ratio, [percentile])[0, 0]) for ratio in ratios]


def _worthwhile_fineness(wants: NDArray[np.floating]) -> int:
    """Factor on the directions of the first irradiance field that pays off for ``wants`` samples, [stop, h, w].

    It is a power of two.
    """
    fineness = np.sqrt(max(float(wants.sum(axis=0).mean()) / RAYS_PER_FINENESS, 1.0))
    return int(min(2 ** np.rint(np.log2(fineness)), MOST_FINER))


class _Left(NamedTuple):
    """Data that determine how many samples a further pair needs; in large frames, of every third row and column."""

    wants: NDArray[np.floating]  # [stop, h, w] samples that the pilot requires
    done: NDArray[np.integer]  # [stop, h, w] samples so far
    fewest: NDArray[np.integer]  # [stop, h, w] fewest samples of each picture
    of_stops: Float32Array  # [stop, h, w, channel] variance of each stop's share of the sum
    variance: Float32Array  # [h, w, channel] of the sum over stops, without noise correlated between neighbours
    limit: NDArray[np.floating]  # [h, w, channel] variance of the sensor's noise


def _left(
    wants: NDArray[np.floating],
    sums: Sums,
    noise: _Noise,
    limit: NDArray[np.floating],
    fewest_spp: NDArray[np.integer],
    kept: Sequence[float] | None,
) -> _Left:
    """The data of :class:`_Left`, channel by channel."""
    at = (SPARSE, SPARSE) if limit[..., 0].size > LARGE_FRAME_PX else (slice(None), slice(None))
    channels = range(limit.shape[-1])
    own = np.stack([measured(sums.of_channel(channel)).variance[:, *at, 0] for channel in channels], axis=-1)
    own *= np.square(1.0 if kept is None else np.array(kept, np.float32))[..., None, None, None]
    of_samples = np.concatenate([noise.of_samples(channel)[at] for channel in channels], axis=-1)
    return _Left(wants[:, *at], sums.spp[:, *at], fewest_spp[:, *at], own, of_samples, limit[at])


def _least_factor(left: _Left, target: float, percentile: float, most_spp: int, factor: float) -> float:
    """The smallest multiple of ``factor``, at most ``MOST_MORE`` times, at which the noise is expected to reach the
    target, or nearly the lowest noise that can be reached.
    """
    wants, done, fewest, own, variance, limit = left
    total = own.sum(axis=0)

    def reached(factor: float) -> float:
        part = done / (done + 2 * next_spp(factor * wants - done, fewest, most_spp))
        kept_part = np.divide((part[..., None] * own).sum(axis=0), total, out=np.zeros_like(total), where=total > 0)
        return float(shares_at(share(kept_part * variance, limit), [percentile])[0].max())

    target = max(target, NEARLY * reached(factor * MOST_MORE))
    low, high = 0.0, np.log(MOST_MORE)
    for _ in range(MORE_BISECTIONS):
        middle = (low + high) / 2
        low, high = (middle, high) if reached(factor * np.exp(middle)) > target else (low, middle)
    return factor * float(np.exp(high))


def wanted_spp(
    pilot: Sums,
    noise: _Noise,
    sensor_variance: Callable[[NDArray[np.floating]], NDArray[np.floating]],
    target: float,
    percentile: float,
) -> Float32Array:
    """Samples that bring each pixel to the target, [stop, h, w], by the noise of a pilot around it.

    With v_s the variance of a stop and N_s its samples, n_s samples have v_s (N_s / n_s)^p. The fewest samples whose
    variances sum to the limit have n_s in proportion to (v_s N_s^p)^(1 / (p + 1)). The pixels beyond the percentile get
    no more than those at it.
    """
    channels = range(pilot.rate.shape[-1])
    light = _total_rate(pilot)
    for channel in channels:
        at = slice(channel, channel + 1)
        light[..., at] = np.maximum(around(light[None, ..., at])[0], 0.0)
    limit = sensor_variance(light)
    done, wanted = pilot.spp.astype(np.float32) ** SLOPE, np.zeros(pilot.rate.shape[:-1], np.float32)
    for channel in channels:
        whole, own = noise.of_all(channel)[..., 0], noise.of_samples(channel)[..., 0]
        own = np.divide(own, whole, out=np.zeros_like(own), where=whole > 0)
        part = (measured(pilot.of_channel(channel)).around[..., 0] * own * done) ** (1 / (SLOPE + 1))
        most = target**2 * limit[..., channel]
        scale = np.divide(part.sum(axis=0), most, out=np.zeros_like(most), where=most > 0) ** (1 / SLOPE)
        np.maximum(wanted, part * scale, out=wanted)
    return np.minimum(wanted, np.percentile(wanted, percentile, axis=(1, 2), keepdims=True).astype(np.float32))


def next_spp(
    missing: NDArray[np.floating], fewest_spp: NDArray[Any] | int = FEWEST_OF_LAYERS, most_spp: int = MOST_SPP
) -> NDArray[np.int64]:
    """Samples of each of the next two pictures where some are missing: one of ``STEPS``, or none where few are."""
    more = missing / 2
    steps = STEPS[STEPS <= most_spp]
    chosen = steps[np.minimum(np.searchsorted(steps, more), len(steps) - 1)]
    return np.where(missing > fewest_spp, np.maximum(chosen, fewest_spp), 0)


def allotted_spp(pilots: Sequence[Sums], mean: float) -> NDArray[np.int64]:
    """Samples of each picture of a further pair, [stop, h, w]; both pictures together take about ``mean`` per pixel and
    stop.

    The allocation minimises the sum over the pixels of the variance relative to shot noise: the samples of each pixel
    are proportional to the standard deviation of one sample (Neyman, Journal of the Royal Statistical Society 97,
    1934), which is estimated from the surrounding pixels. ``pilots`` are pairs of pictures through each stop.
    """
    done = np.concatenate([pilot.spp for pilot in pilots])
    one = np.zeros((len(pilots), *pilots[0].rate.shape[1:-1]), np.float32)
    for channel in range(pilots[0].rate.shape[-1]):
        found = [measured(pilot.of_channel(channel)) for pilot in pilots]
        light = sum(np.maximum(around(part.rate)[0, ..., 0], 0.0) for part in found)
        light += LEAST_LIGHT * light.mean() + np.finfo(np.float32).tiny
        for total, part in zip(one, found, strict=True):
            total += (part.around * part.spp[..., None])[0, ..., 0] / light
    np.sqrt(one, out=one)
    if not one.any():
        return np.zeros(one.shape, np.int64)

    def spp(scale: float, pixels: slice) -> NDArray[np.int64]:
        return next_spp(scale * one[:, pixels, pixels] - done[:, pixels, pixels])

    low, high = np.log(np.array([1e-3, 1e6]) / one.mean())
    for _ in range(BISECTIONS):
        middle = (low + high) / 2
        low, high = (middle, high) if 2 * spp(np.exp(middle), SPARSE).mean() < mean else (low, middle)
    return spp(np.exp(low), slice(None))
