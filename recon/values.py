"""Values and file formats that the reconstruction shares with the simulator."""

from dasim.base.errors import InputError
from dasim.files.banks import load_bank, save_bank
from dasim.files.captures import load_capture
from dasim.values import Capture, DepthEstimate, Developed, PointPicture, PsfBank, Reconstruction

__all__ = [
    "Capture",
    "DepthEstimate",
    "Developed",
    "InputError",
    "PointPicture",
    "PsfBank",
    "Reconstruction",
    "load_bank",
    "load_capture",
    "save_bank",
]
