"""Rendering noise of a picture, measured between independent pictures of the same view, relative to sensor noise.

Every picture through the lens is the mean of pairs of pictures with independent random numbers and irradiance fields.
Half the difference of a pair has the same noise as the mean of the pair, whatever its source: positions on the lens and
in the pixel, wavelengths, lamps, the irradiance field, and the ratio estimators of wave optics and of layers. No
formula for the variance is needed or assumed. The bias of the ratio estimators is removed by means of their
denominators (``_joined``), except in pixels that see several depths.

Each picture S comes with a control variate T, whose expectation is 0 (:mod:`dasim.render.control_variate`): S - b T has
the expectation of S for every factor b that does not depend on the samples of the pixel. The best factor,
cov(S, T) / var(T), is estimated from the differences of the pairs in the surrounding pixels.

Tested in tests/dasim/simulation/test_rendering_noise.py.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from dasim.render.host_threads import in_threads
from dasim.typing import Float32Array, FloatArray

# A difference of two pictures has one degree of freedom per pixel, and nearby pixels have similar noise, so squares are
# averaged over a window. Reported variances use these weights for its rows and columns: 18 degrees of freedom, so that
# a standard deviation is known to 17 %. With uniform weights, it is known to 14 %, but the noise of an edge spreads
# farther.
WINDOW_PX = 5
WEIGHTS = np.array([1, 2, 3, 2, 1]) / 9
SHARED_PX = 81  # side of the window over which the noise correlated between neighbours is averaged
PERCENTILES = (50.0, 95.0, 99.5)  # of the pixels, at which the share of the sensor's noise is stated
MOST_FACTOR = 1.5  # of the control variate
STRIP_ROWS = 256  # that are computed at once, which limits the memory


class Picture(NamedTuple):
    """A picture of a view through each stop."""

    spp: NDArray[np.int64]  # [stop, h, w] or [stop, 1, 1] samples per pixel of each stop
    rate: NDArray[np.floating]  # [stop, h, w, channel] mean electrons per second
    variate: NDArray[np.floating]  # the control variate
    light: NDArray[np.float32] | float = 1.0  # denominator of the ratio ``rate``, over its expectation
    variate_light: NDArray[np.float32] | float = 1.0  # of ``variate``


class Measured(NamedTuple):
    """The mean of pictures, and its variance."""

    rate: Float32Array  # [stop, h, w, channel] mean electrons per second through each stop
    variance: Float32Array  # [stop, h, w, channel] of ``rate``, mean by ``WEIGHTS``
    around: Float32Array  # the same, as the unweighted mean of the surrounding pixels without the pixel itself
    spp: NDArray[np.int64]  # [stop, h, w] or [stop, 1, 1] samples per pixel of all pictures together


class Sums(NamedTuple):
    """Sums over pairs of pictures, from which :func:`measured` computes mean and variance; the memory does not depend
    on the number of pairs.

    A pair of pictures a and b with m and n samples adds m a + n b and sqrt(m n) (a - b). Differences keep their signs,
    so that noise common to all first pictures, or to all second ones, is measured as such: that of their irradiance
    field.
    """

    spp: NDArray[np.int64]  # [stop, h, w] or [stop, 1, 1] samples per pixel
    rate: Float32Array  # [stop, h, w, channel] of the pictures
    variate: Float32Array  # of their control variates
    difference: Float32Array  # of the pictures
    variate_difference: Float32Array  # of the control variates

    def of_stop(self, number: int) -> Sums:
        """Those of one stop, a view."""
        return _part_of_sums(self, (slice(number, number + 1), slice(None), slice(None), slice(None)))

    def of_channel(self, number: int) -> Sums:
        """Those of one channel, a view."""
        return _part_of_sums(self, (slice(None), slice(None), slice(None), slice(number, number + 1)))


def no_pairs(like: Picture, stops: int = 1) -> Sums:
    """Sums of no pairs, for pictures of the shapes of ``like``, which has one stop or all of them."""
    spp = np.repeat(np.zeros_like(like.spp), stops, axis=0)
    shape = np.broadcast_shapes(like.rate.shape, (*like.spp.shape, 1))
    shape = (stops * shape[0], *shape[1:])
    return Sums(spp, *(np.zeros(shape, np.float32) for _ in range(4)))


def add(sums: Sums, first: Picture, second: Picture) -> None:
    """Add a pair to the sums, in place."""

    def add_part(part: _Strip) -> None:
        _add(_part_of_sums(sums, part.own), _part(first, part.own), _part(second, part.own))

    in_threads(add_part, _parts(sums.rate.shape))
    np.add(sums.spp, first.spp + second.spp, out=sums.spp)


def measured(sums: Sums) -> Measured:
    """The mean of all pictures, weighted by their samples, with the best factor of the control variate; its variance.

    Two pictures a, b of m and n samples have the mean (m a + n b) / (m + n), whose variance is the expectation of
    (a - b)^2 m n / (m + n)^2; likewise the sums over the first and over the second pictures of pairs of equal samples.
    It is averaged by ``WEIGHTS``.
    """
    rate, variance, beside = (np.empty(sums.rate.shape, np.float32) for _ in range(3))

    def measure(part: _Strip) -> None:
        found = _measured(_part_of_sums(sums, part.wider))
        for whole, values in zip((rate, variance, beside), found, strict=True):
            whole[part.own] = values[:, part.inner]

    in_threads(measure, _parts(sums.rate.shape, WINDOW_PX - 1))  # a window of windows
    return Measured(rate, variance, beside, sums.spp.copy())


def rates(sums: Sums) -> Float32Array:
    """``rate`` of :func:`measured` alone."""
    rate = np.empty(sums.rate.shape, np.float32)

    def fill(part: _Strip) -> None:
        rate[part.own] = _mean_and_left(_part_of_sums(sums, part.wider))[0][:, part.inner]

    in_threads(fill, _parts(rate.shape, WINDOW_PX // 2))
    return rate


def of_sum(sums: Sums, kept: Sequence[float] | None = None) -> tuple[Float32Array, Float32Array]:
    """Variance of the sum over stops, averaged by ``WEIGHTS``, and the part of it that is correlated between
    neighbouring pixels, [h, w, channel].

    More samples per pixel do not reduce that part, a finer irradiance field does. With n pixels in a window, n times
    the square of their mean difference exceeds the mean of their squares by n - 1 times that part. The stops share the
    irradiance field, so their differences are added before they are squared; ``kept`` are factors on the stops, 1 by
    default.
    """
    stops, height, width, channels = sums.rate.shape
    variance, shared = np.empty((2, height, width, channels), np.float32)

    def fill(channel: int) -> None:
        left = np.zeros((height, width))
        for stop in range(stops):
            at = slice(stop, stop + 1), slice(None), slice(None), slice(channel, channel + 1)
            left += _mean_and_left(_part_of_sums(sums, at))[1][0, ..., 0] * (1.0 if kept is None else kept[stop])
        variance[..., channel], shared[..., channel] = _variances(left)

    in_threads(fill, range(channels))
    return variance, shared


def _variances(left: FloatArray) -> tuple[FloatArray, FloatArray]:
    """:func:`of_sum` of the differences [h, w] of a channel."""
    pixels = WINDOW_PX**2
    excess = pixels * ndimage.uniform_filter(left, WINDOW_PX) ** 2 - ndimage.uniform_filter(left**2, WINDOW_PX)
    variance = _weighted(left**2, (0, 1))
    return variance, np.clip(ndimage.uniform_filter(excess, SHARED_PX) / (pixels - 1), 0.0, variance)


def shared_uncertainty(shape: tuple[int, ...]) -> float:
    """Standard error of the correlated part of :func:`of_sum` relative to the whole variance, for uncorrelated noise in
    a frame of ``shape`` [y, x]: that of the mean square of the available number of window means.
    """
    pixels = WINDOW_PX**2
    windows = np.prod([min(extent, SHARED_PX) for extent in shape]) / pixels
    return float(np.sqrt(2 / windows) / (pixels - 1))


def mean_and_left(first: Picture, second: Picture) -> tuple[Float32Array, Float32Array]:
    """``rate`` of :func:`measured`, of one pair, and the differences whose squares are its variance."""
    shape = np.broadcast_shapes(first.rate.shape, (*first.spp.shape, 1))
    rate, left = np.empty(shape, np.float32), np.empty(shape, np.float32)

    def fill(part: _Strip) -> None:
        a, b = _part(first, part.wider), _part(second, part.wider)
        sums = no_pairs(a)
        _add(sums, a, b)
        found = _mean_and_left(sums._replace(spp=a.spp + b.spp))
        for whole, values in zip((rate, left), found, strict=True):
            whole[part.own] = values[:, part.inner]

    in_threads(fill, _parts(shape, WINDOW_PX // 2))
    return rate, left


def mean_square(left: NDArray[np.floating]) -> FloatArray:
    """Mean of squares by ``WEIGHTS``, [h, w, channel]: the variance that differences stand for."""
    return _weighted(left.astype(float) ** 2, (0, 1))


def _weighted(values: FloatArray, axes: tuple[int, int]) -> FloatArray:
    """Mean by ``WEIGHTS`` along rows and columns, which are the ``axes``; the frame is mirrored at its edge."""
    for axis in axes:
        values = ndimage.correlate1d(values, WEIGHTS, axis=axis)
    return values


class _Strip(NamedTuple):
    """Some rows of a stop and a channel, without and with rows around them, [stop, y, x, channel]."""

    own: tuple[slice, ...]
    wider: tuple[slice, ...]
    inner: slice  # rows of ``own`` within ``wider``


def _parts(shape: tuple[int, ...], around: int = 0) -> Iterator[_Strip]:
    """Strips of each stop and channel, with up to ``around`` more rows on either side: intermediate arrays of all of a
    large frame take gigabytes.
    """
    for stop, channel, top in itertools.product(range(shape[0]), range(shape[3]), range(0, shape[1], STRIP_ROWS)):
        bottom = min(top + STRIP_ROWS, shape[1])
        first, last = max(top - around, 0), min(bottom + around, shape[1])
        own, wider = (
            (slice(stop, stop + 1), slice(*rows), slice(None), slice(channel, channel + 1))
            for rows in ((top, bottom), (first, last))
        )
        yield _Strip(own, wider, slice(top - first, bottom - first))


def _part(picture: Picture, at: tuple[slice, ...]) -> Picture:
    """A stop and a channel of a picture."""
    light, variate_light = (
        each if isinstance(each, float) else each[at] for each in (picture.light, picture.variate_light)
    )
    return Picture(_samples_at(picture.spp, at), picture.rate[at], picture.variate[at], light, variate_light)


def _part_of_sums(sums: Sums, at: tuple[slice, ...]) -> Sums:
    """The same part of sums, a view."""
    spp, rate, variate, difference, variate_difference = sums
    return Sums(_samples_at(spp, at), rate[at], variate[at], difference[at], variate_difference[at])


def _samples_at(spp: NDArray[np.int64], at: tuple[slice, ...]) -> NDArray[np.int64]:
    """Samples of a part, of each of its pixels or of all, a view."""
    return spp[at[0]] if spp.shape[1] == 1 else spp[at[:3]]


def _add(sums: Sums, first: Picture, second: Picture) -> None:
    """Add a pair to the sums of a part, but for its samples."""
    m, n = (each.spp[..., None].astype(float) for each in (first, second))
    parts = (
        (sums.rate, _joined((m, first.rate, first.light), (n, second.rate, second.light))),
        (sums.variate, _joined((m, first.variate, first.variate_light), (n, second.variate, second.variate_light))),
        (sums.difference, np.sqrt(m * n) * (first.rate - second.rate)),
        (sums.variate_difference, np.sqrt(m * n) * (first.variate - second.variate)),
    )
    for total, value in parts:
        np.add(total, value, out=total, casting="same_kind")


def _measured(sums: Sums) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Mean, variance, and variance from the pixels around each, of a part."""
    rate, left = _mean_and_left(sums)
    return rate, _weighted(left**2, (1, 2)), np.maximum(around(left**2), 0.0)


