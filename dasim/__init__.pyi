from .base.errors import InputError
from .camera.describe import describe
from .camera.dotted_keys import with_values
from .camera.noise import Exposure, NoiseModel
from .camera.pointspread import psf
from .camera.prescription import camera_from_lens
from .camera.specification import Camera, camera_names, cropped, load_camera, refocused
from .dataset.reading import Dataset, Sample, open_dataset
from .files.banks import load_bank, save_bank
from .files.captures import load_capture, load_truth, save_capture
from .loading import focused, load_scene
from .materials.library import material_names
from .random_scenes.scene import random_exposure, random_scene
from .random_scenes.specification import RandomScenes, load_random_scenes
from .scene.classes import CLASSES
from .scene.loading import scene_names
from .scene.mitsuba_scene import MitsubaScene
from .scene.specification import Scene
from .scene.targets import depth_steps, point_source, staircase
from .simulation.calibration import calibration_captures
from .simulation.exposure import Shot, expose, expose_series
from .simulation.relight import exposed, lit_by
from .simulation.simulate import simulate
from .simulation.tiling import tiled
from .spectra.illuminants import illuminant_names
from .values import Capture, DepthEstimate, Developed, PointPicture, PointPictures, PsfBank, Reconstruction, Truth

__all__ = [
    "CLASSES",
    "Camera",
    "Capture",
    "Dataset",
    "DepthEstimate",
    "Developed",
    "Exposure",
    "InputError",
    "MitsubaScene",
    "NoiseModel",
    "PointPicture",
    "PointPictures",
    "PsfBank",
    "RandomScenes",
    "Reconstruction",
    "Sample",
    "Scene",
    "Shot",
    "Truth",
    "calibration_captures",
    "camera_from_lens",
    "camera_names",
    "cropped",
    "depth_steps",
    "describe",
    "expose",
    "expose_series",
    "exposed",
    "focused",
    "illuminant_names",
    "lit_by",
    "load_bank",
    "load_camera",
    "load_capture",
    "load_random_scenes",
    "load_scene",
    "load_truth",
    "material_names",
    "open_dataset",
    "point_source",
    "psf",
    "random_exposure",
    "random_scene",
    "refocused",
    "save_bank",
    "save_capture",
    "scene_names",
    "simulate",
    "staircase",
    "tiled",
    "with_values",
]
