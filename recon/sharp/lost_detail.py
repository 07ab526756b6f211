"""Detail near focus that the samples of the mosaic show and an all-in-focus picture lacks.

In focus, the captured picture equals the sharp picture except for noise, so an all-in-focus picture by any method must
agree with the samples. If the difference exceeds the noise, for example where a network mistakes stripes as fine as the
mosaic for artefacts of the mosaic, the samples are right. With the samples s of a channel, their noise variance v, the
picture f, and f blurred by the visible blur of each pixel's level, B f, let

    q = sum of (s - B f)^2 / sum of v

in a window around each pixel. A fraction 1 - 1 / q of s - B f is signal (a Wiener filter for a flat spectrum). This
fraction, interpolated between the samples, is added to f. The interpolated captured picture is not used, because it has
artefacts that f does not have. If the blur of the level plus its standard deviation explains the samples better, B is
that blur, so that a picture that may be right is not changed.

Tested in tests/recon/sharp/test_lost_detail.py.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import cv2
import numpy as np

from dasim.typing import BoolArray, Float32Array

# Both chosen on ``tune``.
WINDOW_PX = 7.0  # sigma
LEVELS = (0.5, 2.5)  # full weight up to the first level, none from the second on
DISC = 0.25  # standard deviation of a disc along an axis, over its diameter
SIGMAS_PX = np.arange(0.0, 1.3, 0.25)  # of the blurs that B f is interpolated from
BILINEAR = np.outer([0.5, 1.0, 0.5], [0.5, 1.0, 0.5]).astype(np.float32)  # between samples at every second pixel
STRIP_PX, HALO_PX = 256, 36  # rows at a time, even, and rows around them that they depend on


class Samples(NamedTuple):
    """The mosaic's samples of a channel."""

    sites: BoolArray  # pixels that it was sampled at, [h, w]
    value_e: Float32Array  # [h, w] electrons, read at the sites alone
    variance: Float32Array  # of the noise, [h/2, w/2]


def restore(
    sharp_e: Float32Array,
    samples: Sequence[Samples | None],
    level: Float32Array,
    sd: Float32Array,
    px_per_level: float,
) -> None:
    """Bring lost detail back to an all-in-focus picture, in place.

    Args:
        sharp_e: the picture, [h, w, 3] electrons.
        samples: of the three channels, with their noise, at every second pixel of every second row at least; a channel
            without any is left as it is.
        level: blur level of each pixel, [h, w].
        sd: its standard deviation, [h, w].
        px_per_level: diameter of visible blur per level.
    """
    height = len(level)
    above = sharp_e[:0]  # original values of rows that the previous strip has changed
    for top in range(0, height, STRIP_PX):
        bottom = min(top + STRIP_PX, height)
        first, last = top - len(above), min(bottom + HALO_PX, height)
        rows = slice(first, last)
        strip = np.concatenate([above, sharp_e[top:last]])
        above = sharp_e[max(bottom - HALO_PX, 0) : bottom].copy()
        size = np.abs(level[rows]).astype(np.float32)
        if size[top - first : bottom - first].min() >= LEVELS[1]:
            continue
        halves = slice(first // 2, -(-last // 2))
        least, lost = np.full(strip.shape, np.inf, np.float32), np.zeros_like(strip)
        places = [_place(np.float32(DISC * px_per_level) * blur) for blur in (size, size + sd[rows])]
        for channel, whole in enumerate(samples):
            if whole is None:
                continue
            one = Samples(whole.sites[rows], whole.value_e[rows], whole.variance[halves])
            blurs = _blurs(strip[..., channel])
            for place in places:
                share, difference = _unexplained(one, _between(blurs, place))
                better = share < least[..., channel]
                np.copyto(least[..., channel], share, where=better)
                np.copyto(lost[..., channel], share * difference, where=better)
        lost *= np.interp(size, LEVELS, (1, 0)).astype(np.float32)[..., None]
        sharp_e[top:bottom] += lost[top - first : bottom - first]


def _place(sigma_px: Float32Array) -> Float32Array:
    """Fractional index among ``SIGMAS_PX``, the last for larger ones."""
    return np.minimum(sigma_px / np.float32(SIGMAS_PX[1]), np.float32(len(SIGMAS_PX) - 1))


def _blurs(image: Float32Array) -> list[Float32Array]:
    """An image [h, w] blurred by each of ``SIGMAS_PX``."""
    image = np.ascontiguousarray(image)
    return [image, *(np.asarray(cv2.GaussianBlur(image, (0, 0), float(sigma)), np.float32) for sigma in SIGMAS_PX[1:])]


def _between(blurs: Sequence[Float32Array], place: Float32Array) -> Float32Array:
    """Linear interpolation between images at the fractional index of each pixel, [h, w]."""
    weights = (np.maximum(1 - np.abs(place - np.float32(number)), 0) for number in range(len(blurs)))
    return np.asarray(sum(weight * blur for weight, blur in zip(weights, blurs, strict=True)), np.float32)


def _unexplained(samples: Samples, blurred: Float32Array) -> tuple[Float32Array, Float32Array]:
    """Difference between samples and a blurred picture [h, w]: the share of it that noise does not explain, and the
    difference itself, interpolated between the samples, [h, w] each.
    """
    mask = samples.sites.astype(np.float32)
    difference = mask * (samples.value_e - blurred)
    size, half = blurred.shape[::-1], samples.variance.shape[::-1]
    squares, count = (cv2.resize(part, half, interpolation=cv2.INTER_AREA) for part in (difference**2, mask))
    found, noise = (
        cv2.GaussianBlur(part, (0, 0), WINDOW_PX / 2, borderType=cv2.BORDER_REFLECT)
        for part in (squares, count * samples.variance)
    )
    share = np.maximum(1 - noise / np.maximum(found, np.float32(1e-9)), 0)
    near, weight = (cv2.filter2D(part, -1, BILINEAR, borderType=cv2.BORDER_REFLECT) for part in (difference, mask))
    interpolated = near / np.maximum(weight, BILINEAR.min())
    return np.asarray(cv2.resize(share, size, interpolation=cv2.INTER_LINEAR), np.float32), interpolated