def _mean_and_left(sums: Sums) -> tuple[FloatArray, FloatArray]:
    """Mean of a part with its control variate, and the residual differences, whose squares are the mean's variance."""
    weight = np.maximum(sums.spp, 1)[..., None].astype(float)
    difference, other = sums.difference / weight, sums.variate_difference / weight
    above, below = around(difference * other), around(other**2)
    factor = np.clip(np.divide(above, below, out=np.zeros_like(above), where=below > 0), 0.0, MOST_FACTOR)
    return (sums.rate - factor * sums.variate) / weight, difference - factor * other


def _joined(*parts: tuple[FloatArray, NDArray[np.floating], NDArray[np.float32] | float]) -> FloatArray:
    """Sum of two ratios, weighted by their samples, without the bias that falls as 1 / samples.

    ``parts`` are the weight, the ratio and its denominator. Ratios of sums over m and n samples have the biases c / m
    and c / n; their mean, weighted by samples, has 2 c / (m + n), the ratio of the sums over all samples c / (m + n).
    Twice the latter less the former has none (Quenouille, Biometrika 43, 1956).
    """
    total = sum(weight for weight, _, _ in parts)
    # A part whose rays all have the weight 0 carries no information.
    says = [np.where(light > 0, weight, 0.0) for weight, _, light in parts]
    mean = sum(weight * ratio for weight, (_, ratio, _) in zip(says, parts, strict=True))
    mean = np.divide(total * mean, sum(says), out=np.zeros_like(mean), where=sum(says) > 0)
    light = sum(weight * light for weight, _, light in parts)
    above = sum(weight * light * ratio for weight, ratio, light in parts)
    of_all = np.divide(total * above, light, out=np.array(mean), where=light > 0)
    return np.asarray(2 * of_all - mean)


