from .base.errors import InputError
from .camera.noise import Exposure
from .camera.pointspread import psf
from .camera.specification import Camera, cropped, load_camera, refocused
from .dataset.reading import open_dataset
from .files.captures import load_capture, load_truth, save_capture
from .random_scenes.specification import RandomScenes, load_random_scenes, random_exposure, random_scene
from .scene.loading import focused, load_scene
from .scene.mitsuba_scene import MitsubaScene
from .scene.specification import Scene
from .simulation.calibration import calibration_captures
from .simulation.simulate import Shot, simulate
from .values import Capture, Truth

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
