"""Figures of a camera that its page shows: levels, modulation transfer, light through the stops, the field of view.

Tested in tests/validation/reports/camera/test_page.py.
"""

from __future__ import annotations

from collections import Counter
from typing import NamedTuple

import numpy as np

from dasim.camera import geometry, pointspread, radiometry, stops
from dasim.camera import sensor as sensors
from dasim.camera import specification as cameras
from dasim.camera.specification import Camera
from dasim.spectra import grid, illuminants
from dasim.typing import FloatArray

TAIL_PX = 16  # of diffraction, beyond the frames of kernels
STEPS_PER_PIXEL = 4  # samples of a line spread function
CORNERS = {"middle": 0.0, "half-way to the corner": 0.5, "corner": 1.0}  # places of the field, of the half diagonal


class Level(NamedTuple):
    """A blur level: distance and diameters of the geometric blur."""

    level: int
    distance_cm: float
    visible_blur_px: float
    smallest_stop_blur_px: float
    next_level_cm: float  # distance to the next level, NaN after the last one


class FieldPoint(NamedTuple):
    """The camera at a place of the field."""

    place: str
    angle_deg: float
    relative_illumination: float
    near_infrared_nm: tuple[float, float]
    crosstalk: tuple[float, ...]  # of R, G, B, eq. (8); empty without R, G, B and IR


def levels(camera: Camera) -> list[Level]:
    """The blur levels in front of the focus, from the focus towards the lens."""
    blur_px = geometry.level_blur_px(camera)
    distance_cm = 1e2 * np.asarray(geometry.depth_of_blur_m(camera, blur_px))
    steps = [*np.abs(np.diff(distance_cm)), np.nan]
    ratio = geometry.hole_ratio(camera)
    return [
        Level(number, float(cm), float(px), float(ratio * px), float(step))
        for number, (cm, px, step) in enumerate(zip(distance_cm, blur_px, steps, strict=True))
    ]


def psfs(camera: Camera, blur_px: FloatArray, light: str) -> list[FloatArray]:
    """Point-spread functions [channel, y, x] in pixels for each visible blur, in a frame that holds the kernel."""
    power = illuminants.illuminant(light)
    field_px = geometry.frame_field_px(camera)
    made = []
    for blur in blur_px:
        size = pointspread.kernel_size_px(camera, float(blur), field_px)
        at = pointspread.kernels(camera, [float(blur)], power, size, field_px=field_px)
        made.append(at(0, (0.0, 0.0), ...)[0])
    return made


def modulation_transfer(camera: Camera, blur_px: FloatArray, light: str, cycles_px: FloatArray) -> FloatArray:
    """Modulation transfer along the rows, pixel included, [blur, channel, frequency].

    The line spread functions are sampled ``STEPS_PER_PIXEL`` times per pixel, so that nothing is aliased up to half of
    this number of cycles per pixel, and transformed at the frequencies ``cycles_px``. The light outside of the frame,
    which reaches ``TAIL_PX`` beyond the kernel's, is missing at the lowest frequencies: about 1 % in focus.
    """
    power = illuminants.illuminant(light)
    field_px = geometry.frame_field_px(camera)
    result = []
    for blur in blur_px:
        size = pointspread.kernel_size_px(camera, float(blur), field_px) + 2 * TAIL_PX
        at = pointspread.kernels(camera, [float(blur)], power, size, field_px=field_px)
        spectrum = np.zeros((len(sensors.channels(camera.sensor)), len(cycles_px)), np.complex128)
        for step in range(STEPS_PER_PIXEL):
            shift = step / STEPS_PER_PIXEL
            line = at(0, (0.0, shift), ...)[0].sum(axis=-2)  # [channel, x]
            place = np.arange(size) - size // 2 - shift
            spectrum += line @ np.exp(-2j * np.pi * np.outer(place, cycles_px))
        result.append(np.abs(spectrum) / STEPS_PER_PIXEL)
    return np.array(result)


def electrons_by_stop(camera: Camera, light: str) -> FloatArray:
    """Electrons of a white surface through each stop, relative, [stop, channel]."""
    power = illuminants.illuminant(light)
    return np.stack([grid.integrate(radiometry.stop_response(camera, stop) * power) for stop in camera.stops])


def light_kept(camera: Camera, light: str) -> FloatArray:
    """Electrons of each channel over those with every stop as wide as the lens, [channel], with real responses."""
    passed = electrons_by_stop(camera, light)
    areas = np.array([stops.open_area(stop) for stop in camera.stops])
    return np.asarray(passed.sum(axis=0) / (passed / areas[:, None]).sum(axis=0))


def ideal_light_loss(camera: Camera, light: str = "D65") -> float:
    """Light loss of the mosaic by eq. (1), which assigns each channel to one stop, the one that most light passes."""
    names = sensors.channels(camera.sensor)
    chosen = electrons_by_stop(camera, light).argmax(axis=0)
    pixels = [names.index(name) for row in camera.sensor.mosaic for name in row]
    counts = Counter(int(chosen[pixel]) for pixel in pixels)
    ratios = {number: float(np.sqrt(stops.open_area(camera.stops[number]))) for number in counts}
    return stops.light_loss([(count, ratios[number]) for number, count in counts.items()], len(pixels))


def field_of_view_deg(camera: Camera) -> tuple[float, float, float]:
    """Horizontal, vertical and diagonal field of view in degrees, without distortion."""
    sensor, distance = camera.sensor, geometry.image_distance_m(camera)
    width, height = (side * sensor.pixel_pitch_um * 1e-6 for side in (sensor.width_px, sensor.height_px))
    sides = (width, height, float(np.hypot(width, height)))
    across, down, diagonal = (float(np.degrees(2 * np.arctan(side / 2 / distance))) for side in sides)
    return across, down, diagonal


def field_points(camera: Camera) -> list[FieldPoint]:
    """The middle of the frame, its corner and half the way between."""
    sensor = camera.sensor
    axis = np.array(geometry.frame_field_px(camera))
    corner = np.array([sensor.width_px, sensor.height_px]) / 2
    illumination = radiometry.relative_illumination(camera)
    known = set(grid.CHANNELS) <= set(sensors.channels(sensor))
    points = []
    for place, share in CORNERS.items():
        angle = geometry.field_angle_deg(camera, tuple(axis + share * corner))
        x, y = np.minimum((1 + share) * corner, 2 * corner - 1).astype(int)
        alpha = tuple(float(value) for value in cameras.crosstalk(camera, angle)) if known else ()
        band = cameras.near_infrared_nm(camera, angle)
        points.append(FieldPoint(place, angle, float(illumination[y, x]), band, alpha))
    return points
