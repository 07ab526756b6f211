"""White off the axis, where the coatings of disc and cut-off are shifted, relative to white on the axis.

Tested in tests/recon/calibration/test_psf_bank.py.
"""

from __future__ import annotations

import numpy as np

from dasim.base.errors import InputError
from dasim.camera.radiometry import response
from dasim.camera.rings import field_angle_deg
from dasim.camera.sensor import channels
from dasim.camera.specification import Camera
from dasim.spectra import grid, illuminants
from dasim.typing import FloatArray


def relative_to_axis(camera: Camera, lights: tuple[str, ...], field_px: tuple[float, float]) -> FloatArray:
    """Electrons of white off the axis divided by those on it, relative to green, [light, channel], by the data sheet.

    Args:
        camera: the camera.
        lights: names of illuminants; D65 stands for unknown ones.
        field_px: position (x, y) on the sensor, from the optical axis.
    """
    names = channels(camera.sensor)
    there, axis = response(camera, field_angle_deg(camera, field_px)), response(camera)
    ratio = np.stack([grid.integrate(there * _power(name)) / grid.integrate(axis * _power(name)) for name in lights])
    reference = names.index("G") if "G" in names else 0
    return np.asarray(ratio / ratio[:, reference : reference + 1])


def _power(light: str) -> FloatArray:
    try:
        return illuminants.illuminant(light)
    except InputError:
        return illuminants.illuminant("D65")
