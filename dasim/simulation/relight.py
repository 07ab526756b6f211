"""Another illuminant for a scene before rendering, another light level for a rendered picture.

Tested in tests/validation/claims/test_depth.py.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from dasim.base.errors import InputError, kind_of
from dasim.camera import noise
from dasim.loading import as_scene
from dasim.scene.lights import Daylight
from dasim.scene.mitsuba_scene import MitsubaScene
from dasim.scene.specification import Scene
from dasim.simulation.exposure import Shot, expose
from dasim.spectra import illuminants
from dasim.values import Capture

LONGEST_S, MOST_GAIN = 1 / 30, 16.0  # of a hand-held picture


def lit_by(scene: Scene | MitsubaScene | str | Path, illuminant: str) -> Scene:
    """The scene with one illuminant in all of its lights, at unchanged lux.

    ``scene`` may be given by name or path, but not as a Mitsuba scene, nor with a light of the kind ``daylight``, whose
    spectrum follows from the sun's elevation; ``illuminant`` is a name such as ``"D65"`` or ``"A"``. Raises InputError
    otherwise.
    """
    scene = as_scene(scene)
    if isinstance(scene, MitsubaScene):
        raise InputError(f"scene '{scene.name}': the lights of a Mitsuba scene are its file's; see 'illuminant'")
    illuminants.illuminant(illuminant)
    if any(isinstance(item, Daylight) for item in scene.lights):
        raise InputError(
            f"scene '{scene.name}': the spectrum of a light of kind 'daylight' is that of sun and sky; "
            "use the kinds 'sun' and 'sky' for another illuminant"
        )
    lights = tuple(item.model_copy(update={"illuminant": illuminant}) for item in scene.lights)
    return scene.model_copy(update={"name": f"{scene.name}:{illuminant}", "lights": lights})


def exposed(
    shot: Shot, times: float, seed: int, *, longest_s: float = LONGEST_S, most_gain: float = MOST_GAIN
) -> Capture:
    """A shot exposed again, with all lights ``times`` as bright, as a hand-held camera would.

    Automatic exposure sets the time, at most ``longest_s`` seconds; beyond that the analogue gain rises to at most
    ``most_gain``, a factor. ``seed`` is the seed of the sensor noise, which is that of the bundled model. The result is
    the capture alone; :func:`dasim.expose` also returns the truth and takes a fixed exposure.
    """
    exposure = hand_held(shot, times, longest_s, most_gain)
    return expose(shot, scale=times, exposure=exposure, seed=seed, noise=noise.expose).capture


def hand_held(shot: Shot, times: float, longest_s: float, most_gain: float) -> noise.Exposure:
    """The automatic exposure of a shot at ``times`` its light level: the time first, then the gain."""
    for name, value in (("times", times), ("longest_s", longest_s), ("most_gain", most_gain)):
        if not isinstance(value, (int, float, np.number)) or not 0 < value < np.inf:
            raise InputError(f"{name}: must be a number above 0, not {kind_of(value)}")
    rate = shot.truth.mean_e.astype(np.float64) * (times / shot.capture.exposure_s)
    automatic_s = noise.auto_exposure_s(rate, shot.capture.camera, noise.Exposure())
    time_s = min(automatic_s, longest_s)
    return noise.Exposure(time_s=time_s, gain=float(np.clip(automatic_s / time_s, 1.0, most_gain)))
