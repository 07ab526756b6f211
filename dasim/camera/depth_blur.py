"""Blur of a depth map, and the pixels that it mixes across depth discontinuities.

Tested in tests/dasim/render/test_truth.py.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from dasim.camera import geometry
from dasim.camera.specification import Camera
from dasim.typing import FloatArray

BLUR_JUMP_PX = 0.5  # a larger difference in visible blur between neighbouring pixels is a depth discontinuity
_RADIUS_BINS_PX = 1.0  # radii of boundary discs are rounded up to multiples of this


def signed_blur_px(depth_m: FloatArray, camera: Camera) -> FloatArray:
    """Signed visible blur in pixels, [h, w], of a depth map in which NaN stands for infinity."""
    return np.asarray(geometry.blur_px(camera, np.where(np.isnan(depth_m), np.inf, depth_m)))


def boundary(blur_px: FloatArray) -> NDArray[np.bool_]:
    """Mask [h, w] of the pixels whose light may come from both sides of a depth discontinuity.

    A discontinuity is a pair of neighbouring pixels whose visible blur differs by more than ``BLUR_JUMP_PX``. The mask
    is the union of discs about both pixels, with the larger blur radius of the two plus one pixel.

    Args:
        blur_px: signed visible blur (diameter), [h, w].
    """
    size = np.abs(blur_px)
    reach = np.zeros_like(size)
    for axis in (0, 1):
        here, there = [slice(None)] * 2, [slice(None)] * 2
        here[axis], there[axis] = slice(None, -1), slice(1, None)
        first, second = tuple(here), tuple(there)
        jump = np.abs(blur_px[first] - blur_px[second]) > BLUR_JUMP_PX
        larger = np.where(jump, np.maximum(size[first], size[second]) / 2 + 1.0, 0.0)
        reach[first] = np.maximum(reach[first], larger)
        reach[second] = np.maximum(reach[second], larger)
    return within(reach, np.arange(0.0, reach.max() + 2 * _RADIUS_BINS_PX, _RADIUS_BINS_PX))


def within(reach_px: NDArray[np.floating], radii_px: FloatArray) -> NDArray[np.bool_]:
    """Mask [h, w] of the union of discs about the pixels with a positive reach.

    Args:
        reach_px: radius of the disc about each pixel, [h, w].
        radii_px: values to which the radii are rounded up, ascending, the last one above all of them.
    """
    mask = np.zeros(reach_px.shape, bool)
    number = np.where(reach_px > 0, np.searchsorted(radii_px, reach_px), -1)
    for own in np.unique(number[number >= 0]):
        mask |= ndimage.distance_transform_edt(number != own) <= radii_px[own]
    return mask
