"""Another illuminant for a scene before rendering, another light level for a rendered picture.

Tested in tests/validation/claims/test_depth.py.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from dasim.base.errors import InputError
from dasim.camera import noise
from dasim.camera.crosstalk import electronic_crosstalk
from dasim.loading import as_scene
from dasim.scene.mitsuba_scene import MitsubaScene
from dasim.scene.specification import Scene
from dasim.simulation.simulate import Shot
from dasim.spectra import illuminants
from dasim.values import Capture

LONGEST_S, MOST_GAIN = 1 / 30, 16.0  # of a hand-held picture


def lit_by(scene: Scene | MitsubaScene | str | Path, illuminant: str) -> Scene:
    """The scene with one illuminant in all of its lights, at unchanged lux.

    ``scene`` may be given by name or path, but not as a Mitsuba scene; ``illuminant`` is a name such as ``"D65"`` or
    ``"A"``.
    """
    scene = as_scene(scene)
    if isinstance(scene, MitsubaScene):
        raise InputError(f"scene '{scene.name}': the lights of a Mitsuba scene are its file's; see 'illuminant'")
    illuminants.illuminant(illuminant)
    lights = tuple(item.model_copy(update={"illuminant": illuminant}) for item in scene.lights)
    return scene.model_copy(update={"name": f"{scene.name}:{illuminant}", "lights": lights})


def exposed(
    shot: Shot, times: float, seed: int, *, longest_s: float = LONGEST_S, most_gain: float = MOST_GAIN
) -> Capture:
    """A new capture of a shot at ``times`` its light level, with the sensor noise of ``seed``, without rendering again.

    Automatic exposure sets the time, at most ``longest_s`` seconds, then the analogue gain, at most ``most_gain``.
    """
    camera = shot.capture.camera
    rate = shot.truth.mean_e.astype(np.float64) * (times / shot.capture.exposure_s)
    automatic_s = noise.auto_exposure_s(rate, camera, noise.Exposure())
    time_s = min(automatic_s, longest_s)
    gain = float(np.clip(automatic_s / time_s, 1.0, most_gain))
    collected = electronic_crosstalk(noise.mosaic(rate * time_s, camera), camera)
    raw, _ = noise.expose(collected, camera.sensor, time_s, seed, gain=gain)
    return Capture(raw, camera, time_s, gain, seed)
