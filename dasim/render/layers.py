"""Pixels that see several depths: their layers, and the share of the light that each layer takes, front to back.

By reciprocity, the light that a pixel takes from a surface is the integral of the surface's kernel h over the part of
it that the lens sees first. This is exact for the nearest surface. A surface behind it is seen through a part of the
pupil only, whose kernel is not h. Weighting its rays with h would create or lose light beside the edge, so that an edge
between two surfaces of equal radiance would be visible. Therefore each layer, from the nearest to the farthest, takes a
share of what the nearer ones leave, and the farthest takes the rest (:func:`front_to_back`).

Two approximations remain. A far kernel beside a near edge has the right amount of light but the shape of the full
pupil's kernel. What is seen in a mirror or through glass has the depth of the mirror or the glass.

Tested in tests/dasim/render/test_layers.py.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from dasim.typing import FloatArray

SAME_BLUR_PX, SAME_BLUR_SHARE = 0.5, 0.05  # differences of visible blur within one layer, between neighbours in depth
MOST_LAYERS = 6  # per pixel; more are joined where they are closest


def same_blur_px(blur_px: FloatArray) -> FloatArray:
    """Largest difference of visible blur, in pixels, at which two surfaces count as one depth."""
    return SAME_BLUR_PX + SAME_BLUR_SHARE * np.abs(blur_px)


def split(blur_px: FloatArray) -> NDArray[np.int64]:
    """Number of the layer that each ray of a pixel hits, 0 for the nearest, [pixel, ray].

    Rays are sorted by depth; a new layer begins where the next ray is farther by more than :func:`same_blur_px`. A
    surface that recedes from the camera is therefore one layer, however deep it is.

    Args:
        blur_px: signed visible blur where each ray ends, positive nearer than the focus, [pixel, ray].
    """
    order = np.argsort(-blur_px, axis=1, kind="stable")
    ordered = np.take_along_axis(blur_px, order, axis=1)
    gap = (ordered[:, :-1] - ordered[:, 1:]) / same_blur_px(ordered[:, 1:])
    widest = np.ones((len(gap), 1))
    if gap.shape[1] >= MOST_LAYERS:
        widest = np.maximum(widest, np.partition(gap, -MOST_LAYERS, axis=1)[:, -MOST_LAYERS, None])
    layer = np.zeros(blur_px.shape, dtype=np.int64)
    np.put_along_axis(layer, order[:, 1:], np.cumsum(gap > widest, axis=1), axis=1)
    return layer


def estimate(
    signal: Sequence[FloatArray],
    control: Sequence[FloatArray],
    blur_px: FloatArray,
    beyond: Callable[[NDArray[np.intp], FloatArray], FloatArray],
) -> FloatArray:
    """Ratio of signal to light of pixels that see several depths, [pixel, channel].

    Args:
        signal: response x light x weight x radiance of each ray, [channel][pixel, ray].
        control: the same without radiance.
        blur_px: signed visible blur where each ray ends, [pixel, ray].
        beyond: function from ray indices, in the flat order of [pixel, ray], and visible blurs [ray] to the control,
            [ray, channel], that these rays would have at the depths of these blurs.
    """
    layer = split(blur_px)
    count = int(layer.max()) + 1
    sums = np.zeros((3, len(signal), count, len(layer)))  # signal, control, control beyond
    at: list[NDArray[np.intp]] = []
    depth: list[FloatArray] = []
    into: list[NDArray[np.intp]] = []
    for k in range(count):
        inside = layer == k
        # The mean depth of a slanted layer stands for its continuation behind its edge.
        depth_px = (blur_px * inside).sum(axis=1) / np.maximum(inside.sum(axis=1), 1)
        for row, part in enumerate((signal, control)):
            sums[row, :, k] = [(value * inside).sum(axis=1) for value in part]
        behind = np.flatnonzero(layer > k)
        pixel = behind // layer.shape[1]
        at.append(behind)
        depth.append(depth_px[pixel])
        into.append(k * len(layer) + pixel)
    chosen = np.concatenate(at)
    if len(chosen):
        light, place = beyond(chosen, np.concatenate(depth)), np.concatenate(into)
        for channel, column in enumerate(light.T):
            total = np.bincount(place, column, count * len(layer))
            sums[2, channel] = total.reshape(count, len(layer))
    return np.stack([front_to_back(*sums[:, channel]) for channel in range(len(signal))], axis=-1)


def front_to_back(
    signal: Sequence[FloatArray], control: Sequence[FloatArray], beyond: Sequence[FloatArray]
) -> FloatArray:
    """Ratio of signal to light of a pixel whose layers are seen one behind the other, [pixel].

    Layer k takes the share C_k / (C_k + B_k) of what the nearer layers leave, with the mean radiance S_k / C_k of its
    rays. The farthest layer has no rays beyond, so that it takes all that is left. The shares sum to one, and one layer
    gives the ratio S / C. For the nearest layer the expectation of C + B is that of one depth, so its share is that of
    reciprocity.

    Args:
        signal: S_k, sum of response x light x weight x radiance over the rays that end in layer k, near to far.
        control: C_k, the same sum without radiance.
        beyond: B_k, the sum of response x light x weight over the rays that end behind layer k, each with the weight
            that it would have at the depth of layer k.
    """
    total, rest = np.zeros_like(signal[0]), np.ones_like(signal[0])
    for s, c, b in zip(signal, control, beyond, strict=True):
        share = np.divide(rest, c + b, out=np.zeros_like(rest), where=c + b > 0)
        total += share * s
        rest -= share * c
    # Light is left where the weights of the farthest layer are all zero.
    return np.divide(total, 1 - rest, out=np.zeros_like(total), where=rest < 1)
