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

import cv2
import numpy as np

from dasim.typing import Float32Array
from recon.sharp.samples import Samples, between, blurs, change_near_focus, place, weights, window_means

BILINEAR = np.outer([0.5, 1.0, 0.5], [0.5, 1.0, 0.5]).astype(np.float32)  # between samples at every second pixel


def restore(
    sharp_e: Float32Array,
    samples: Sequence[Samples | None],
    blur_px: Float32Array,
    sd_px: Float32Array,
) -> None:
    """Bring lost detail back to an all-in-focus picture, in place.

    Args:
        sharp_e: the picture, [h, w, 3] electrons.
        samples: of the three channels, with their noise, at every second pixel of every second row at least; a channel
            without any is left as it is.
        blur_px: diameter of the visible blur of each pixel, [h, w], of either sign.
        sd_px: its standard deviation, [h, w].
    """

    def lost(strip: Float32Array, own: list[Samples | None], rows: slice) -> Float32Array:
        size, spread = np.abs(blur_px[rows]).astype(np.float32), sd_px[rows]
        least, result = np.full(strip.shape, np.inf, np.float32), np.zeros_like(strip)
        mixtures = [weights(place(diameter)) for diameter in (size, size + spread)]
        for channel, one in enumerate(own):
            if one is None:
                continue
            of_channel = blurs(strip[..., channel])
            for mixture in mixtures:
                share, difference = _unexplained(one, between(of_channel, mixture))
                better = share < least[..., channel]
                np.copyto(least[..., channel], share, where=better)
                np.copyto(result[..., channel], share * difference, where=better)
        return result

    change_near_focus(sharp_e, samples, blur_px, lost)


def _unexplained(samples: Samples, blurred: Float32Array) -> tuple[Float32Array, Float32Array]:
    """Difference between samples and a blurred picture [h, w]: the share of it that noise does not explain, and the
    difference itself, interpolated between the samples, [h, w] each.
    """
    mask = samples.sites.astype(np.float32)
    difference = mask * (samples.value_e - blurred)
    size, half = blurred.shape[::-1], samples.variance.shape[::-1]
    count = cv2.resize(mask, half, interpolation=cv2.INTER_AREA)
    found, noise = window_means([difference**2, count * samples.variance], samples.variance.shape)
    share = np.maximum(1 - noise / np.maximum(found, np.float32(1e-9)), 0)
    near, weight = (cv2.filter2D(part, -1, BILINEAR, borderType=cv2.BORDER_REFLECT) for part in (difference, mask))
    interpolated = near / np.maximum(weight, BILINEAR.min())
    return np.asarray(cv2.resize(share, size, interpolation=cv2.INTER_LINEAR), np.float32), interpolated
