"""White off the axis, where the coatings of disc and cut-off have shifted, relative to that of the axis.

Tested in tests/recon/calibration/test_psf_bank.py.
"""

from __future__ import annotations

import numpy as np

from dasim.base.errors import InputError
from dasim.camera.radiometry import response
from dasim.camera.specification import Camera, channels
from dasim.spectra import grid, illuminants
from dasim.typing import FloatArray


def relative_to_axis(camera: Camera, lights: tuple[str, ...], field_px: tuple[float, float]) -> FloatArray:
    """Electrons of white over those on the axis, relative to green, [light, channel], from the data sheet.

    Args:
        camera: the camera.
        lights: names of illuminants; D65 stands for unknown ones.
        field_px: (x, y) of a place of the sensor from the optical axis.
    """
    lens, names = camera.lens, channels(camera.sensor)
    image_m = 1 / (1e3 / lens.focal_length_mm - 1 / lens.focus_distance_m)
    height_m = np.hypot(*field_px) * camera.sensor.pixel_pitch_um * 1e-6
    there, axis = response(camera, float(np.degrees(np.arctan(height_m / image_m)))), response(camera)
    ratio = np.stack([grid.integrate(there * _power(name)) / grid.integrate(axis * _power(name)) for name in lights])
    reference = names.index("G") if "G" in names else 0
    return np.asarray(ratio / ratio[:, reference : reference + 1])


def _power(light: str) -> FloatArray:
    try:
        return illuminants.illuminant(light)
    except InputError:
        return illuminants.illuminant("D65")
