"""Rendering noise of a picture, measured between independent pictures of the same view, and its share of the sensor's.

Every picture through the lens is the mean of pictures with independent random numbers and irradiance fields, in pairs.
Half the difference of a pair has the noise of its mean, whatever makes it: the places on the lens and in the pixel,
wavelengths, lamps, the irradiance field, and the ratio estimators of wave optics and of layers. No formula of the
variance is needed, and none is assumed.

Tested in tests/dasim/simulation/test_adaptive_sampling.py.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy import ndimage

from dasim.typing import FloatArray

# A difference of two pictures has one degree of freedom per pixel. The noise of pixels is independent and alike nearby:
# the mean over a window of this width has 25, and a standard deviation that is known to 14 %.
WINDOW_PX = 5
PERCENTILES = (50.0, 95.0, 99.5)  # of the pixels, at which the share of the sensor's noise is stated


class Pair(NamedTuple):
    """Two independent pictures of a view, through each stop."""

    spp: tuple[tuple[int, ...], tuple[int, ...]]  # samples per pixel of each stop, of the first and of the second
    first: FloatArray  # [stop, h, w, channel] mean electrons per second
    second: FloatArray


class Measured(NamedTuple):
    """The mean of pairs of pictures, and its variance."""

    rate: FloatArray  # [h, w, channel] mean electrons per second of all stops together
    variance: FloatArray  # [stop, h, w, channel] of each stop's part of ``rate``
    spp: tuple[int, ...]  # samples per pixel of all pictures together, per stop


def measured(pairs: Sequence[Pair]) -> Measured:
    """The mean of all pictures, weighted by their samples, and its variance.

    Two pictures a, b of m and n samples have the mean (m a + n b) / (m + n), whose variance is the expectation of
    (a - b)^2 m n / (m + n)^2. It is averaged over ``WINDOW_PX``.
    """
    spp = np.array([pair.spp for pair in pairs], dtype=float)[..., None, None, None]  # [pair, 2, stop, 1, 1, 1]
    total = spp.sum(axis=(0, 1))
    rate = sum((s[0] * pair.first + s[1] * pair.second) / total for s, pair in zip(spp, pairs, strict=True))
    squares = sum(s[0] * s[1] * ((p.first - p.second) / total) ** 2 for s, p in zip(spp, pairs, strict=True))
    window = (1, WINDOW_PX, WINDOW_PX, 1)
    variance = np.maximum(ndimage.uniform_filter(np.asarray(squares), window), 0.0)
    return Measured(np.asarray(rate).sum(axis=0), variance, tuple(int(n) for n in total.ravel()))


def share(variance: FloatArray, sensor_variance: FloatArray) -> FloatArray:
    """Standard deviation of rendering noise over that of the sensor's, [h, w, channel]; 0 where there is no noise."""
    ratio = np.divide(variance, sensor_variance, out=np.zeros_like(variance), where=sensor_variance > 0)
    return np.asarray(np.sqrt(ratio))


def shares_at(ratio: FloatArray, percentiles: Sequence[float] = PERCENTILES) -> FloatArray:
    """Percentiles of a share [h, w, channel] over the pixels, [percentile, channel]."""
    return np.asarray(np.percentile(ratio, percentiles, axis=(0, 1)))
