"""Depth error that corresponds to an error in blur, from the data sheet of the lens.

Tested in tests/validation/claims/test_depth.py.
"""

from __future__ import annotations

from dasim.camera.specification import Camera


def first_order_m(camera: Camera, depth_m: float) -> float:
    """Depth error in metres of half a pixel of blur at ``depth_m``, to first order: d^2 N p / (2 f^2).

    Valid for a lens focused at infinity, with f-number N, pixel pitch p and focal length f. Source: Fig. 13.
    """
    focal_m, pitch_m = camera.lens.focal_length_mm * 1e-3, camera.sensor.pixel_pitch_um * 1e-6
    return depth_m**2 * camera.lens.f_number * pitch_m / (2 * focal_m**2)
