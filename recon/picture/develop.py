"""The colour picture of a raw mosaic (sec. 4, Fig. 4): linear colours without infrared, and sRGB."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from dasim.base.errors import InputError
from dasim.camera.specification import Camera
from dasim.spectra.colour import exposure_scale, to_srgb
from dasim.typing import Float32Array, FloatArray
from dasim.values import Capture
from recon.picture import colour, denoise, infrared, mosaic, shading
from recon.settings import Settings

Stage = Callable[[str], AbstractContextManager[None]]

MIN_FRAME_PX = 32
CLIPPED_NEAR_PX = 5  # interpolation takes most of a value from pixels within two


@dataclass(frozen=True)
class Demosaiced:
    """Every channel at full resolution, as far as a conventional pipeline takes it, electrons."""

    raw_e: Float32Array  # [h, w] mosaic, linear
    saturated: NDArray[np.bool_]  # [h, w]
    light: int  # index of the light, by white balance
    full_e: Float32Array  # [h, w, 3], infrared included
    ir_e: Float32Array | None  # [h, w]; None where the mosaic has no infrared


def demosaiced(
    capture: Capture, signature: NDArray, settings: Settings, flat: Capture | None, stage: Stage
) -> Demosaiced:
    """Sec. 4.1-4.3 of one capture. ``signature`` [light, channel] are electrons of white under each light.

    The lens shading is undone after noise reduction, not before as in Fig. 4 (deviation): its gain changes slowly, so
    the two commute, and the noise model stays that of the sensor.
    """
    camera = capture.camera
    height, width = capture.raw_dn.shape
    if min(height, width) < MIN_FRAME_PX:
        raise InputError(f"capture: {width} x {height} pixels; at least {MIN_FRAME_PX} x {MIN_FRAME_PX} are needed")
    with stage("linearise"):
        raw_e, saturated = mosaic.linearise(capture)
        gain = None if flat is None else shading.gain(flat, camera)
    with stage("light"):
        light = colour.choose_light(mosaic.planes(raw_e, camera), blocks_any(saturated), signature)
    with stage("denoise"):
        clean_e = denoised(raw_e, capture, settings) if settings.denoise else raw_e
        clean_e = clean_e if gain is None else clean_e * gain
    with stage("infrared"):
        planes = mosaic.planes(clean_e, camera)
        ir_e = infrared.interpolate(planes["IR"], mosaic.phases(camera)["IR"]) if "IR" in planes else None
    with stage("demosaic"):
        bayer = mosaic.to_bayer(clean_e, ir_e, camera, signature[light])
        full_e = mosaic.demosaic(bayer, camera, signature[light])
    return Demosaiced(raw_e, saturated, light, full_e, ir_e)


def denoised(raw_e: Float32Array, capture: Capture, settings: Settings) -> Float32Array:
    """Sec. 4.1 on each grid of the mosaic [h, w]; the strength from the sensor's noise model.

    Two grids in a quincunx (green of a Bayer block, three channels of the 4x4 block) are taken one by one.
    """
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


def without_infrared(
    full_e: Float32Array, ir_e: Float32Array | None, separation: FloatArray, clipped: NDArray, white: NDArray
) -> Float32Array:
    """Sec. 4.4 at full resolution, [h, w, 3]; what is ``clipped`` [h, w, 3] is taken for a lower bound.

    A saturated channel has lost more than infrared: it is raised to the brightest channel's level, all measured
    against ``white`` [channel], so that a highlight is white and no pink (deviation: the paper does not treat them).
    """
    with_ir = full_e if ir_e is None else np.dstack([full_e, np.maximum(ir_e, 0)])
    clean = infrared.separate(with_ir, separation)
    if not clipped.any():
        return clean
    neutral = (separation @ white[: separation.shape[1]]).astype(np.float32)
    level = (clean / neutral).max(axis=-1, keepdims=True)
    return np.asarray(np.where(clipped, np.maximum(clean, level * neutral), clean), np.float32)


def clipped(saturated: NDArray, camera: Camera) -> NDArray[np.bool_]:
    """Where R, G and B took their value from a saturated pixel, [h, w, 3]."""
    own = mosaic.grids(camera)
    near = np.ones((CLIPPED_NEAR_PX, CLIPPED_NEAR_PX), np.uint8)
    masks = [(saturated & mosaic.sites(own[name], saturated.shape)).astype(np.uint8) for name in "RGB"]
    return np.dstack([cv2.dilate(mask, near) > 0 for mask in masks])


def displayed(linear_e: Float32Array, matrix: FloatArray) -> Float32Array:
    """Display values of linear colours, sRGB 0..1, with automatic exposure."""
    return to_srgb(linear_e, matrix, exposure_scale(linear_e, matrix))


def blocks_any(mask: NDArray) -> NDArray:
    """2x2 blocks [h/2, w/2] with any pixel of a mask [h, w]."""
    return mask[::2, ::2] | mask[1::2, ::2] | mask[::2, 1::2] | mask[1::2, 1::2]
