"""Pictures by name: grey ones as heights, and RGB ones as materials by a near-infrared rule."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from dasim import materials
from dasim.errors import InputError
from dasim.materials import Diffuse, Mixture, Surface

NEAR_INFRARED_RULES = ("print", "dyed", "achromatic")
_LUMINANCE = np.array([0.2126, 0.7152, 0.0722], np.float32)


def photograph_surface(linear_rgb: NDArray[np.float32], rule: str, repeat: tuple[float, float] = (1.0, 1.0)) -> Surface:
    """The surface of a picture in linear light [h, w, 3] by a near-infrared rule."""
    if rule == "achromatic":
        dark, bright = (Diffuse(np.full(materials.WAVELENGTH_NM.shape, value)) for value in (0.0, 1.0))
        return Mixture((linear_rgb @ _LUMINANCE).astype(np.float32), dark, bright, repeat)
    return materials._printed(linear_rgb, materials.reflectance("white-paper"), 0.6, repeat)


def grey_picture(image: str, folder: Path) -> NDArray[np.float32]:
    """Values 0..1 of a grey picture as they stand in the file (8 or 16 bits), [h, w], top row first."""
    path = materials.photograph_path(image, folder)
    data = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE | cv2.IMREAD_ANYDEPTH)
    if data is None or data.dtype not in (np.uint8, np.uint16):
        raise InputError(f"image '{image}': {path} cannot be read as a picture of 8 or 16 bits")
    return data.astype(np.float32) / np.float32(np.iinfo(data.dtype).max)
