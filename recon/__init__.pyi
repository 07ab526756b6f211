from .calibration.cached import calibrate
from .depth.method import METHODS, Method
from .files.raw import load_raw
from .files.reconstruction import load_reconstruction, save_reconstruction
from .picture.develop import develop
from .picture.infrared import measured_crosstalk
from .picture.shading import check_flat
from .pipeline import reconstruct
from .settings import DEFAULT, PAPER, PRESETS, Settings
from .sharp.refocus import refocus
from .values import (
    Capture,
    DepthEstimate,
    Developed,
    InputError,
    PointPicture,
    PsfBank,
    Reconstruction,
    load_bank,
    load_capture,
    save_bank,
)

__all__ = [
    "DEFAULT",
    "METHODS",
    "PAPER",
    "PRESETS",
    "Capture",
    "DepthEstimate",
    "Developed",
    "InputError",
    "Method",
    "PointPicture",
    "PsfBank",
    "Reconstruction",
    "Settings",
    "calibrate",
    "check_flat",
    "develop",
    "load_bank",
    "load_capture",
    "load_raw",
    "load_reconstruction",
    "measured_crosstalk",
    "reconstruct",
    "refocus",
    "save_bank",
    "save_reconstruction",
]
