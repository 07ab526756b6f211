"""Colour (sec. 4.4, 5.1): white balance, and the matrix from linear camera colours to sRGB."""

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

DARK_SHARE = 0.02  # of the brightest block, below which a block is not used for white balance
MINKOWSKI = 4.0  # between grey world (1) and white patch (infinity): "shades of grey", Finlayson and Trezzi 2004
FAR_LIGHT = 1.0  # log-chromaticity distance of a note; D65 and A differ by 1.46, photographs from their light by < 0.5
BLOCK_PX = 8  # side of the blocks of a plane, whose average suppresses noise and clipped points


def choose_light(planes: dict[str, NDArray], saturated: NDArray, signature: NDArray) -> int:
    """Index of the light of a raw picture, by automatic white balance (sec. 5.1).

    The light is the nearest in log-chromaticity (R, B and IR relative to G) to the Minkowski mean over unsaturated
    blocks. Infrared separates lamps from daylight.

    Args:
        planes: colour planes, [h/2, w/2] electrons each, in the order of the channels.
        saturated: mask of blocks with saturated pixels, [h/2, w/2].
        signature: electrons of white relative to green, [light, channel], of a bank or :func:`signatures`.
    """
    distance = light_distances(planes, saturated, signature)
    return 0 if distance is None else int(distance.argmin())


def light_distances(planes: dict[str, NDArray], saturated: NDArray, signature: NDArray) -> FloatArray | None:
    """Log-chromaticity distance of a picture's white from every light, [light]; None for a picture without light."""
    mean = np.array([_minkowski(plane, saturated) for plane in planes.values()])
    if not np.all(mean > 0):
        return None
    green = list(planes).index("G")
    measured = np.log(mean / mean[green])
    expected = np.log(np.maximum(signature, np.finfo(np.float32).tiny))
    return np.asarray(np.sqrt(((expected - measured) ** 2).sum(axis=1)))


def light_notes(raw_e: Float32Array, saturated: NDArray, camera: Camera, bank: PsfBank) -> tuple[str, ...]:
    """A note if the picture's white is far from every light of the bank, or cannot be measured."""
    distance = light_distances(mosaic.planes(raw_e, camera), mosaic.saturated_blocks(saturated), bank.signature)
    if distance is None:
        return (f"the picture is too dark or too bright to measure its light; {bank.lights[0]} is assumed",)
    nearest = int(distance.argmin())
    if distance[nearest] < FAR_LIGHT:
        return ()
    return (
        f"the picture's white is far from every light of the bank ({', '.join(bank.lights)}), the nearest is "
        f"{bank.lights[nearest]}; for another light, add it to the bank with 'dasim calibrate --illuminant'",
    )


def _minkowski(plane: NDArray, saturated: NDArray) -> float:
    """Minkowski mean (mean x^p)^(1/p) over blocks without saturated pixels; 0 without light."""
    share = (~saturated).astype(np.float32)
    size = (max(plane.shape[1] // BLOCK_PX, 1), max(plane.shape[0] // BLOCK_PX, 1))
    block = cv2.resize(plane.astype(np.float32) * share, size, interpolation=cv2.INTER_AREA)
    unsaturated = cv2.resize(share, size, interpolation=cv2.INTER_AREA) > 1 - 1e-3
    if not unsaturated.any():
        return 0.0
    value = np.maximum(block[unsaturated].astype(np.float64), 0)
    bright = value[value > DARK_SHARE * value.max()]
    return float(np.mean(bright**MINKOWSKI) ** (1 / MINKOWSKI)) if bright.size else 0.0


def signatures(camera: Camera, lights: Sequence[str]) -> Float32Array:
    """Electrons of white relative to green under each light, [light, channel], from the camera's response curves."""
    power = np.stack([light_power(light) for light in lights])
    electrons = grid.integrate(response(camera) * power[:, None, :])
    green = channels(camera.sensor).index("G")
    return np.asarray(electrons / electrons[:, green : green + 1], np.float32)


def colour_matrix(camera: Camera, light: str, separation: FloatArray | None = None) -> FloatArray:
    """Matrix [3, 3] from camera electrons without infrared (R, G, B) to linear sRGB under D65.

    The matrix is fitted to the ColorChecker under the light (``dasim.spectra.colour.fitted_matrix``) after the removal
    of infrared by ``separation`` [3, channel], by default that of eq. (7). Unknown lights are treated as D65.
    """
    rows = infrared.separation(camera, light, PAPER) if separation is None else separation
    return _colour_matrix(camera.model_dump_json(), light, tuple(map(tuple, rows.tolist())))


@lru_cache(maxsize=64)
def _colour_matrix(camera_json: str, light: str, separation: tuple[tuple[float, ...], ...]) -> FloatArray:
    camera = Camera.model_validate_json(camera_json)
    return fitted_matrix(np.array(separation) @ response(camera), light_power(light))
