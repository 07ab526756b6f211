"""Colour (sec. 4.4, 5.1): white balance, and the matrix from linear camera colours to sRGB."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray

from dasim.camera import noise
from dasim.camera.radiometry import response
from dasim.camera.rings import rings
from dasim.camera.sensor import channels
from dasim.camera.specification import Camera
from dasim.spectra import grid
from dasim.spectra.colour import fitted_matrix
from dasim.typing import Float32Array, FloatArray
from dasim.values import PsfBank
from recon.picture import field, infrared, mosaic
from recon.picture.infrared import light_power
from recon.settings import PAPER

DARK_SHARE = 0.02  # of the brightest block, below which a block is not used for white balance
MINKOWSKI = 4.0  # between grey world (1) and white patch (infinity): "shades of grey", Finlayson and Trezzi 2004
# Log-chromaticity distance of a note: D65 and A differ by 1.46, photographs from their light by less than 0.5, a grey
# card under lamps that a bank lacks from its nearest light by 0.6 to 0.85 (F5, LED-B5, LED-V1, F3.4).
FAR_LIGHT = 0.55
NOISE_SD = 3.0
BLOCK_PX = 8  # side of the blocks of a plane, whose average suppresses noise and clipped points


def choose_light(
    raw_e: Float32Array, saturated: NDArray, camera: Camera, lights: Sequence[str], signature: NDArray
) -> int:
    """Index of the light of a raw picture, by automatic white balance (sec. 5.1).

    The light is the nearest in log-chromaticity (R, B and IR relative to G) to the Minkowski mean over unsaturated
    blocks. Infrared separates lamps from daylight. The loss of white off the axis is corrected for each light.

    Args:
        raw_e: linear mosaic, [h, w] electrons.
        saturated: mask of saturated pixels, [h, w].
        camera: gives mosaic and response curves.
        lights: names of the lights.
        signature: electrons of white on the axis relative to green, [light, channel], of a bank or :func:`signatures`.
    """
    distance = light_distances(raw_e, saturated, camera, lights, signature)
    return 0 if distance is None else int(distance.argmin())


def light_distances(
    raw_e: Float32Array, saturated: NDArray, camera: Camera, lights: Sequence[str], signature: NDArray
) -> FloatArray | None:
    """Log-chromaticity distance of a picture's white from every light, [light].

    None for a picture without light, whose means are within ``NOISE_SD`` standard deviations of a block's noise.
    """
    dark_e = NOISE_SD * float(np.hypot(camera.sensor.read_noise_e, noise.electrons_per_dn(camera.sensor) / 12**0.5))
    planes = mosaic.planes(raw_e, camera)
    unsaturated = (~mosaic.saturated_blocks(saturated)).astype(np.float32)
    whole = _averaged(unsaturated) > 1 - 1e-3
    blocks = {name: _averaged(plane.astype(np.float32) * unsaturated)[whole] for name, plane in planes.items()}
    angles, place = rings(camera)
    place = _averaged(place[::2, ::2])[whole]
    distances = []
    for light, white in zip(lights, signature, strict=True):
        relative = field.relative_white(camera, light, angles)
        shares = [field.on_grid(row, place) for row in relative]
        mean = np.array([_minkowski(block / share) for block, share in zip(blocks.values(), shares, strict=True)])
        if not np.all(mean > dark_e / BLOCK_PX):
            return None
        measured = np.log(mean / mean[list(planes).index("G")])
        expected = np.log(np.maximum(white, np.finfo(np.float32).tiny))
        distances.append(np.sqrt(((expected - measured) ** 2).sum()))
    return np.array(distances)


def light_notes(raw_e: Float32Array, saturated: NDArray, camera: Camera, bank: PsfBank) -> tuple[str, ...]:
    """A note if the picture's white is far from every light of the bank, or cannot be measured."""
    distance = light_distances(raw_e, saturated, camera, bank.lights, bank.signature)
    if distance is None:
        return (f"the picture is too dark or too bright to measure its light; {bank.lights[0]} is assumed",)
    nearest = int(distance.argmin())
    if distance[nearest] < FAR_LIGHT:
        return ()
    return (
        f"the picture's white is far from every light of the bank ({', '.join(bank.lights)}), the nearest is "
        f"{bank.lights[nearest]}; for another light, make a bank that has it ('dasim calibrate --illuminant NAME "
        "--out BANK', for a real camera with --captures) and give it with --bank",
    )


def _averaged(plane: NDArray) -> NDArray:
    """A plane averaged over square blocks of ``BLOCK_PX``."""
    size = (max(plane.shape[1] // BLOCK_PX, 1), max(plane.shape[0] // BLOCK_PX, 1))
    return np.asarray(cv2.resize(plane, size, interpolation=cv2.INTER_AREA))


def _minkowski(blocks: NDArray) -> float:
    """Minkowski mean (mean x^p)^(1/p) of values, without the dark ones; 0 without light."""
    if not blocks.size:
        return 0.0
    value = np.maximum(blocks.astype(np.float64), 0)
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
