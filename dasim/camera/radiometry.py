"""Radiometry of a camera: electrons per second and pixel from spectral radiance.

Tested in tests/dasim/camera/test_specification.py and tests/dasim/render/test_lens.py.
"""

from __future__ import annotations

import numpy as np

from dasim.camera import coatings, distortion, stops
from dasim.camera.geometry import aperture_m, image_distance_m
from dasim.camera.sensor import channels, cutoff, quantum_efficiency
from dasim.camera.specification import Camera, shading
from dasim.spectra import grid
from dasim.typing import FloatArray


def relative_illumination(camera: Camera) -> FloatArray:
    """Illumination of each pixel relative to the axis, [h, w]: cos^4 of the chief ray's angle times the shading."""
    s2 = image_distance_m(camera) ** 2
    return (s2 / (s2 + distortion.square_of_pinhole_height_m2(camera))) ** 2 * shading(camera)


def stop_response(camera: Camera, stop: stops.Stop, angle_deg: float = 0.0) -> FloatArray:
    """Electrons per second and pixel through one stop, per W m^-2 sr^-1 nm^-1 of radiance, [channel, wavelength].

    On the axis this is p^2 pi (r/s)^2 T_lens T_stop T_cutoff QE lambda / (h c), from E = pi L (r/s)^2 of an Abbe lens,
    with pi r^2 the open area of the stop. At the angle ``angle_deg`` of the chief ray, the edges of the coatings are
    shifted (:mod:`dasim.camera.coatings`); the decrease by :func:`relative_illumination` is not included.
    """
    sensor = camera.sensor
    square_of_radius = stops.open_area(stop) * (aperture_m(camera) / 2) ** 2
    etendue = (sensor.pixel_pitch_um * 1e-6) ** 2 * np.pi * square_of_radius / image_distance_m(camera) ** 2
    factor = coatings.edge_factor(camera.lens.coating_index, angle_deg)
    passed = camera.lens.transmittance * stops.transmittance(stop, factor) * cutoff(sensor, angle_deg)
    return etendue * passed * quantum_efficiency(sensor) * grid.photons_per_joule()


def response(camera: Camera, angle_deg: float = 0.0) -> FloatArray:
    """Spectral response of the whole camera, the sum of :func:`stop_response` over its stops, [channel, wavelength]."""
    return np.sum([stop_response(camera, stop, angle_deg) for stop in camera.stops], axis=0)


def light_loss(camera: Camera) -> float:
    """Share of the light that the mosaic loses to stops smaller than the lens, eq. (1) of the paper.

    Each pixel of the mosaic loses the light that the stops block in its own band, which is 650 nm and beyond for IR and
    below 650 nm for the other channels; one without light in its band loses nothing. A hole of radius ratio alpha for
    one pixel of four loses (1 - alpha^2) / 4.
    """
    names = channels(camera.sensor)
    opened = camera.model_copy(update={"stops": tuple(_opened(stop) for stop in camera.stops)})
    infrared = grid.WAVELENGTH_NM >= grid.NEAR_INFRARED_NM[0]
    band = np.stack([infrared if name == "IR" else ~infrared for name in names])
    passed, whole = (grid.integrate(response(c) * band) for c in (camera, opened))
    block = [names.index(name) for row in camera.sensor.mosaic for name in row]
    return float(np.mean([1 - passed[pixel] / whole[pixel] if whole[pixel] > 0 else 0.0 for pixel in block]))


def _opened(stop: stops.Stop) -> stops.Stop:
    """The stop with the aperture of the whole lens."""
    return stops.Disc(
        name=stop.name, passes_nm=stop.passes_nm, edge_width_nm=stop.edge_width_nm, shape="disc", radius_ratio=1.0
    )
