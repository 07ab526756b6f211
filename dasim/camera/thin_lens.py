"""Geometry of the thin lens: image distance, blur diameter and depth.

Distances are in metres from the lens plane along the optical axis. Blur diameters are positive for points nearer than
the focal plane, negative for points behind it.
"""

from __future__ import annotations

from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

Value = TypeVar("Value", float, NDArray[np.float64])


def image_distance_m(focal_length_m: float, focus_distance_m: float) -> float:
    """Distance in metres from the lens to a sensor focused at ``focus_distance_m``, s = f d_f / (d_f - f)."""
    return focal_length_m * focus_distance_m / (focus_distance_m - focal_length_m)


def blur_diameter_m(depth_m: Value, aperture_m: float, image_distance: float, focus_distance_m: float) -> Value:
    """Signed blur diameter on the sensor, in metres, of a point at ``depth_m``, c = A s (1/d - 1/d_f)."""
    return aperture_m * image_distance * (1.0 / depth_m - 1.0 / focus_distance_m)


def depth_of_blur_m(blur_m: Value, aperture_m: float, image_distance: float, focus_distance_m: float) -> Value:
    """Depth in metres at which the signed blur diameter is ``blur_m``, the inverse of :func:`blur_diameter_m`."""
    return 1.0 / (1.0 / focus_distance_m + blur_m / (aperture_m * image_distance))
