"""Development of a raw mosaic into a colour picture (sec. 4, Fig. 4): linear colours without infrared, and sRGB."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from dasim.base.errors import InputError
from dasim.camera import noise
from dasim.camera.specification import Camera
from dasim.spectra import illuminants
from dasim.spectra.colour import exposure_scale, to_srgb
from dasim.typing import BoolArray, Float32Array, Progress
from dasim.values import Capture, Developed
from recon.picture import colour, denoise, field, infrared, mosaic, shading
from recon.settings import DEFAULT, Settings
from recon.stages import Stage, stages

MIN_FRAME_PX = 32
STRIP_PX = 256  # rows from which infrared is removed at a time: limits the memory of large frames
CLIPPED_NEAR_PX = 5  # side of the square in which a saturated pixel affects interpolated values
LIGHTS = ("D65", "D55", "A", "energy-saving-3500K")  # of sec. 5.1, for white balance without a bank
STAGES = ("linearise", "light", "denoise", "infrared", "demosaic", "colour")


@dataclass(frozen=True)
class Linear:
    """A linear mosaic with its light, saturation and lens shading."""

    raw_e: Float32Array  # [h, w] electrons
    saturated: BoolArray  # [h, w]
    light: int  # index of the light, by white balance
    gain: Float32Array | None  # [h, w] factor that corrects the lens shading; None without a flat


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

    Args:
        capture: the raw picture.
        settings: of noise reduction and infrared removal.
        lights: names of one or more illuminants (:func:`dasim.illuminant_names` lists them) among which white balance
            chooses; the colour of white in each follows from the camera's response curves. InputError for an unknown
            name.
        flat: a capture of a uniform surface, for the correction of the lens shading.
        progress: called before each stage with its name and the share of stages completed, 0..1.
    """
    camera = capture.camera
    timings: dict[str, float] = {}
    stage = stages(STAGES, timings, progress)
    if not lights:
        raise InputError("lights: is empty; give the names of one light or more, such as 'D65'")
    for name in lights:
        illuminants.illuminant(name)  # raises for an unknown name
    signature = colour.signatures(camera, lights)
    linear = linearised(capture, lights, signature, flat, stage)
    with stage("denoise"):
        clean_e = shaded(denoised(linear.raw_e, capture, settings), linear.gain)
    image = demosaiced(clean_e, camera, signature[linear.light], stage)
    light = lights[linear.light]
    with stage("colour"):
        separation = field.separation(camera, light, settings)
        linear_e = without_infrared(image, separation, clipped(linear.saturated, camera), signature[linear.light])
        matrix = colour.colour_matrix(camera, light, separation.on_axis)
        rgb = to_srgb(linear_e, matrix, exposure_scale(linear_e, matrix))
    if progress:
        progress("done", 1.0)
    ir_e = None if image.ir_e is None else np.maximum(field.infrared_as_on_axis(image.ir_e, separation), 0)
    return Developed(rgb, linear_e, ir_e, matrix, camera, light, settings.model_dump(), timings)


def linearised(
    capture: Capture, lights: Sequence[str], signature: NDArray, flat: Capture | None, stage: Stage
) -> Linear:
    """The linear mosaic of a capture, with its light by white balance.

    ``signature`` [light, channel] is electrons of a white point under each light; for ``flat`` see :func:`develop`.
    """
    camera = capture.camera
    height, width = capture.raw_dn.shape
    if min(height, width) < MIN_FRAME_PX:
        raise InputError(
            f"capture: {width} x {height} pixels are too few; it must have at least {MIN_FRAME_PX} x {MIN_FRAME_PX}"
        )
    with stage("linearise"):
        raw_e, saturated = mosaic.linearise(capture)
        gain = None if flat is None else shading.gain(flat, camera, lights, signature)
    with stage("light"):
        light = colour.choose_light(raw_e, saturated, camera, lights, signature)
    return Linear(raw_e, saturated, light, gain)