def around(values: NDArray[np.floating]) -> NDArray[np.floating]:
    """Mean over a window of ``WINDOW_PX`` without its middle and within the frame, [stop, h, w, channel]."""
    rows, columns = (_in_window(extent) for extent in values.shape[1:3])
    inside = np.multiply.outer(rows, columns) - 1
    total = ndimage.uniform_filter(values, (1, WINDOW_PX, WINDOW_PX, 1), mode="constant") * WINDOW_PX**2 - values
    return np.asarray(total / np.maximum(inside, 1)[..., None])


def _in_window(extent: int) -> NDArray[np.int64]:
    """Number of positions inside the range 0..``extent`` of a window centred at each position in it."""
    place, half = np.arange(extent), WINDOW_PX // 2
    return np.minimum(place, half) + np.minimum(extent - 1 - place, half) + 1


def share(variance: NDArray[np.floating], sensor_variance: NDArray[np.floating]) -> NDArray[np.floating]:
    """Standard deviation of rendering noise over that of the sensor's, [h, w, channel]; 0 where there is no noise."""
    ratio = np.divide(variance, sensor_variance, out=np.zeros_like(variance), where=sensor_variance > 0)
    return np.asarray(np.sqrt(ratio))


def shares_at(ratio: NDArray[np.floating], percentiles: Sequence[float] = PERCENTILES) -> FloatArray:
    """Percentiles of a share [h, w, channel] over the pixels, [percentile, channel]."""
    return np.asarray(np.percentile(ratio, percentiles, axis=(0, 1)))
