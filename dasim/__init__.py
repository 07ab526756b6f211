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
    from dasim.base.errors import InputError
    from dasim.camera.noise import Exposure
    from dasim.camera.pointspread import psf
    from dasim.camera.specification import Camera, cropped, load_camera, refocused
    from dasim.dataset.reading import open_dataset
    from dasim.files.folders import load_capture, load_truth, save_capture
    from dasim.random_scenes.specification import RandomScenes, load_random_scenes, random_exposure, random_scene
    from dasim.scene.loading import MitsubaScene, focused, load_scene
    from dasim.scene.specification import Scene
    from dasim.simulation.calibration import calibration_captures
    from dasim.simulation.simulate import Shot, simulate
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
    "simulation.calibration": ("calibration_captures",),
    "camera.specification": ("Camera", "cropped", "load_camera", "refocused"),
    "base.errors": ("InputError",),
    "camera.pointspread": ("psf",),
    "random_scenes.specification": ("RandomScenes", "load_random_scenes", "random_exposure", "random_scene"),
    "scene.loading": ("MitsubaScene", "focused", "load_scene"),
    "scene.specification": ("Scene",),
    "camera.noise": ("Exposure",),
    "simulation.simulate": ("Shot", "simulate"),
    "files.folders": ("load_capture", "load_truth", "save_capture"),
    "dataset.reading": ("open_dataset",),
    "values": ("Capture", "Truth"),
}


def __getattr__(name: str) -> Any:
    for module, names in _HOME.items():
        if name in names:
            return getattr(importlib.import_module(f"dasim.{module}"), name)
    raise AttributeError(f"module 'dasim' has no attribute '{name}'")
