"""Samples of the mosaic near focus, with which an all-in-focus picture is compared.

Tested in tests/recon/sharp/test_lost_detail.py and tests/recon/sharp/test_false_detail.py.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import cv2
import numpy as np

from dasim.typing import BoolArray, Float32Array

# Both chosen on ``tune``.
WINDOW_PX = 7.0  # sigma of the window in which pictures and samples are compared
BLURS_PX = (0.93, 4.63)  # visible blur up to which pictures are changed in full, and from which on they are not
DISC = 0.25  # standard deviation of a disc along an axis, over its diameter
SIGMAS_PX = np.arange(0.0, 1.3, 0.25)  # of the blurs that :func:`between` interpolates, up to that of BLURS_PX
STRIP_PX, HALO_PX = 256, 36  # rows at a time, even, and rows around them that they depend on


class Samples(NamedTuple):
    """The mosaic's samples of a channel."""

    sites: BoolArray  # pixels that it was sampled at, [h, w]
    value_e: Float32Array  # [h, w] electrons, read at the sites alone
    variance: Float32Array  # of the noise, [h/2, w/2]


def change_near_focus(
    sharp_e: Float32Array,
    samples: Sequence[Samples | None],
    blur_px: Float32Array,
    change: Callable[[Float32Array, list[Samples | None], slice], Float32Array],
) -> None:
    """Add a change to a picture [h, w, channel] near focus, in place, strip by strip.

    ``change`` gets rows of the picture as it was, the samples of these rows, and the rows. It returns the change there,
    which is weighted by ``BLURS_PX``. ``blur_px`` [h, w] is the diameter of the visible blur, of either sign.
    """
    height = len(blur_px)
    above = sharp_e[:0]  # original values of rows that the previous strip has changed
    for top in range(0, height, STRIP_PX):
        bottom = min(top + STRIP_PX, height)
        first, last = top - len(above), min(bottom + HALO_PX, height)
        rows, inner = slice(first, last), slice(top - first, bottom - first)
        strip = np.concatenate([above, sharp_e[top:last]])
        above = sharp_e[max(bottom - HALO_PX, 0) : bottom].copy()
        size = np.abs(blur_px[top:bottom])
        if size.min() >= BLURS_PX[1]:
            continue
        halves = slice(first // 2, -(-last // 2))
        own = [
            None if whole is None else Samples(whole.sites[rows], whole.value_e[rows], whole.variance[halves])
            for whole in samples
        ]
        weight = np.interp(size, BLURS_PX, (1, 0)).astype(np.float32)
        sharp_e[top:bottom] += weight[..., None] * change(strip, own, rows)[inner]


def place(blur_px: Float32Array) -> Float32Array:
    """Fractional index among ``SIGMAS_PX`` of diameters of visible blur from 0, the last for larger ones."""
    sigma_px = np.float32(DISC) * blur_px
    return np.minimum(sigma_px / np.float32(SIGMAS_PX[1]), np.float32(len(SIGMAS_PX) - 1))


def blurs(image: Float32Array) -> list[Float32Array]:
    """An image [h, w] blurred by each of ``SIGMAS_PX``."""
    image = np.ascontiguousarray(image)
    return [image, *(np.asarray(cv2.GaussianBlur(image, (0, 0), float(sigma)), np.float32) for sigma in SIGMAS_PX[1:])]


def weights(place: Float32Array) -> list[Float32Array]:
    """Weights of the images of :func:`blurs` at the fractional index of each pixel, [h, w]."""
    return [np.maximum(1 - np.abs(place - np.float32(number)), 0) for number in range(len(SIGMAS_PX))]


def between(images: Sequence[Float32Array], of_images: Sequence[Float32Array]) -> Float32Array:
    """Linear interpolation between images with their :func:`weights`, [h, w]."""
    return np.asarray(sum(weight * image for weight, image in zip(of_images, images, strict=True)), np.float32)


def window_means(images: Sequence[Float32Array], shape: tuple[int, ...]) -> list[Float32Array]:
    """Means of images over 2x2 blocks or of such means, in the window around each block of ``shape`` [h/2, w/2]."""
    size = shape[::-1]
    return [
        np.asarray(
            cv2.GaussianBlur(
                cv2.resize(image, size, interpolation=cv2.INTER_AREA),
                (0, 0),
                WINDOW_PX / 2,
                borderType=cv2.BORDER_REFLECT,
            ),
            np.float32,
        )
        for image in images
    ]
