"""The texture for which bounds on depth accuracy are computed: its mean, its contrast, and the exposure of white.

Tested in tests/dasim/camera/test_noise.py.
"""

from __future__ import annotations

import numpy as np

from dasim.camera import crosstalk, diffusion, noise, radiometry
from dasim.camera import sensor as sensors
from dasim.camera.specification import Camera
from dasim.materials import library
from dasim.simulation.relight import LONGEST_S
from dasim.spectra import grid, illuminants
from dasim.typing import FloatArray

MEAN_SHARE = 0.4  # mean of the texture over white
CONTRAST = 0.15  # standard deviation of the texture within an octave of spatial frequency, over its mean


def noise_variance(camera: Camera, mean_e: FloatArray, time_s: float, gain: float = 1.0) -> FloatArray:
    """Noise variance of the pixels of each channel on an even surface, [channel], crosstalk between them corrected.

    ``mean_e`` [channel] are mean electrons without crosstalk, ``time_s`` is the exposure time, ``gain`` the analogue
    gain.
    """
    shares = crosstalk.channel_shares(camera)
    collected = diffusion.collected_evenly(mean_e, sensors.channel_block(camera.sensor), shares)
    return crosstalk.noise_gains(camera) * noise.variance(camera.sensor, time_s, gain).at(collected)


def white_electrons(camera: Camera, light: str, level_lux: float) -> tuple[FloatArray, float]:
    """Electrons of white paper in every channel, [channel], and the exposure time in seconds.

    The exposure is automatic, up to ``LONGEST_S``. ``light`` names an illuminant, ``level_lux`` its illuminance.
    """
    radiance = illuminants.illuminant(light) * level_lux * library.reflectance("white-paper") / np.pi
    rate = grid.integrate(radiometry.response(camera) * radiance)
    top = noise.Exposure().auto_level * noise.saturation_e(camera.sensor)
    time_s = min(LONGEST_S, float(top / rate.max()))
    return rate * time_s, time_s
