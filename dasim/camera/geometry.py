"""Geometry of a camera: image distance, aperture, blur in pixels, depth of a blur, levels, intrinsic matrix."""

from __future__ import annotations

from typing import Any

import numpy as np

from dasim.camera import distortion, stops, thin_lens
from dasim.camera.sensor import principal_point
from dasim.camera.specification import BLUR_LEVELS, Camera
from dasim.spectra import grid
from dasim.typing import FloatArray

# Least range of axial colour, in visible blur, that distinguishes the two sides of the focus; half of it is too little
# to be detected in a window.
SIDES_DIFFER_PX = 0.5


def image_distance_m(camera: Camera) -> float:
    """Distance from lens to sensor, in metres."""
    return thin_lens.image_distance_m(camera.lens.focal_length_mm * 1e-3, camera.lens.focus_distance_m)


def aperture_m(camera: Camera) -> float:
    """Diameter of the open lens, in metres."""
    return camera.lens.focal_length_mm * 1e-3 / camera.lens.f_number


def blur_px(camera: Camera, depth_m: Any) -> Any:
    """Signed diameter in pixels of the visible (open lens) blur at ``depth_m``; positive nearer than the focus."""
    lens = camera.lens
    blur_m = thin_lens.blur_diameter_m(depth_m, aperture_m(camera), image_distance_m(camera), lens.focus_distance_m)
    return blur_m / (camera.sensor.pixel_pitch_um * 1e-6)


def depth_of_blur_m(camera: Camera, blur_px: Any) -> Any:
    """Depth in metres at which the signed visible blur diameter is ``blur_px`` pixels."""
    blur_m = np.asarray(blur_px) * camera.sensor.pixel_pitch_um * 1e-6
    focus = camera.lens.focus_distance_m
    return thin_lens.depth_of_blur_m(blur_m, aperture_m(camera), image_distance_m(camera), focus)


def focus_vergence(camera: Camera) -> FloatArray:
    """Inverse of the focus distance at each wavelength, 1/m, [wavelength]; negative where it is beyond infinity.

    The image distance s is that of the unshifted focal length: 1/d_f(lambda) = 1/f(lambda) - 1/s.
    """
    lens = camera.lens
    focal_m = lens.focal_length_mm * 1e-3
    shift_m = np.zeros_like(grid.WAVELENGTH_NM)
    if lens.focal_shift_um:
        nm, um = np.array(lens.focal_shift_um).T
        shift_m = np.interp(grid.WAVELENGTH_NM, nm, um) * 1e-6
    return 1.0 / lens.focus_distance_m + 1.0 / (focal_m + shift_m) - 1.0 / focal_m


def chromatic_blur_px(camera: Camera) -> FloatArray:
    """Addition of axial colour to the signed visible blur, in pixels, [wavelength]."""
    vergence = 1.0 / camera.lens.focus_distance_m - focus_vergence(camera)
    return aperture_m(camera) * image_distance_m(camera) * vergence / (camera.sensor.pixel_pitch_um * 1e-6)


def hole_ratio(camera: Camera) -> float:
    """Radius ratio of the smallest stop, alpha in the paper; for polygons and masks that of a disc of equal area."""
    rings = [stops.ring(stop) for stop in camera.stops]
    return min(
        float(np.sqrt(stops.open_area(stop))) if ring is None else ring.outer
        for stop, ring in zip(camera.stops, rings, strict=True)
    )


def level_blur_px(camera: Camera) -> FloatArray:
    """Visible blur diameters of the blur levels, in pixels, [level], from 0.

    By default, level k is at the relative diameter (1 - alpha) c = k pixels, so that 29 levels span the paper's working
    range of 5 cm to 2 m with its 3.6 mm lens; cameras with one round aperture have steps of 2 pixels. Where alpha
    approaches 1 these steps are too wide (10 px of visible blur at 0.9): comparisons of designs set ``camera.levels``.
    """
    if camera.levels is not None:
        return np.linspace(0.0, camera.levels.max_blur_px, camera.levels.count)
    relative = 1.0 - hole_ratio(camera)
    return np.arange(BLUR_LEVELS, dtype=np.float64) * (1.0 / relative if relative > 0 else 2.0)


def behind_blur_px(camera: Camera) -> FloatArray:
    """Visible blur diameters of the blur levels behind the focus, in pixels, [level], from 0 downwards.

    They have the spacing of those in front of the focus, end before infinity, and are at most as many. If axial colour
    does not distinguish the two sides of the focus, there is level 0 only.
    """
    blurs = level_blur_px(camera)
    if np.ptp(chromatic_blur_px(camera)) < SIDES_DIFFER_PX:
        return np.zeros(1)
    return -blurs[-blurs > float(blur_px(camera, np.inf))]


def frame_field_px(camera: Camera) -> tuple[float, float]:
    """The middle of the frame, (x, y) in pixels from the optical axis."""
    x, y = principal_point(camera.sensor)
    return camera.sensor.width_px / 2 - x, camera.sensor.height_px / 2 - y


def field_angle_deg(camera: Camera, field_px: tuple[float, float]) -> float:
    """Angle of the chief ray to a place of the sensor (x, y) in pixels from the axis, in degrees."""
    return float(np.degrees(np.arctan(np.hypot(*_tangent(camera, field_px)))))


def _tangent(camera: Camera, field_px: tuple[float, float]) -> FloatArray:
    """Tangent of the field angle at a place of the sensor, as a vector (x, y), distortion included."""
    place_px = distortion.to_pinhole_px(camera, np.array(field_px, dtype=np.float64))
    return place_px * camera.sensor.pixel_pitch_um * 1e-6 / image_distance_m(camera)


def foreshortening(camera: Camera, field_px: tuple[float, float]) -> FloatArray:
    """T at a place of the sensor (x, y) in pixels from the axis, [2, 2] in the order (y, x).

    T = cos (1 - t t^T cos^2), with t the tangent of the field angle as a vector: cos^3 along t and cos across it, see
    :mod:`dasim.camera.pupil_pattern`.
    """
    tangent = _tangent(camera, field_px)[::-1]
    square_of_cosine = 1 / (1 + tangent @ tangent)
    return np.asarray(np.sqrt(square_of_cosine) * (np.eye(2) - np.outer(tangent, tangent) * square_of_cosine))


def intrinsic_matrix(camera: Camera) -> FloatArray:
    """Pinhole intrinsics K in pixels, [3, 3]; pixel centres at +0.5, the principal point by default in the middle.

    With distortion, K holds for the places of :func:`dasim.camera.distortion.to_pinhole_px`.
    """
    focal_px = image_distance_m(camera) / (camera.sensor.pixel_pitch_um * 1e-6)
    x, y = principal_point(camera.sensor)
    return np.array([[focal_px, 0, x], [0, focal_px, y], [0, 0, 1.0]])
