"""Pictures of a room through a dual-aperture lens, by layers: fast, approximate at edges, for training alone.

The scene is cut into thin slices of level. Each slice is blurred by its kernel, and a nearer slice covers farther ones
with its blurred mask. The scene behind a near object is unknown and is filled in from its surroundings.
"""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numpy as np
from scipy import fft

from dasim.camera import noise
from dasim.camera.crosstalk import electronic_crosstalk
from dasim.camera.specification import Camera
from dasim.typing import Float32Array, FloatArray
from dasim.values import Capture, PsfBank
from validation.training.rooms import FINE, Room

MARGIN = 48  # pixels of scene around the frame
FINEST, RELATIVE = 0.25, 0.05  # thickness of a slice
LEAST_COVER = 1e-3


class Optics(NamedTuple):
    """Transfer functions of a camera under a light."""

    transfer: Float32Array  # [level, channel, h, w / 2 + 1], of visible channels without infrared; real
    white: FloatArray  # [channel] electrons of a white point, relative to green
    leak: FloatArray  # alpha of eq. (8) for R, G, B


def optics(bank: PsfBank, light: int, alpha: FloatArray, height: int, width: int) -> Optics:
    """Transfer functions for frames of [height, width] pixels with their margins."""
    kernel, white = bank.kernel[light].astype(np.float64), bank.signature[light].astype(np.float64)
    share = alpha * white[3] / white[:3]
    clean = (kernel[:, :3] - share[:, None, None] * kernel[:, 3:]) / (1 - share)[:, None, None]
    both = np.concatenate([clean, kernel[:, 3:]], axis=1).astype(np.float32)
    shape = (height + 2 * MARGIN, width + 2 * MARGIN)
    half = both.shape[-1] // 2
    padded = np.zeros((*both.shape[:2], *shape), np.float32)
    padded[..., : 2 * half + 1, : 2 * half + 1] = both
    padded = np.roll(padded, (-half, -half), (-2, -1))
    return Optics(np.ascontiguousarray(fft.rfft2(padded).real), white, alpha)


def without_pixel(lens: Optics) -> Optics:
    """Transfer functions of the lens alone; those of measured kernels contain the pixel's area, as rooms do."""
    height, width = lens.transfer.shape[2], 2 * (lens.transfer.shape[3] - 1)
    pixel = np.sinc(np.fft.fftfreq(height))[:, None] * np.sinc(np.fft.rfftfreq(width))
    return lens._replace(transfer=(lens.transfer / pixel).astype(np.float32))


def photographed(room: Room, lens: Optics, camera: Camera, green_e: float, time_s: float, seed: int) -> Capture:
    """A raw capture of a room with ``green_e`` electrons of white in green."""
    raw, _ = noise.expose(green_e * mean_mosaic(room, lens, camera), camera.sensor, time_s, seed)
    return Capture(raw_dn=raw, camera=camera, exposure_s=time_s, gain=1.0, seed=seed)


def mean_mosaic(room: Room, lens: Optics, camera: Camera, thickness: float = 1.0) -> FloatArray:
    """Mean electrons of the mosaic of a room without its margin, [h, w], per electron of white in green.

    ``thickness`` is that of the slices, relative to ``FINEST`` and ``RELATIVE``.
    """
    mean = _blurred(room, lens, thickness)
    visible = (lens.white[:3] - lens.leak * lens.white[3])[:, None, None] * mean[:3]
    infrared = lens.white[3] * mean[3]
    electrons = np.concatenate([visible + lens.leak[:, None, None] * infrared, infrared[None]])
    inner = electrons[:, MARGIN:-MARGIN, MARGIN:-MARGIN]
    mosaic = noise.mosaic(np.maximum(np.moveaxis(inner, 0, -1), 0).astype(np.float64), camera)
    return electronic_crosstalk(mosaic, camera)


def level_of(room: Room) -> Float32Array:
    """Levels at the pixels of the frame, without margin."""
    middle = room.level[FINE // 2 :: FINE, FINE // 2 :: FINE]
    return middle[MARGIN:-MARGIN, MARGIN:-MARGIN]


def _blurred(room: Room, lens: Optics, thickness: float = 1.0) -> Float32Array:
    """The picture behind the lens, [channel, h, w], with margin."""
    height, width = lens.transfer.shape[2], 2 * (lens.transfer.shape[3] - 1)
    total = np.zeros((4, height, width), np.float32)
    cover = np.zeros((4, height, width), np.float32)
    through = np.ones((4, height, width), np.float32)
    edges = _slices(float(room.level.max()) + 1e-3, thickness)
    number = np.digitize(room.level, edges) - 1
    for index in range(int(number.max()), -1, -1):
        mask = number == index
        if not mask.any():
            continue
        layer = np.concatenate([room.radiance * mask, mask[None].astype(np.float32)])
        fine = np.stack([cv2.resize(part, (width, height), interpolation=cv2.INTER_AREA) for part in layer])
        spectra = fft.rfft2(fine)
        level = min(float(room.level[mask].mean()), len(lens.transfer) - 1.0)
        low = min(int(level), len(lens.transfer) - 2)
        transfer = lens.transfer[low] * (low + 1 - level) + lens.transfer[low + 1] * (level - low)
        light = fft.irfft2(spectra[:4] * transfer, (height, width))
        covers = fft.irfft2(spectra[4] * transfer[[1, 3]], (height, width))[[0, 0, 0, 1]]
        total += through * light
        cover += through * covers
        through *= np.clip(1 - covers, 0, 1)
    return np.asarray(total / np.maximum(cover, LEAST_COVER), np.float32)


def _slices(most: float, thickness: float = 1.0) -> FloatArray:
    """Edges of the slices from 0 to beyond ``most``."""
    edges = [0.0]
    while edges[-1] <= most:
        edges.append(edges[-1] + thickness * max(FINEST, RELATIVE * edges[-1]))
    return np.array(edges)
