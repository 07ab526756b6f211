"""The reconstruction pipeline of Fig. 4 and sec. 5: colour, depth and an all-in-focus picture from a raw picture."""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from dasim.base.errors import InputError
from dasim.camera.noise import Variance
from dasim.files.banks import bank_identity
from dasim.spectra.colour import exposure_scale, to_srgb
from dasim.typing import Float32Array, FloatArray, Progress
from dasim.values import Capture, PsfBank, Reconstruction, Side
from recon import levels
from recon.calibration.fit import check_fits, place_notes
from recon.depth import raw_levels, steps, upsampling
from recon.depth.method import Method, method_name, on_blocks, run_method
from recon.depth.peak import confidence_of
from recon.depth.regularise import regularise
from recon.depth.side import side_note
from recon.depth.upsampling import Levels
from recon.picture import colour, denoise, field, mosaic
from recon.picture import develop as picture
from recon.picture.field import Separation
from recon.settings import DEFAULT, Settings
from recon.sharp import all_in_focus
from recon.stages import Stage, stages

LEAST_TILE_PX = 64
STAGES = (*picture.STAGES[:-1], "depth", "regularise", "sharpen", "colour")


def reconstruct(
    capture: Capture,
    bank: PsfBank,
    settings: Settings = DEFAULT,
    *,
    method: Method | None = None,
    flat: Capture | None = None,
    progress: Progress | None = None,
    tile_px: int | None = None,
) -> Reconstruction:
    """Reconstruct colour, depth and an all-in-focus picture, at the size of ``capture.raw_dn``, from one capture.

    Raises InputError if the bank does not match the capture, or if the mosaic has no infrared pixels.

    Args:
        capture: the raw picture.
        bank: point-spread functions of the same camera at the same focus.
        settings: those of a preset, such as ``recon.PRESETS["paper"]``; by default ``recon.DEFAULT``, the preset
            ``best``.
        method: a depth method, one of ``METHODS`` or your own, whose estimate replaces the raw levels. Regularisation
            fills its gaps, and its standard deviation gives the confidence. By default, ``settings.score`` selects it.
        flat: a capture of a uniform surface, for the correction of the lens shading in the pictures.
        progress: called with the name of each stage and the share of stages before it, 0..1.
        tile_px: largest side of a tile in raw pixels, 64 or more (the deconvolution uses at least 96). By
            default, each stage has its own.
            With the score ``joint`` (presets ``best`` and ``fast``) it affects time and memory, but hardly the result
            (claim ``recon-large``); with other scores small tiles change levels near their borders.
    """
    check_fits(bank, capture)
    if tile_px is not None and tile_px < LEAST_TILE_PX:
        raise InputError(f"tiles of {tile_px} px are too small; allowed are {LEAST_TILE_PX} px and more")
    camera = capture.camera
    timings: dict[str, float] = {}
    stage = stages(STAGES, timings, progress)
    on_axis = field.with_infrared_of_axis(bank)
    linear = picture.linearised(capture, bank.lights, bank.signature, flat, stage)
    white, light = bank.signature[linear.light], bank.lights[linear.light]
    separation = field.separation(camera, light, settings)
    collected_e = mosaic.collected(linear.raw_e, camera)
    variances = raw_levels.variances(linear.raw_e, capture, collected_e)
    captured = _captured(linear, capture, collected_e, white, separation, settings, stage)
    del collected_e  # limits the memory of large frames
    notes = (
        *place_notes(bank, camera),
        *mosaic.saturation_notes(linear.saturated),
        *colour.light_notes(linear.raw_e, linear.saturated, camera, bank),
    )
    with stage("depth"):
        found = _levels(capture, bank if method else on_axis, linear, variances, settings, method, tile_px)
    if bank.behind is None:  # levels behind the focus were clamped to it
        found = found._replace(side="assumed")
    with stage("regularise"):
        if not found.joined:
            guide = _infrared_guide(captured.ir_e, mosaic.noise_variance(capture, "IR"))
            smooth = regularise(found.level, found.confidence, guide, settings.regularise_bandwidth)
            found = found._replace(level=smooth[0], confidence=smooth[1])
        blocks = Levels(found.level, found.confidence)
        pixels = upsampling.interpolated(blocks, captured.ir_e.shape)
    captured = captured._replace(ir_e=np.maximum(field.infrared_as_on_axis(captured.ir_e, separation), 0))
    with stage("sharpen"):
        frame = all_in_focus.Frame(
            picture.shaded(linear.raw_e, linear.gain), captured.linear_e, captured.ir_e, captured.clipped,
            picture.shaded_variances(variances, linear.gain, camera), *pixels, separation, camera, white,
        )  # fmt: skip
        del linear, variances  # limits the memory of large frames
        sharp_e = all_in_focus.all_in_focus(frame, on_axis, light, settings, tile_px)
        del frame
        # After sharpening, which is better with levels that change gradually: a wrong side costs more than a ramp.
        if found.align_steps:
            blocks = steps.aligned(blocks, sharp_e, captured.ir_e)
            pixels = upsampling.interpolated(blocks, captured.ir_e.shape)
        upsampling.take_sides(pixels, blocks, sharp_e, captured.ir_e)
        level, confidence = pixels
    with stage("colour"):
        rgb, sharp_rgb = _coloured(captured.linear_e, sharp_e, colour.colour_matrix(camera, light, separation.on_axis))
    if progress:
        progress("done", 1.0)
    return Reconstruction(
        rgb=rgb,
        sharp_rgb=sharp_rgb,
        linear_e=captured.linear_e,
        sharp_e=sharp_e,
        ir_e=captured.ir_e,
        level_raw=found.raw.repeat(2, axis=0).repeat(2, axis=1),
        level=level,
        depth_m=levels.depth_of(level, bank.depth_m, None if bank.behind is None else bank.behind.depth_m),
        confidence=confidence,
        camera=camera,
        light=light,
        settings=settings.model_dump(),
        timings_s=timings,
        bank=bank_identity(bank),
        notes=(
            *notes,
            *found.notes,
            side_note(found.side, level, bank, None if method is None else method_name(method)),
        ),
        method=None if method is None else method_name(method),
        side=found.side,
    )


