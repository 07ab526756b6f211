"""Thin-lens geometry: conjugates, blur and depth, field of view.

Distances are metres from the lens plane along the optical axis; a blur diameter is positive for
points nearer than the focal plane and negative for points behind it.
"""

from __future__ import annotations

from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

Value = TypeVar("Value", float, NDArray[np.float64])


def image_distance_m(focal_length_m: float, focus_distance_m: float) -> float:
    """Distance from lens to sensor that focuses at ``focus_distance_m``, s = f d_f / (d_f - f)."""
    return focal_length_m * focus_distance_m / (focus_distance_m - focal_length_m)


def blur_diameter_m(depth_m: Value, aperture_m: float, image_distance: float, focus_distance_m: float) -> Value:
    """Signed diameter on the sensor of the blur of a point at ``depth_m``, c = A s (1/d - 1/d_f)."""
    return aperture_m * image_distance * (1.0 / depth_m - 1.0 / focus_distance_m)


def depth_of_blur_m(blur_m: Value, aperture_m: float, image_distance: float, focus_distance_m: float) -> Value:
    """Depth whose signed blur diameter is ``blur_m``, the inverse of :func:`blur_diameter_m`."""
    return 1.0 / (1.0 / focus_distance_m + blur_m / (aperture_m * image_distance))


def waves_of_defocus(blur_m: Value, working_f_number: float, wavelength_m: float) -> Value:
    """Defocus W20 at the edge of the pupil in waves, c / (8 N lambda), with N = s / A of the stop."""
    return blur_m / (8.0 * working_f_number * wavelength_m)
