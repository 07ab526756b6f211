"""The texture for which bounds on depth accuracy are computed: its mean, its contrast, and the exposure of white.

Tested in tests/dasim/camera/test_noise.py.
"""

from __future__ import annotations

import numpy as np

from dasim.camera import noise, radiometry
from dasim.camera.specification import Camera
from dasim.materials import library
from dasim.simulation.relight import LONGEST_S
from dasim.spectra import grid, illuminants
from dasim.typing import FloatArray

MEAN_SHARE = 0.4  # mean of the texture over white
CONTRAST = 0.15  # standard deviation of the texture within an octave of spatial frequency, over its mean


def white_electrons(camera: Camera, light: str, level_lux: float) -> tuple[FloatArray, float]:
    """Electrons of white paper in every channel, [channel], and the exposure time in seconds.

    The exposure is automatic, up to ``LONGEST_S``. ``light`` names an illuminant, ``level_lux`` its illuminance.
    """
    radiance = illuminants.illuminant(light) * level_lux * library.reflectance("white-paper") / np.pi
    rate = grid.integrate(radiometry.response(camera) * radiance)
    top = noise.Exposure().auto_level * noise.saturation_e(camera.sensor)
    time_s = min(LONGEST_S, float(top / rate.max()))
    return rate * time_s, time_s
