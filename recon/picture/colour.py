"""Colour (sec. 4.4, 5.2): which light it is, and the matrix from linear camera colours to sRGB."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray

from dasim.camera.radiometry import response
from dasim.camera.specification import Camera, channels
from dasim.spectra import grid
from dasim.spectra.colour import fitted_matrix
from dasim.typing import Float32Array, FloatArray
from dasim.values import PsfBank
from recon.picture import infrared, mosaic
from recon.picture.infrared import light_power
from recon.settings import PAPER

DARK_SHARE = 0.02  # of the brightest: darker areas tell little of the light
MINKOWSKI = 4.0  # between grey world (1) and white patch (infinity): "shades of grey", Finlayson and Trezzi 2004
FAR_LIGHT = 1.0  # in log-chromaticity: D65 and A are 1.46 apart, photographs within 0.5 of their own light
BLOCK_PX = 8  # of the planes: averaging takes noise and clipped points out of the high power


def choose_light(planes: dict[str, NDArray], saturated: NDArray, signature: NDArray) -> int:
    """Index of the light that fits the raw picture, by automatic white balance (sec. 5.1).

    Minkowski means of the colour planes [h/2, w/2], in the channels' order, over unsaturated blocks, compared with
    ``signature`` [light, channel], a bank's or :func:`signatures`, in log-chromaticity (R, B and IR against G):
    infrared tells lamps from daylight.
    """
    distance = light_distances(planes, saturated, signature)
    return 0 if distance is None else int(distance.argmin())


def light_distances(planes: dict[str, NDArray], saturated: NDArray, signature: NDArray) -> FloatArray | None:
    """Distances in log-chromaticity of a picture's white from every light's, [light]; None where it has no light."""
    mean = np.array([_minkowski(plane, saturated) for plane in planes.values()])
    if not np.all(mean > 0):
        return None
    green = list(planes).index("G")
    measured = np.log(mean / mean[green])
    known = np.log(np.maximum(signature, np.finfo(np.float32).tiny))
    return np.asarray(np.sqrt(((known - measured) ** 2).sum(axis=1)))


def light_notes(raw_e: Float32Array, saturated: NDArray, camera: Camera, bank: PsfBank) -> tuple[str, ...]:
    """A note where the picture's white lies far from every light of the bank, or cannot be measured."""
    distance = light_distances(mosaic.planes(raw_e, camera), mosaic.saturated_blocks(saturated), bank.signature)
    if distance is None:
        return (f"the picture is too dark or too bright to measure its light; {bank.lights[0]} is assumed",)
    nearest = int(distance.argmin())
    if distance[nearest] < FAR_LIGHT:
        return ()
    return (
        f"the picture's white lies far from every light of the bank ({', '.join(bank.lights)}), the nearest is "
        f"{bank.lights[nearest]}; if it was taken under another light, add that with 'dasim calibrate --illuminant'",
    )


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


def signatures(camera: Camera, lights: Sequence[str]) -> Float32Array:
    """Electrons of white relative to green under each light, [light, channel], from the response curves."""
    power = np.stack([light_power(light) for light in lights])
    electrons = grid.integrate(response(camera) * power[:, None, :])
    green = channels(camera.sensor).index("G")
    return np.asarray(electrons / electrons[:, green : green + 1], np.float32)


def colour_matrix(camera: Camera, light: str, separation: FloatArray | None = None) -> FloatArray:
    """Matrix [3, 3] from camera electrons without infrared (R, G, B) to linear sRGB under D65.

    Fitted to the ColorChecker under the light, after the removal of infrared by ``separation`` [3, channel] (by
    default that of eq. (7)): see ``dasim.spectra.colour.fitted_matrix``. A light that
    ``dasim.spectra.illuminants`` does not know is treated as D65.
    """
    rows = infrared.separation(camera, light, PAPER) if separation is None else separation
    return _colour_matrix(camera.model_dump_json(), light, tuple(map(tuple, rows.tolist())))


@lru_cache(maxsize=64)
def _colour_matrix(camera_json: str, light: str, separation: tuple[tuple[float, ...], ...]) -> FloatArray:
    camera = Camera.model_validate_json(camera_json)
    return fitted_matrix(np.array(separation) @ response(camera), light_power(light))
