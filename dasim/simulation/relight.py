"""A photograph under other light: another illuminant before it is taken, another level after it."""

from __future__ import annotations

import numpy as np

from dasim.camera import noise
from dasim.scene.specification import Scene
from dasim.simulation.simulate import Shot
from dasim.values import Capture

LONGEST_S, MOST_GAIN = 1 / 30, 16.0  # of a picture by hand


def lit_by(scene: Scene, light: str) -> Scene:
    """The scene with all of its lights of one illuminant."""
    lights = tuple(item.model_copy(update={"illuminant": light}) for item in scene.lights)
    return scene.model_copy(update={"name": f"{scene.name}:{light}", "lights": lights})


def exposed(
    shot: Shot, times: float, seed: int, *, longest_s: float = LONGEST_S, most_gain: float = MOST_GAIN
) -> Capture:
    """A capture of the shot's mean electrons in so many times its light: automatic time first, then gain."""
    camera = shot.capture.camera
    rate = shot.truth.mean_e.astype(np.float64) * (times / shot.capture.exposure_s)
    wanted = noise.auto_exposure_s(rate, camera, noise.Exposure())
    time_s = min(wanted, longest_s)
    gain = float(np.clip(wanted / time_s, 1.0, most_gain))
    collected = noise.electronic_crosstalk(noise.mosaic(rate * time_s, camera), camera.sensor)
    raw, _ = noise.expose(collected, camera.sensor, time_s, seed, gain=gain)
    return Capture(raw, camera, time_s, gain, seed)
