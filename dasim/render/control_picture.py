"""The picture that the rays of a control variate read, in half precision.

Notation as in :mod:`dasim.render.control_variate`: s is a pinhole picture, F its mean for a pixel.

Tested in tests/dasim/render/test_control_picture.py and tests/dasim/render/test_control_variate.py.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from dasim.render.host_threads import in_threads
from dasim.render.plugin import aligned_zeros
from dasim.typing import Float32Array

MOST_HALF = 6e4  # of a node over the scale: half precision ends at 65,504
TEXTURE_BANDS = 4  # more than s has: Dr.Jit would store a copy with as many
LOST_BITS = 13  # of the mantissa, from single to half precision
NOISE_SIDE = 128  # of the square of random numbers that round


def with_pixel_boxes(ratio: NDArray[np.float32], cells: int) -> tuple[NDArray[np.float16], float]:
    """s, and below it the means of s over squares as wide as a pixel, at the upper left corners of the nodes,
    [y, x, band], with a fourth band of zeros; both over the second value, a power of two.

    Between the corners they are linear, as s is between its nodes. Read at the centre of a pixel, they are therefore
    the mean of s over the pixel's cells, for every shift, and both have the same F.

    They are rounded to half precision: the textures of all stops are the largest arrays of a capture. F is made of s as
    rounded; the means are rounded up or down at random, so that those of a smooth picture have no bias.

    Args:
        ratio: s, [y, x, band].
        cells: nodes per pixel, along each axis.
    """
    size, middle = (cells, cells), (cells // 2, cells // 2)
    height, width, bands = ratio.shape
    largest = max(float(ratio.max()), -float(ratio.min()))
    scale = float(2 ** np.ceil(np.log2(max(largest / MOST_HALF, 1.0))))
    picture = aligned_zeros((2 * height, width, TEXTURE_BANDS), np.float16)

    def fill(band: int) -> None:  # apart: together they are as large as the picture
        nodes = (ratio[..., band] / np.float32(scale)).astype(np.float16)
        boxes = cv2.blur(nodes.astype(np.float32), size, anchor=middle, borderType=cv2.BORDER_REPLICATE)
        picture[:height, :, band], picture[height:, :, band] = nodes, _to_half(boxes)

    in_threads(fill, range(bands))
    return picture, scale


def _to_half(values: Float32Array) -> NDArray[np.float16]:
    """Values [y, x] in half precision, rounded up or down at random with the right expectation."""
    height, width = values.shape
    noise = np.random.default_rng(0).integers(1 << LOST_BITS, size=(NOISE_SIDE, NOISE_SIDE), dtype=np.uint32)
    noise = np.tile(noise, (-(-height // NOISE_SIDE), -(-width // NOISE_SIDE)))[:height, :width]
    bits = values.view(np.uint32) + noise
    bits &= np.uint32(~((1 << LOST_BITS) - 1) & 0xFFFFFFFF)
    result = bits.view(np.float32).astype(np.float16)
    small = (np.abs(values) < np.finfo(np.float16).smallest_normal) & (values != 0)  # of even steps
    step = np.float32(np.finfo(np.float16).smallest_subnormal)
    result[small] = np.floor(values[small] / step + noise[small] / np.float32(1 << LOST_BITS)) * step
    return result
