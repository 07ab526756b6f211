"""Colour (sec. 4.4, 5.2): which light it is, and the matrix from linear camera colours to sRGB."""

from __future__ import annotations

from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray

from dasim import illuminants, spectra
from dasim.camera import Camera, response
from dasim.colour import fitted_matrix
from dasim.errors import InputError
from dasim.values import PsfBank
from recon.infrared import crosstalk

Float32Array = NDArray[np.float32]
FloatArray = NDArray[np.float64]

DARK_SHARE = 0.02  # of the brightest: darker areas tell little of the light
MINKOWSKI = 4.0  # between grey world (1) and white patch (infinity): "shades of grey", Finlayson and Trezzi 2004
BLOCK_PX = 8  # of the planes: averaging takes noise and clipped points out of the high power


def choose_light(planes: dict[str, NDArray], saturated: NDArray, bank: PsfBank) -> int:
    """Index of the bank's light that fits the raw picture, by automatic white balance (sec. 5.1).

    Minkowski means of the four colour planes [h/2, w/2] over unsaturated blocks, compared with
    ``bank.signature`` in log-chromaticity (R, B and IR against G): infrared tells lamps from daylight.
    """
    mean = np.array([_minkowski(planes[name], saturated) for name in spectra.CHANNELS])
    if not np.all(mean > 0):
        return 0
    green = spectra.CHANNELS.index("G")
    measured = np.log(mean / mean[green])
    known = np.log(np.maximum(bank.signature, np.finfo(np.float32).tiny))
    return int(np.argmin(((known - measured) ** 2).sum(axis=1)))


def _minkowski(plane: NDArray, saturated: NDArray) -> float:
    """(mean x^p)^(1/p) over blocks without saturated pixels; 0 where there is no light."""
    share = (~saturated).astype(np.float32)
    size = (max(plane.shape[1] // BLOCK_PX, 1), max(plane.shape[0] // BLOCK_PX, 1))
    block = cv2.resize(plane.astype(np.float32) * share, size, interpolation=cv2.INTER_AREA)
    whole = cv2.resize(share, size, interpolation=cv2.INTER_AREA) > 1 - 1e-3
    if not whole.any():
        return 0.0
    value = np.maximum(block[whole].astype(np.float64), 0)
    bright = value[value > DARK_SHARE * value.max()]
    return float(np.mean(bright**MINKOWSKI) ** (1 / MINKOWSKI)) if bright.size else 0.0


def colour_matrix(camera: Camera, light: str) -> FloatArray:
    """Matrix [3, 3] from camera electrons without infrared (R, G, B) to linear sRGB under D65.

    Fitted to the ColorChecker under the light, after eq. (7): see ``dasim.colour.fitted_matrix``. A light that
    ``dasim.illuminants`` does not know is treated as D65.
    """
    return _colour_matrix(camera.model_dump_json(), light)


@lru_cache(maxsize=64)
def _colour_matrix(camera_json: str, light: str) -> FloatArray:
    camera = Camera.model_validate_json(camera_json)
    try:
        power = illuminants.illuminant(light)
    except InputError:
        power = illuminants.illuminant("D65")
    curves = response(camera)
    return fitted_matrix(curves[:3] - crosstalk(camera)[:, None] * curves[3:], power)
