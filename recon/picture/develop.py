"""The colour picture of a raw mosaic (sec. 4, Fig. 4): linear colours without infrared, and sRGB."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from dasim.base.errors import InputError
from dasim.camera.specification import Camera
from dasim.spectra.colour import exposure_scale, to_srgb
from dasim.typing import BoolArray, Float32Array, FloatArray, Progress
from dasim.values import Capture, Developed
from recon.picture import colour, denoise, infrared, mosaic, shading
from recon.settings import DEFAULT, Settings
from recon.stages import Stage, stages

MIN_FRAME_PX = 32
CLIPPED_NEAR_PX = 5  # side of the square in which a saturated pixel spoils the interpolated values
LIGHTS = ("D65", "D55", "A", "energy-saving-3500K")  # sec. 5.1, that white balance chooses from without a bank
STAGES = ("linearise", "light", "denoise", "infrared", "demosaic", "colour")


@dataclass(frozen=True)
class Linear:
    """A linear mosaic, and what is measured on it once."""

    raw_e: Float32Array  # [h, w] electrons
    saturated: BoolArray  # [h, w]
    light: int  # index of the light, by white balance
    gain: Float32Array | None  # [h, w] that undoes the lens shading; None without a flat


@dataclass(frozen=True)
class Demosaiced:
    """Every channel at full resolution, electrons."""

    full_e: Float32Array  # [h, w, 3], infrared included
    ir_e: Float32Array | None  # [h, w]; None where the mosaic has no infrared


def develop(
    capture: Capture,
    settings: Settings = DEFAULT,
    *,
    lights: Sequence[str] = LIGHTS,
    flat: Capture | None = None,
    progress: Progress | None = None,
) -> Developed:
    """The colour picture alone (sec. 4), of any supported mosaic, without a PSF bank.

    White balance chooses among ``lights`` by the camera's response curves. ``flat`` is a capture of an even surface,
    from which the lens shading is corrected.
    """
    camera = capture.camera
    timings: dict[str, float] = {}
    stage = stages(STAGES, timings, progress)
    signature = colour.signatures(camera, lights)
    linear = linearised(capture, signature, flat, stage)
    with stage("denoise"):
        clean_e = shaded(denoised(linear.raw_e, capture, settings), linear.gain)
    image = demosaiced(clean_e, camera, signature[linear.light], stage)
    light = lights[linear.light]
    with stage("colour"):
        separation = infrared.separation(camera, light, settings)
        linear_e = without_infrared(image, separation, clipped(linear.saturated, camera), signature[linear.light])
        matrix = colour.colour_matrix(camera, light, separation)
        rgb = to_srgb(linear_e, matrix, exposure_scale(linear_e, matrix))
    if progress:
        progress("done", 1.0)
    ir_e = None if image.ir_e is None else np.maximum(image.ir_e, 0)
    return Developed(rgb, linear_e, ir_e, matrix, camera, light, settings.model_dump(), timings)


def linearised(capture: Capture, signature: NDArray, flat: Capture | None, stage: Stage) -> Linear:
    """Electrons of a capture, and its light by white balance.

    ``signature`` [light, channel] are electrons of a white point under each light.
    """
    camera = capture.camera
    height, width = capture.raw_dn.shape
    if min(height, width) < MIN_FRAME_PX:
        raise InputError(f"capture: {width} x {height} pixels; at least {MIN_FRAME_PX} x {MIN_FRAME_PX} are needed")
    with stage("linearise"):
        raw_e, saturated = mosaic.linearise(capture)
        gain = None if flat is None else shading.gain(flat, camera)
    with stage("light"):
        light = colour.choose_light(mosaic.planes(raw_e, camera), mosaic.saturated_blocks(saturated), signature)
    return Linear(raw_e, saturated, light, gain)


def denoised(raw_e: Float32Array, capture: Capture, settings: Settings) -> Float32Array:
    """Sec. 4.1 on each grid of the mosaic [h, w], with the sensor's noise model; unchanged where it is off.

    Two grids in a quincunx (green of a Bayer block, three channels of the 4x4 block) are denoised separately.
    """
    if not settings.denoise:
        return raw_e
    clean = np.empty_like(raw_e)
    variance = mosaic.noise_variance(capture)
    for own in mosaic.grids(capture.camera).values():
        for row, column, step in own:
            plane = np.ascontiguousarray(raw_e[row::step, column::step])
            guide = denoise.stabilise(plane, variance)
            clean[row::step, column::step] = denoise.nonlocal_means(
                plane, guide, settings.denoise_bandwidth, settings.denoise_patch_sigma_px
            )
    return clean


def shaded(mosaic_e: Float32Array, gain: Float32Array | None) -> Float32Array:
    """A mosaic [h, w] with the lens shading corrected.

    Deviation from Fig. 4: after noise reduction, not before. The gain changes slowly, so the two commute, and the
    noise model stays that of the sensor.
    """
    return mosaic_e if gain is None else mosaic_e * gain


def demosaiced(mosaic_e: Float32Array, camera: Camera, white: NDArray, stage: Stage) -> Demosaiced:
    """Sec. 4.2-4.3: infrared and colours at full resolution, from a mosaic [h, w] in electrons.

    ``white`` [channel] are electrons of a white point under the light.
    """
    with stage("infrared"):
        planes = mosaic.planes(mosaic_e, camera)
        ir_e = infrared.interpolate(planes["IR"], mosaic.phases(camera)["IR"]) if "IR" in planes else None
    with stage("demosaic"):
        bayer = mosaic.to_bayer(mosaic_e, ir_e, camera, white)
        full_e = mosaic.demosaic(bayer, camera, white)
    return Demosaiced(full_e, ir_e)


def without_infrared(image: Demosaiced, separation: FloatArray, clipped: NDArray, white: NDArray) -> Float32Array:
    """Sec. 4.4 at full resolution, [h, w, 3]; values where ``clipped`` [h, w, 3] are lower bounds.

    A saturated channel has lost more than infrared: it is raised to the brightest channel's level, all relative to
    ``white`` [channel], so that a highlight is white instead of pink (deviation: the paper does not treat them).
    """
    with_ir = image.full_e if image.ir_e is None else np.dstack([image.full_e, np.maximum(image.ir_e, 0)])
    clean = infrared.separate(with_ir, separation)
    if not clipped.any():
        return clean
    neutral = (separation @ white[: separation.shape[1]]).astype(np.float32)
    level = (clean / neutral).max(axis=-1, keepdims=True)
    return np.asarray(np.where(clipped, np.maximum(clean, level * neutral), clean), np.float32)


def clipped(saturated: NDArray, camera: Camera) -> BoolArray:
    """Where R, G and B are interpolated from a saturated pixel, [h, w, 3]."""
    own = mosaic.grids(camera)
    near = np.ones((CLIPPED_NEAR_PX, CLIPPED_NEAR_PX), np.uint8)
    masks = [(saturated & mosaic.sites(own[name], saturated.shape)).astype(np.uint8) for name in "RGB"]
    return np.dstack([cv2.dilate(mask, near) > 0 for mask in masks])
