"""From a raw picture to colour, depth and an all-in-focus picture: Fig. 4 and section 5, one line a stage."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, nullcontext

import cv2
import numpy as np
from numpy.typing import NDArray

from dasim.camera.specification import Camera
from dasim.files.banks import bank_identity
from dasim.spectra.colour import exposure_scale, to_srgb
from dasim.spectra.grid import CHANNELS
from dasim.typing import Float32Array, Progress
from dasim.values import Capture, Developed, PsfBank, Reconstruction
from recon import levels
from recon.calibration.fit import check_fits
from recon.depth import raw_levels
from recon.depth.method import Method, applied, method_name, on_blocks
from recon.depth.regularise import regularise
from recon.picture import colour, denoise, infrared, mosaic
from recon.picture import develop as picture
from recon.settings import DEFAULT, PAPER, Settings
from recon.sharp import sharpen

PICTURE_STAGES = ("linearise", "light", "denoise", "infrared", "demosaic", "colour")
STAGES = (*PICTURE_STAGES[:-1], "depth", "regularise", "sharpen", "colour")
LIGHTS = ("D65", "D55", "A", "energy-saving-3500K")  # sec. 5.1, that white balance chooses from without a bank
FAR_LIGHT = 1.0  # in log-chromaticity: D65 and A are 1.46 apart, photographs within 0.5 of their own light
INTERPOLATED_NOISE_SHARE = 0.7  # of the sensor's noise that interpolation leaves, standard deviation
GRAINY_LEVEL = 3.0  # from here on, deconvolution starts from the picture before noise reduction alone
CERTAIN = 0.05  # confidence below which the picture fades to that captured: there the level is a guess


def reconstruct(
    capture: Capture,
    bank: PsfBank,
    settings: Settings = DEFAULT,
    *,
    method: Method | None = None,
    flat: Capture | None = None,
    progress: Progress | None = None,
) -> Reconstruction:
    """Everything the paper makes of one capture: picture, depth, all-in-focus picture.

    With a ``method``, such as one of ``METHODS`` or your own, its estimate replaces the raw levels: regularisation
    fills its gaps, and its standard deviation gives the confidence. By default ``settings.score`` chooses the method.
    ``flat`` is a capture of an even surface, from which the lens shading is undone in the pictures.
    ``progress`` is called with a stage's name and the share of stages done before it. Raises InputError where
    capture and bank do not belong together, or where the mosaic has no infrared.
    """
    check_fits(bank, capture)
    camera = capture.camera
    timings: dict[str, float] = {}

    stage = _stages(STAGES, timings, progress)
    image = picture.demosaiced(capture, bank.signature, settings, flat, stage)
    light, saturated = image.light, image.saturated
    assert image.ir_e is not None  # checked above
    variances = raw_levels.variances(image.raw_e, capture)
    outside = 0.0
    with stage("depth"):
        if method is None:
            raw_level, trust = raw_levels.raw_levels(
                image.raw_e, variances, saturated, camera, bank.kernel[light], settings, bank.signature[light]
            )
        else:
            raw_level, trust, outside = on_blocks(applied(method, capture, bank), bank)
    with stage("regularise"):
        guide = _infrared_guide(image.ir_e, capture)
        smooth, evidence = regularise(raw_level, trust, guide, settings.regularise_bandwidth)
        level = _upsampled(smooth, camera.sensor.height_px, camera.sensor.width_px)
        confidence = _upsampled(evidence, *level.shape)
    notes = _notes(image.raw_e, saturated, camera, bank) + _range_notes(outside, method, bank)
    separation = infrared.separation(camera, bank.lights[light], settings)
    clipped, white = picture.clipped(saturated, camera), bank.signature[light]
    linear_e = picture.without_infrared(image.full_e, image.ir_e, separation, clipped, white)
    ir_e = np.maximum(image.ir_e, 0)
    noise_e = sharpen.visible_noise(_noise_e(variances), separation)
    del image, variances, guide  # of large frames every plane counts
    with stage("sharpen"):
        kernels = sharpen.visible_kernels(bank.kernel[light], white, separation)
        stack = _grainy(capture, bank, settings, flat)
        grain = np.clip(level / GRAINY_LEVEL, 0, 1)  # in focus, noise reduction does better than the prior
        for index, smooth_e in enumerate((*np.moveaxis(linear_e, -1, 0), ir_e)):
            stack[index] = smooth_e + grain * (stack[index] - smooth_e)
        sharp_e = sharpen.sharpen(stack, level, kernels, noise_e, settings, mosaic.sole_phases(camera))
        del stack
        certain = np.clip(confidence / CERTAIN, 0, 1) * sharpen.away_from(
            clipped[..., 0] | clipped[..., 1] | clipped[..., 2]
        )
        sharp_e -= linear_e
        sharp_e *= certain[..., None]
        sharp_e += linear_e  # where the level is a guess, as captured
    with stage("colour"):
        matrix = colour.colour_matrix(camera, bank.lights[light], separation)
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
        level_raw=raw_level.repeat(2, axis=0).repeat(2, axis=1),
        level=level,
        depth_m=levels.depth_of(level, bank.depth_m),
        confidence=confidence,
        camera=camera,
        light=bank.lights[light],
        settings=settings.model_dump(),
        timings_s=timings,
        bank=bank_identity(bank),
        notes=notes,
        method=None if method is None else method_name(method),
    )


def develop(
    capture: Capture,
    settings: Settings = PAPER,
    *,
    lights: Sequence[str] = LIGHTS,
    flat: Capture | None = None,
    progress: Progress | None = None,
) -> Developed:
    """The colour picture alone (sec. 4), of any mosaic that is known, without a PSF bank.

    White balance chooses among ``lights`` by the camera's response curves.
    """
    camera = capture.camera
    timings: dict[str, float] = {}
    stage = _stages(PICTURE_STAGES, timings, progress)
    signature = colour.signatures(camera, lights)
    image = picture.demosaiced(capture, signature, settings, flat, stage)
    light = lights[image.light]
    with stage("colour"):
        separation = infrared.separation(camera, light, settings)
        clipped = picture.clipped(image.saturated, camera)
        linear_e = picture.without_infrared(image.full_e, image.ir_e, separation, clipped, signature[image.light])
        matrix = colour.colour_matrix(camera, light, separation)
        rgb = picture.displayed(linear_e, matrix)
    if progress:
        progress("done", 1.0)
    ir_e = None if image.ir_e is None else np.maximum(image.ir_e, 0)
    return Developed(rgb, linear_e, ir_e, matrix, camera, light, settings.model_dump(), timings)


def _stages(names: Sequence[str], timings: dict[str, float], progress: Progress | None) -> picture.Stage:
    """Blocks that say their name and take their time."""

    @contextmanager
    def stage(name: str) -> Iterator[None]:
        if progress:
            progress(name, names.index(name) / len(names))
        start = time.perf_counter()
        yield
        timings[name] = time.perf_counter() - start

    return stage


def _notes(raw_e: Float32Array, saturated: NDArray, camera: Camera, bank: PsfBank) -> tuple[str, ...]:
    """What speaks against the bank's lights: the picture's white lies far from all of them, or cannot be told."""
    distance = colour.light_distances(mosaic.planes(raw_e, camera), picture.blocks_any(saturated), bank.signature)
    if distance is None:
        return (f"the picture is too dark or too bright to tell its light; {bank.lights[0]} is taken",)
    nearest = int(distance.argmin())
    if distance[nearest] < FAR_LIGHT:
        return ()
    return (
        f"the picture's white lies far from every light of the bank ({', '.join(bank.lights)}), the nearest is "
        f"{bank.lights[nearest]}; if it was taken under another light, add that with 'dasim calibrate --illuminant'",
    )


def _range_notes(outside: float, method: Method | None, bank: PsfBank) -> tuple[str, ...]:
    """What a user should know of estimates that lie where the bank has no kernels."""
    if method is None or not outside:
        return ()
    return (
        f"{outside:.1%} of the estimates of method '{method_name(method)}' lie outside the bank's "
        f"{bank.depth_m.min():.4g} to {bank.depth_m.max():.4g} m and count as its ends",
    )


def _infrared_guide(ir_e: Float32Array, capture: Capture) -> Float32Array:
    """Infrared at the blocks' centres in units of its noise, the guide of eq. (14)."""
    size = (ir_e.shape[1] // 2, ir_e.shape[0] // 2)
    blocks = np.asarray(cv2.resize(ir_e, size, interpolation=cv2.INTER_AREA), np.float32)
    return denoise.stabilise(blocks, mosaic.noise_variance(capture))


def _grainy(capture: Capture, bank: PsfBank, settings: Settings, flat: Capture | None) -> Float32Array:
    """R, G, B without infrared, and infrared, [4, h, w], from the raw picture without noise reduction.

    Deviation from Fig. 4: deconvolution has its own prior against noise, and misses the texture that nonlocal means
    take with it (+0.1 to 0.6 dB on the bundled scenes).
    """
    image = picture.demosaiced(
        capture, bank.signature, settings.model_copy(update={"denoise": False}), flat, lambda name: nullcontext()
    )
    separation = infrared.separation(capture.camera, bank.lights[image.light], settings)
    clipped, white = picture.clipped(image.saturated, capture.camera), bank.signature[image.light]
    assert image.ir_e is not None
    visible = picture.without_infrared(image.full_e, image.ir_e, separation, clipped, white)
    return np.concatenate([np.moveaxis(visible, -1, 0), image.ir_e[None]])


def _noise_e(variances: dict[str, Float32Array]) -> NDArray:
    """Standard deviation of the noise of R, G, B and IR in the full picture, its mean over the frame."""
    return INTERPOLATED_NOISE_SHARE * np.sqrt([variances[name].mean() for name in CHANNELS])


def _upsampled(blocks: Float32Array, height: int, width: int) -> Float32Array:
    """From blocks to pixels, linear between the blocks' centres."""
    return np.asarray(cv2.resize(blocks, (width, height), interpolation=cv2.INTER_LINEAR), np.float32)
