"""Reconstruction: from a raw picture of a dual-aperture camera to colour, depth and an all-in-focus picture.

``calibrate`` measures point-spread functions, ``reconstruct`` applies them; ``develop`` makes the
colour picture alone; ``refocus`` blurs the result anew. Only values and their files are
shared with the simulator, never its formulas.
"""

from dasim.files.banks import load_bank, save_bank
from dasim.files.captures import load_capture
from dasim.values import DepthEstimate, PsfBank, Reconstruction
from recon.calibration.psf_bank import calibrate
from recon.depth.method import METHODS, Method
from recon.files.raw import load_raw
from recon.files.reconstruction import load_reconstruction, save_reconstruction
from recon.picture.infrared import measured_crosstalk
from recon.picture.shading import check as check_flat
from recon.pipeline import develop, reconstruct
from recon.settings import DEFAULT, PAPER, PRESETS, Settings
from recon.sharp.refocus import refocus

__all__ = [
    "DEFAULT",
    "METHODS",
    "PAPER",
    "PRESETS",
    "DepthEstimate",
    "Method",
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
