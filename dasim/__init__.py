"""dasim: physical simulation of dual-aperture cameras.

>>> import dasim
>>> scene = dasim.load_scene("desk")
>>> camera = dasim.focused(dasim.load_camera("da-mobile"), scene)
>>> shot = dasim.simulate(scene, camera, seed=0)

Names are loaded when first used: ``import dasim`` alone loads no Mitsuba.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from dasim.calibration import calibration_captures
    from dasim.camera import Camera, cropped, load_camera, refocused
    from dasim.dataset.reading import open_dataset
    from dasim.errors import InputError
    from dasim.files import load_capture, load_truth, save_capture
    from dasim.foreign import MitsubaScene, focused, load_scene
    from dasim.pointspread import psf
    from dasim.random_scenes import RandomScenes, load_random_scenes, random_exposure, random_scene
    from dasim.scene import Scene
    from dasim.sensor import Exposure
    from dasim.simulation import Shot, simulate
    from dasim.values import Capture, Truth

__all__ = [
    "Camera",
    "Capture",
    "Exposure",
    "InputError",
    "MitsubaScene",
    "RandomScenes",
    "Scene",
    "Shot",
    "Truth",
    "calibration_captures",
    "cropped",
    "focused",
    "load_camera",
    "load_capture",
    "load_random_scenes",
    "load_scene",
    "load_truth",
    "open_dataset",
    "psf",
    "random_exposure",
    "random_scene",
    "refocused",
    "save_capture",
    "simulate",
]

_HOME = {
    "calibration": ("calibration_captures",),
    "camera": ("Camera", "cropped", "load_camera", "refocused"),
    "errors": ("InputError",),
    "pointspread": ("psf",),
    "random_scenes": ("RandomScenes", "load_random_scenes", "random_exposure", "random_scene"),
    "foreign": ("MitsubaScene", "focused", "load_scene"),
    "scene": ("Scene",),
    "sensor": ("Exposure",),
    "simulation": ("Shot", "simulate"),
    "files": ("load_capture", "load_truth", "save_capture"),
    "dataset.reading": ("open_dataset",),
    "values": ("Capture", "Truth"),
}


def __getattr__(name: str) -> Any:
    for module, names in _HOME.items():
        if name in names:
            return getattr(importlib.import_module(f"dasim.{module}"), name)
    raise AttributeError(f"module 'dasim' has no attribute '{name}'")
