"""The reconstruction pipeline of Fig. 4 and sec. 5: colour, depth and an all-in-focus picture from a raw picture."""

from __future__ import annotations

from contextlib import nullcontext

import cv2
import numpy as np
from numpy.typing import NDArray

from dasim.camera.noise import Variance
from dasim.camera.specification import Camera
from dasim.files.banks import bank_identity
from dasim.spectra.colour import exposure_scale, to_srgb
from dasim.spectra.grid import CHANNELS
from dasim.typing import Float32Array, Progress
from dasim.values import Capture, PsfBank, Reconstruction
from recon import levels
from recon.calibration.fit import check_fits
from recon.depth import raw_levels
from recon.depth.method import Method, method_name, on_blocks, run_method
from recon.depth.regularise import regularise
from recon.picture import colour, denoise, field, mosaic
from recon.picture import develop as picture
from recon.settings import DEFAULT, Settings
from recon.sharp import sharpen
from recon.stages import stages

STAGES = (*picture.STAGES[:-1], "depth", "regularise", "sharpen", "colour")
INTERPOLATED_NOISE_SHARE = 0.7  # noise after interpolation relative to the sensor's, standard deviations
GRAINY_LEVEL = 3.0  # level from which on deconvolution uses the picture without noise reduction alone
CERTAIN = 0.05  # confidence below which the all-in-focus picture fades to the captured one


def reconstruct(
    capture: Capture,
    bank: PsfBank,
    settings: Settings = DEFAULT,
    *,
    method: Method | None = None,
    flat: Capture | None = None,
    progress: Progress | None = None,
) -> Reconstruction:
    """Reconstruct colour, depth and an all-in-focus picture from one capture.

    Raises InputError if the bank does not match the capture, or if the mosaic has no infrared pixels.

    Args:
        capture: the raw picture.
        bank: point-spread functions of the same camera at the same focus.
        settings: by default the preset ``DEFAULT_PRESET``.
        method: a depth method, one of ``METHODS`` or your own, whose estimate replaces the raw levels. Regularisation
            fills its gaps, and its standard deviation gives the confidence. By default, ``settings.score`` selects it.
        flat: a capture of a uniform surface, for the correction of the lens shading in the pictures.
        progress: called with the name of each stage and the share of stages before it, 0..1.
    """
    check_fits(bank, capture)
    camera = capture.camera
    timings: dict[str, float] = {}
    stage = stages(STAGES, timings, progress)
    linear = picture.linearised(capture, bank.lights, bank.signature, flat, stage)
    kernels, white, light = bank.kernel[linear.light], bank.signature[linear.light], bank.lights[linear.light]
    with stage("denoise"):
        clean_e = picture.shaded(picture.denoised(linear.raw_e, capture, settings), linear.gain)
    image = picture.demosaiced(clean_e, camera, white, stage)
    separation = field.separation(camera, light, settings)
    clipped = picture.clipped(linear.saturated, camera)
    linear_e, ir_e = picture.without_infrared(image, separation, clipped, white), image.ir_e
    assert ir_e is not None  # check_fits requires infrared pixels
    del image, clean_e  # limits the memory of large frames
    variances = raw_levels.variances(linear.raw_e, capture)
    notes = colour.light_notes(linear.raw_e, linear.saturated, camera, bank)
    with stage("depth"):
        if method is None:
            raw, trust = raw_levels.raw_levels(
                linear.raw_e, variances, linear.saturated, camera, kernels, settings, white
            )
        else:
            raw, trust, outside = on_blocks(run_method(method, capture, bank), bank)
            notes += _range_notes(outside, method_name(method), bank)
    with stage("regularise"):
        guide = _infrared_guide(ir_e, mosaic.noise_variance(capture))
        smooth = regularise(raw, trust, guide, settings.regularise_bandwidth)
        level, confidence = (_upsampled(blocks, ir_e.shape) for blocks in smooth)
    ir_e = np.maximum(field.infrared_as_on_axis(ir_e, separation), 0)
    noise_e = sharpen.visible_noise(_noise_e(variances), separation.on_axis)
    del variances, guide, smooth
    visible_kernels = sharpen.visible_kernels(kernels, white, separation.on_axis)
    with stage("sharpen"):
        stack = _grainy(picture.shaded(linear.raw_e, linear.gain), camera, white, separation, clipped)
        del linear
        _soften_in_focus(stack, linear_e, ir_e, level)
        sharp_e = sharpen.sharpen(
            stack, level, visible_kernels, noise_e, mosaic.sole_phases(camera),
            steps=settings.sharpen_steps, strength=settings.sharpen_strength, guided=settings.sharpen_guide,
        )  # fmt: skip
        del stack
        _fade_to_captured(sharp_e, linear_e, confidence, clipped)
    with stage("colour"):
        matrix = colour.colour_matrix(camera, light, separation.on_axis)
        scale = exposure_scale(linear_e, matrix)
        rgb, sharp_rgb = to_srgb(linear_e, matrix, scale), to_srgb(sharp_e, matrix, scale)
    if progress:
        progress("done", 1.0)
    return Reconstruction(
        rgb=rgb,
        sharp_rgb=sharp_rgb,
        linear_e=linear_e,
        sharp_e=sharp_e,
        ir_e=ir_e,
        level_raw=raw.repeat(2, axis=0).repeat(2, axis=1),
        level=level,
        depth_m=levels.depth_of(level, bank.depth_m),
        confidence=confidence,
        camera=camera,
        light=light,
        settings=settings.model_dump(),
        timings_s=timings,
        bank=bank_identity(bank),
        notes=notes,
        method=None if method is None else method_name(method),
    )