def denoised(
    raw_e: Float32Array, capture: Capture, settings: Settings, collected_e: Float32Array | None = None
) -> Float32Array:
    """Noise reduction of sec. 4.1 on each grid of a mosaic [h, w] electrons; unchanged if the settings turn it off.

    The guide is the electrons before the correction of pixel crosstalk, to which the sensor's noise model applies:
    ``collected_e``, by default computed by :func:`recon.picture.mosaic.collected`. The two grids of a quincunx (green
    of a Bayer block, three channels of the 4x4 block) are denoised separately.
    """
    if not settings.denoise:
        return raw_e
    camera = capture.camera
    clean, collected = np.empty_like(raw_e), mosaic.collected(raw_e, camera) if collected_e is None else collected_e
    variance = noise.variance(camera.sensor, capture.exposure_s, capture.gain)
    for channel_grids in mosaic.grids(camera).values():
        for row, column, step in channel_grids:
            plane = np.ascontiguousarray(raw_e[row::step, column::step])
            guide = denoise.stabilise(collected[row::step, column::step], variance)
            clean[row::step, column::step] = denoise.nonlocal_means(
                plane, guide, settings.denoise_bandwidth, settings.denoise_patch_sigma_px
            )
    return clean


def shaded(mosaic_e: Float32Array, gain: Float32Array | None) -> Float32Array:
    """A mosaic [h, w] with the lens shading corrected.

    Deviation from Fig. 4: the correction follows noise reduction. The gain varies slowly, so the two commute, and the
    sensor's noise model remains valid.
    """
    return mosaic_e if gain is None else mosaic_e * gain


def shaded_variances(
    variances: dict[str, Float32Array], gain: Float32Array | None, camera: Camera
) -> dict[str, Float32Array]:
    """Noise variances of the planes, [h/2, w/2] each, of the mosaic that :func:`shaded` gives."""
    if gain is None:
        return variances
    factors = mosaic.planes(gain, camera)
    return {name: (variance * factors[name] ** 2).astype(np.float32) for name, variance in variances.items()}


def demosaiced(mosaic_e: Float32Array, camera: Camera, white: NDArray, stage: Stage) -> Demosaiced:
    """Infrared and colours at full resolution (sec. 4.2-4.3), from a mosaic [h, w] in electrons.

    ``white`` [channel] is electrons of a white point under the light.
    """
    with stage("infrared"):
        planes = mosaic.planes(mosaic_e, camera)
        ir_e = infrared.interpolate(planes["IR"], mosaic.phases(camera)["IR"]) if "IR" in planes else None
    with stage("demosaic"):
        bayer = mosaic.to_bayer(mosaic_e, ir_e, camera, white)
        full_e = mosaic.demosaic(bayer, camera, white)
    return Demosaiced(full_e, ir_e)


def without_infrared(image: Demosaiced, separation: field.Separation, clipped: NDArray, white: NDArray) -> Float32Array:
    """Removal of infrared (sec. 4.4) at full resolution, [h, w, 3]; ``clipped`` [h, w, 3] marks saturated values.

    Saturated values are lower bounds. They are raised to the level of the brightest channel, relative to ``white``
    [channel], so that a highlight is white instead of pink. Deviation: the paper does not treat highlights.
    """
    on_axis = separation.on_axis
    neutral = (on_axis @ white[: on_axis.shape[1]]).astype(np.float32)
    result = np.empty(image.full_e.shape, np.float32)
    for top in range(0, len(result), STRIP_PX):
        rows = slice(top, top + STRIP_PX)
        strip = image.full_e[rows]
        if image.ir_e is not None:
            strip = np.dstack([strip, np.maximum(image.ir_e[rows], 0)])
        clean = field.separate(strip, separation._replace(place=separation.place[rows]))
        if clipped[rows].any():
            level = (clean / neutral).max(axis=-1, keepdims=True)
            clean = np.where(clipped[rows], np.maximum(clean, level * neutral), clean)
        result[rows] = clean
    return result


def clipped(saturated: NDArray, camera: Camera) -> BoolArray:
    """Mask of values of R, G and B that are interpolated from a saturated pixel, [h, w, 3]."""
    grids = mosaic.grids(camera)
    near = np.ones((CLIPPED_NEAR_PX, CLIPPED_NEAR_PX), np.uint8)
    masks = [(saturated & mosaic.sites(grids[name], saturated.shape)).astype(np.uint8) for name in "RGB"]
    return np.dstack([cv2.dilate(mask, near) > 0 for mask in masks])
