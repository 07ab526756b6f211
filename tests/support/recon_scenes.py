"""Captures of scenes with a given blur level per pixel, computed from photographs without a renderer.

The texture of each stop (visible light through the open lens, near-infrared through the hole) is blurred with the
wave-optical kernels of that stop at each level, so that crosstalk, colour and blur are consistent as in a camera.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np
import skimage.data
from scipy import fft, ndimage

import recon
from dasim.camera import geometry, pointspread, specification
from dasim.camera import noise as sensor
from dasim.camera.crosstalk import electronic_crosstalk
from dasim.simulation import calibration
from dasim.spectra import illuminants
from dasim.values import Capture, PsfBank
from tests.support.shared import shared

MARGIN_PX = 48
GAMMA = 2.2


@dataclass(frozen=True)
class Scene:
    """A capture with its exact values."""

    capture: Capture
    level: np.ndarray  # [h, w]
    mean_e: np.ndarray  # [h, w, 4]
    sharp_e: np.ndarray  # [h, w, 4]


@cache
def da_mobile(width: int, height: int) -> specification.Camera:
    return specification.cropped(specification.load_camera("da-mobile"), width, height)


@shared
def bank(lights: tuple[str, ...] = ("D65", "A")) -> PsfBank:
    cam = da_mobile(512, 384)
    return recon.calibrate(calibration.calibration_captures(cam, lights), cam)


@shared
def stop_kernels(light: str, step: float = 0.5) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Levels, kernels [stop, level, channel, y, x] and electrons [stop, channel] relative to green in total."""
    cam = da_mobile(512, 384)
    per_level = geometry.level_blur_px(cam)[1]
    levels = np.arange(0, 28 + step / 2, step)
    kernels, signals = [], []
    radius = np.arange(0, 60, pointspread.RADIAL_STEP_PX)
    for stop in cam.stops:
        one = cam.model_copy(update={"stops": (stop,)})
        profile, signal = pointspread.radial_profiles(one, levels * per_level, illuminants.illuminant(light), radius)
        kernels.append(pointspread.pixel_kernels(profile, radius, 75, nodes=6).astype(np.float32))
        signals.append(signal)
    signals = np.array(signals)
    kernels = np.array(kernels)
    return levels, kernels / kernels.sum((-1, -2), keepdims=True), signals / signals[:, 1].sum()


def _photo(name: str, height: int, width: int, zoom: float) -> np.ndarray:
    image = getattr(skimage.data, name)().astype(np.float32) / 255
    image = np.repeat(image[..., None], 3, -1) if image.ndim == 2 else image[..., :3]
    image = ndimage.zoom(image, (zoom, zoom, 1), order=1) if zoom != 1 else image
    up = -(-height // image.shape[0]), -(-width // image.shape[1])
    padded = np.pad(image, ((0, (up[0] - 1) * image.shape[0]), (0, (up[1] - 1) * image.shape[1]), (0, 0)), "symmetric")
    return padded[:height, :width] ** GAMMA


def textures(height: int, width: int, photo: str = "astronaut", zoom: float = 1.0) -> tuple[np.ndarray, np.ndarray]:
    """Textures 0..1 in visible light [h, w, 4] and near-infrared [h, w], which are correlated but differ."""
    colour = _photo(photo, height, width, zoom)
    other = _photo("gravel", height, width, 1.0)[..., 0]
    visible = np.concatenate([colour, colour[..., :1]], axis=-1)
    infrared = 0.12 + 0.55 * colour[..., 0] + 0.2 * colour[..., 1] + 0.08 * other
    return visible, infrared


def blurred(visible: np.ndarray, infrared: np.ndarray, level: np.ndarray, light: str) -> np.ndarray:
    """Mean electrons relative to green of a white surface, [h, w, 4], without the margin that the textures have."""
    levels, kernels, signal = stop_kernels(light)
    shape = visible.shape[:2]
    size = [fft.next_fast_len(n + 75, real=True) for n in shape]
    position = level / (levels[1] - levels[0])
    low = np.clip(np.floor(position).astype(int), 0, len(levels) - 2)
    share = position - low
    result = np.zeros((*level.shape, 4), np.float32)
    for channel in range(4):
        sources = [fft.rfft2(t, size, workers=2) for t in (visible[..., channel], infrared)]
        for index in range(len(levels)):
            weight = np.where(low == index, 1 - share, np.where(low + 1 == index, share, 0))
            if not weight.any():
                continue
            spectrum = sum(
                signal[stop, channel] * sources[stop] * fft.rfft2(kernels[stop, index, channel], size, workers=2)
                for stop in range(2)
            )
            full = fft.irfft2(spectrum, size, workers=2)[37 : 37 + shape[0], 37 : 37 + shape[1]]
            result[..., channel] += weight * full[MARGIN_PX:-MARGIN_PX, MARGIN_PX:-MARGIN_PX]
    return result


def make(
    level: np.ndarray,
    *,
    photo: str = "astronaut",
    zoom: float = 1.0,
    light: str = "D65",
    white_e: float = 4000.0,
    noise: str = "on",
    seed: int = 1,
) -> Scene:
    """Capture of a photograph with the blur level [h, w] of each pixel."""
    height, width = level.shape
    cam = da_mobile(width, height)
    visible, infrared = textures(height + 2 * MARGIN_PX, width + 2 * MARGIN_PX, photo, zoom)
    _, _, signal = stop_kernels(light)
    mean_e = white_e * blurred(visible, infrared, level, light)
    inner = slice(MARGIN_PX, -MARGIN_PX)
    sharp = signal[0] * visible[inner, inner] + signal[1] * infrared[inner, inner, None]
    collected_e = electronic_crosstalk(sensor.mosaic(mean_e, cam), cam)
    raw, _ = sensor.expose(collected_e, cam.sensor, 0.02, seed, noise=noise)
    capture = Capture(raw, cam, 0.02, 1.0, seed)
    return Scene(capture, level, mean_e.astype(np.float32), (white_e * sharp).astype(np.float32))


def staircase(height: int, width: int, first: float, last: float, bands: int) -> np.ndarray:
    """Levels [h, w] in horizontal bands, from ``first`` at the top to ``last``."""
    steps = np.linspace(first, last, bands)
    return np.repeat(steps[np.minimum(np.arange(height) * bands // height, bands - 1)][:, None], width, 1)


def slanted(height: int, width: int, first: float, last: float) -> np.ndarray:
    """Levels [h, w] that change linearly from ``first`` at the left to ``last``."""
    return np.repeat(np.linspace(first, last, width)[None], height, 0)