def _range_notes(outside: float, name: str, bank: PsfBank) -> tuple[str, ...]:
    """A note on estimates out of the bank's range, whose share is ``outside``; none for 0."""
    if not outside:
        return ()
    return (
        f"{outside:.1%} of the estimates of method '{name}' are outside the bank's range of "
        f"{bank.depth_m.min():.4g} to {bank.depth_m.max():.4g} m and are clamped to it",
    )


def _infrared_guide(ir_e: Float32Array, noise: Variance) -> Float32Array:
    """Infrared on the 2x2 blocks in units of its noise, [h/2, w/2]: the guide of eq. (14)."""
    size = (ir_e.shape[1] // 2, ir_e.shape[0] // 2)
    blocks = np.asarray(cv2.resize(ir_e, size, interpolation=cv2.INTER_AREA), np.float32)
    return denoise.stabilise(blocks, noise)


def _upsampled(blocks: Float32Array, shape: tuple[int, ...]) -> Float32Array:
    """A map of the 2x2 blocks at every pixel, [h, w], by linear interpolation between their centres."""
    return np.asarray(cv2.resize(blocks, (shape[1], shape[0]), interpolation=cv2.INTER_LINEAR), np.float32)


def _noise_e(variances: dict[str, Float32Array]) -> NDArray:
    """Standard deviation of the noise of R, G, B and IR after interpolation, frame mean, [channel] electrons."""
    return INTERPOLATED_NOISE_SHARE * np.sqrt([variances[name].mean() for name in CHANNELS])


def _grainy(
    mosaic_e: Float32Array, camera: Camera, white: NDArray, separation: field.Separation, clipped: NDArray
) -> Float32Array:
    """R, G, B without infrared, and infrared, from the mosaic without noise reduction, [4, h, w] electrons.

    Deviation from Fig. 4: the deconvolution has a prior against noise of its own, and benefits from the texture that
    nonlocal means remove with the noise (0.1 to 0.6 dB on the bundled scenes).
    """
    image = picture.demosaiced(mosaic_e, camera, white, lambda name: nullcontext())
    assert image.ir_e is not None
    visible = picture.without_infrared(image, separation, clipped, white)
    return np.concatenate([np.moveaxis(visible, -1, 0), field.infrared_as_on_axis(image.ir_e, separation)[None]])


def _soften_in_focus(stack: Float32Array, linear_e: Float32Array, ir_e: Float32Array, level: Float32Array) -> None:
    """Blend the picture without noise reduction, [4, h, w], with the denoised one near focus, in place.

    In focus, noise reduction gives smaller errors than the prior of the deconvolution. The weight of the denoised
    picture is 1 at level 0 and 0 from ``GRAINY_LEVEL`` on.
    """
    grain = np.clip(level / GRAINY_LEVEL, 0, 1)
    for index, smooth_e in enumerate((*np.moveaxis(linear_e, -1, 0), ir_e)):
        stack[index] = smooth_e + grain * (stack[index] - smooth_e)


def _fade_to_captured(
    sharp_e: Float32Array, linear_e: Float32Array, confidence: Float32Array, clipped: NDArray
) -> None:
    """Fade the sharp picture [h, w, 3] to the captured one at low confidence and near clipped pixels, in place."""
    certain = np.clip(confidence / CERTAIN, 0, 1) * sharpen.ramp_around(
        clipped[..., 0] | clipped[..., 1] | clipped[..., 2]
    )
    sharp_e -= linear_e
    sharp_e *= certain[..., None]
    sharp_e += linear_e
