"""Detail near focus that an all-in-focus picture shows and the samples of the mosaic do not confirm.

Networks take noise of dim pictures for texture, and the texture of one channel for that of all. In focus, the samples
decide. Let f be the picture, blurred by the visible blur of each pixel's level, s the samples of a channel with the
noise variance v, and H the difference between a sample and the mean of the four nearest samples of its channel. With
sums in a window around each pixel, the regression of H s on H f

    g = (sum of (H f)(H s) / v + P) / (sum of (H f)^2 / v + P)

is the share of the picture's detail that the samples have, with a prior of precision P that it is 1. Where g is below
1, the picture is mixed with the captured one, whose noise has been reduced, in the ratio g to 1 - g. Smooth surfaces
have no H f, and keep g = 1.

Tested in tests/recon/sharp/test_false_detail.py.
"""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np

from dasim.typing import Float32Array
from recon.sharp.samples import WINDOW_PX, Samples, between, blurs, change_near_focus, place, weights, window_means

PRECISION = 4.0  # of the prior; 1 to 4 tie on ``tune``
BESIDE = np.zeros((5, 5), np.float32)  # samples of a channel are two pixels apart
BESIDE[[0, 4, 2, 2], [2, 2, 0, 4]] = 1
WINDOW_BLOCKS = 4 * np.pi * (WINDOW_PX / 2) ** 2  # blocks that a Gaussian window averages


def remove(
    sharp_e: Float32Array,
    samples: Sequence[Samples | None],
    captured_e: Float32Array,
    blur_px: Float32Array,
) -> None:
    """Take unconfirmed detail from an all-in-focus picture, in place.

    Args:
        sharp_e: the picture, [h, w, 3] electrons.
        samples: of the three channels, with their noise, at every second pixel of every second row at least; a channel
            without any is left as it is.
        captured_e: the captured picture, its noise reduced, [h, w, 3].
        blur_px: diameter of the visible blur of each pixel, [h, w], of either sign.
    """

    def unconfirmed(strip: Float32Array, own: list[Samples | None], rows: slice) -> Float32Array:
        mixture, result = weights(place(np.abs(blur_px[rows]).astype(np.float32))), np.zeros_like(strip)
        for channel, one in enumerate(own):
            if one is not None:
                image = strip[..., channel]
                share = _confirmed(one, between(blurs(image), mixture))
                result[..., channel] = (1 - share) * (captured_e[rows, :, channel] - image)
        return result

    change_near_focus(sharp_e, samples, blur_px, unconfirmed)


def _confirmed(samples: Samples, blurred: Float32Array) -> Float32Array:
    """The share g of the detail of a blurred picture [h, w] that the samples have, 0..1, [h, w]."""
    mask = samples.sites.astype(np.float32)
    own, measured = _detail(blurred, mask), _detail(samples.value_e, mask)
    count = cv2.resize(mask, samples.variance.shape[::-1], interpolation=cv2.INTER_AREA)
    both, square, noise, number = window_means(
        [own * measured, own**2, count * samples.variance, count], samples.variance.shape
    )
    of_noise = 4 * WINDOW_BLOCKS * number / np.maximum(noise, np.float32(1e-9))  # sums over pixels, not means
    share = (both * of_noise + PRECISION) / (square * of_noise + PRECISION)
    return np.asarray(cv2.resize(np.clip(share, 0, 1), blurred.shape[::-1], interpolation=cv2.INTER_LINEAR))


def _detail(image: Float32Array, mask: Float32Array) -> Float32Array:
    """Differences between samples and the mean of the nearest ones of their channel, 0 elsewhere, [h, w]."""
    near, count = (cv2.filter2D(part, -1, BESIDE, borderType=cv2.BORDER_REFLECT_101) for part in (mask * image, mask))
    return np.asarray(mask * (image - near / np.maximum(count, 1)), np.float32)
