"""Radiometry of a camera: from spectral radiance to electrons per second and pixel.

Tested in tests/dasim/camera/test_specification.py and tests/dasim/render/test_lens.py.
"""

from __future__ import annotations

import numpy as np

from dasim.camera import stops as aperture
from dasim.camera.geometry import aperture_m, image_distance_m
from dasim.camera.specification import Camera, quantum_efficiency, shading, square_of_image_height_m2
from dasim.spectra import grid
from dasim.typing import FloatArray


def relative_illumination(camera: Camera) -> FloatArray:
    """Light of each pixel relative to the axis, [h, w]: cos^4 of the chief ray's angle times the shading."""
    s2 = image_distance_m(camera) ** 2
    return (s2 / (s2 + square_of_image_height_m2(camera))) ** 2 * shading(camera)


def stop_response(camera: Camera, stop: aperture.Stop) -> FloatArray:
    """Electrons a second and pixel, per W m^-2 sr^-1 nm^-1 of scene radiance, through one stop.

    Shape [channel, wavelength], on the axis: p^2 pi (r/s)^2 T_lens T_stop T_cutoff QE lambda / (h c),
    the Abbe lens's E = pi L (r/s)^2 with pi r^2 the stop's open area. Off the axis it falls as
    :func:`relative_illumination`.
    """
    sensor = camera.sensor
    square_of_radius = aperture.open_area(stop) * (aperture_m(camera) / 2) ** 2
    etendue = (sensor.pixel_pitch_um * 1e-6) ** 2 * np.pi * square_of_radius / image_distance_m(camera) ** 2
    passed = camera.lens.transmittance * aperture.transmittance(stop)
    passed = passed * grid.short_pass(sensor.cutoff_nm, sensor.cutoff_width_nm)
    return etendue * passed * quantum_efficiency(sensor) * grid.photons_per_joule()


def response(camera: Camera) -> FloatArray:
    """Spectral response of the whole camera, the sum of :func:`stop_response` over its stops, [channel, wavelength]."""
    return np.sum([stop_response(camera, stop) for stop in camera.stops], axis=0)
