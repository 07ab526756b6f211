"""The colour picture of a raw mosaic (sec. 4, Fig. 4): linear colours without infrared, and sRGB."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from dasim.colour import exposure_scale, to_srgb
from dasim.errors import InputError
from dasim.values import Capture
from recon import colour, denoise, infrared, mosaic, shading
from recon.settings import Settings

Float32Array = NDArray[np.float32]
FloatArray = NDArray[np.float64]
Stage = Callable[[str], AbstractContextManager[None]]

MIN_FRAME_PX = 32


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
    coefficients = mosaic.noise_coefficients(capture)
    for own in mosaic.grids(capture.camera).values():
        for row, column, step in own:
            plane = np.ascontiguousarray(raw_e[row::step, column::step])
            guide = denoise.stabilise(plane, coefficients)
            clean[row::step, column::step] = denoise.nonlocal_means(
                plane, guide, settings.denoise_bandwidth, settings.denoise_patch_sigma_px
            )
    return clean


def without_infrared(
    full_e: Float32Array, ir_e: Float32Array | None, separation: FloatArray, saturated: NDArray
) -> Float32Array:
    """Sec. 4.4 at full resolution, [h, w, 3]; pixels that touch a ``saturated`` one stay as they are."""
    if ir_e is None:
        return np.maximum(full_e, 0)
    touched = cv2.dilate(saturated.astype(np.uint8), np.ones((3, 3), np.uint8)) > 0
    return infrared.separate(full_e, np.maximum(ir_e, 0), separation, touched)


def displayed(linear_e: Float32Array, matrix: FloatArray) -> Float32Array:
    """Display values of linear colours, sRGB 0..1, with automatic exposure."""
    return to_srgb(linear_e, matrix, exposure_scale(linear_e, matrix))


def blocks_any(mask: NDArray) -> NDArray:
    """2x2 blocks [h/2, w/2] with any pixel of a mask [h, w]."""
    return mask[::2, ::2] | mask[1::2, ::2] | mask[::2, 1::2] | mask[1::2, 1::2]