class _Captured(NamedTuple):
    """The captured picture after section 4, electrons."""

    linear_e: Float32Array  # [h, w, 3] without infrared
    ir_e: Float32Array  # [h, w]
    clipped: NDArray  # [h, w, 3] pixels near saturation


def _captured(
    linear: picture.Linear,
    capture: Capture,
    collected_e: Float32Array,
    white: NDArray,
    separation: Separation,
    settings: Settings,
    stage: Stage,
) -> _Captured:
    """Reduce the noise of the mosaic, interpolate it, and remove infrared from R, G and B."""
    with stage("denoise"):
        clean_e = picture.shaded(picture.denoised(linear.raw_e, capture, settings, collected_e), linear.gain)
    image = picture.demosaiced(clean_e, capture.camera, white, stage)
    clipped = picture.clipped(linear.saturated, capture.camera)
    assert image.ir_e is not None  # check_fits requires infrared pixels
    return _Captured(picture.without_infrared(image, separation, clipped, white), image.ir_e, clipped)


class _Levels(NamedTuple):
    """Levels of the 2x2 blocks, [h/2, w/2]."""

    raw: Float32Array  # NaN without an estimate
    level: Float32Array
    confidence: Float32Array  # of ``level``
    joined: bool  # whether ``level`` is already regularised and has no gaps
    align_steps: bool  # whether its discontinuities are to be moved to edges of the all-in-focus picture
    side: Side = "assumed"
    notes: tuple[str, ...] = ()


def _levels(
    capture: Capture,
    bank: PsfBank,
    linear: picture.Linear,
    variances: dict[str, Float32Array],
    settings: Settings,
    method: Method | None,
    tile_px: int | None,
) -> _Levels:
    """Levels by ``method``, or, if it is None, by the score of the settings, in tiles."""
    if method is not None:
        estimate = run_method(method, capture, bank)
        raw, trust, outside = on_blocks(estimate, bank)
        joined = estimate.joined and bool(np.isfinite(raw).all())
        notes = _range_notes(outside, method_name(method), bank, estimate.side)
        return _Levels(raw, raw, trust, joined, estimate.align_steps, estimate.side, notes)
    kernels, white = bank.kernel[linear.light], bank.signature[linear.light]
    frame = raw_levels.Frame(linear.raw_e, variances, linear.saturated, capture.camera, kernels, white)
    if settings.score == "joint":
        behind = None if bank.behind is None else bank.behind.kernel[linear.light]
        found = raw_levels.joint_levels(frame, settings, behind, tile_px)
        known = confidence_of(found.window_sd) >= settings.least_confidence
        raw = np.where(known, found.window_level, np.float32(np.nan))
        # In double precision and rounded once, as the estimate of a method is.
        trust = confidence_of(found.sd.astype(np.float64)).astype(np.float32)
        side: Side = "assumed" if behind is None else "estimated"
        return _Levels(raw, found.level, trust, True, settings.windows == "all", side)
    raw, trust = raw_levels.raw_levels(frame, settings, tile_px)
    return _Levels(raw, raw, trust, joined=False, align_steps=False)


def _range_notes(outside: float, name: str, bank: PsfBank, side: Side) -> tuple[str, ...]:
    """A note on estimates out of the bank's range, whose share is ``outside``; none for 0."""
    if not outside:
        return ()
    farthest = bank.behind if bank.behind and side == "estimated" else bank
    return (
        f"{outside:.1%} of the estimates of method '{name}' are outside the bank's range of "
        f"{bank.depth_m.min():.4g} to {farthest.depth_m.max():.4g} m and are clamped to it",
    )


def _infrared_guide(ir_e: Float32Array, noise: Variance) -> Float32Array:
    """Infrared on the 2x2 blocks in units of its noise, about, [h/2, w/2]: the guide of eq. (14)."""
    size = (ir_e.shape[1] // 2, ir_e.shape[0] // 2)
    blocks = np.asarray(cv2.resize(ir_e, size, interpolation=cv2.INTER_AREA), np.float32)
    return denoise.stabilise(blocks, noise)


def _coloured(linear_e: Float32Array, sharp_e: Float32Array, matrix: FloatArray) -> tuple[Float32Array, Float32Array]:
    """The captured and the all-in-focus picture [h, w, 3] in sRGB 0..1, exposed alike."""
    scale = exposure_scale(linear_e, matrix)
    return to_srgb(linear_e, matrix, scale), to_srgb(sharp_e, matrix, scale)
