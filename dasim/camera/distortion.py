"""Distortion: image positions of the lens compared with those of a pinhole at the same distance.

A point of the sensor at the distance r from the axis shows what a pinhole would show at r_p = r (1 + sum a_k r^(2k)),
in the same direction. The polynomial of ``lens.distortion_per_mm`` therefore maps from the sensor to directions in the
scene, as a renderer needs. Barrel distortion has r_p > r. In the pinhole picture, the size of the blur is unchanged.

Tested in tests/dasim/camera/test_distortion.py.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from dasim.camera.specification import Camera, square_of_image_height_m2
from dasim.typing import FloatArray


def factor(per_mm: Sequence[float], square_mm2: Any) -> Any:
    """r_p / r for the square of the distance from the axis in mm^2; numbers, arrays of NumPy or of Dr.Jit."""
    total: Any = 0.0
    for value in reversed(per_mm):
        total = (total + value) * square_mm2
    return 1.0 + total


def square_of_pinhole_height_m2(camera: Camera) -> FloatArray:
    """Square of the undistorted (pinhole) image height of the content of each pixel, m^2, [h, w]."""
    r2 = square_of_image_height_m2(camera)
    per_mm = camera.lens.distortion_per_mm
    return r2 * factor(per_mm, r2 * 1e6) ** 2 if per_mm else r2


def to_pinhole_px(camera: Camera, place_px: FloatArray) -> FloatArray:
    """Where a pinhole shows what the lens shows at places [..., 2], both in pixels from the axis."""
    pitch_mm = camera.sensor.pixel_pitch_um * 1e-3
    square = np.sum(np.square(place_px), axis=-1, keepdims=True) * pitch_mm**2
    return np.asarray(place_px * factor(camera.lens.distortion_per_mm, square))


def most_outwards_px(camera: Camera) -> float:
    """How far outside the frame's corner a pinhole would show the content of that corner, in pixels; 0 if inside."""
    if not camera.lens.distortion_per_mm:
        return 0.0
    heights_m = [np.sqrt(of(camera).max()) for of in (square_of_pinhole_height_m2, square_of_image_height_m2)]
    return max(0.0, float(heights_m[0] - heights_m[1]) * 1e6 / camera.sensor.pixel_pitch_um)
