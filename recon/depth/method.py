"""Depth methods: functions from a capture and a PSF bank to a depth estimate, bundled or a user's own."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np

from dasim.base.errors import InputError
from dasim.base.loading import function_name
from dasim.typing import Float32Array
from dasim.values import Capture, DepthEstimate, PsfBank, Side
from recon import levels
from recon.calibration.fit import check_fits
from recon.depth.peak import REFERENCE_ERROR, confidence_of
from recon.depth.raw_levels import Frame, joint_levels, raw_levels, variances
from recon.picture import colour, field, mosaic
from recon.settings import PRESETS, Settings

Method = Callable[[Capture, PsfBank], DepthEstimate]

UNKNOWN_SD = REFERENCE_ERROR  # levels; for estimates without a standard deviation: a confidence of one half


def estimate(capture: Capture, bank: PsfBank, settings: Settings) -> DepthEstimate:
    """Raw levels of eq. (12) and their standard deviation, without regularisation, with the score of the settings.

    The score ``joint`` joins neighbours before a level is chosen: its levels are smooth already, and without gaps.

    White balance selects the light among those of the bank. Each 2x2 block of the mosaic has one value.
    """
    check_fits(bank, capture)
    bank = field.with_infrared_of_axis(bank)
    raw_e, saturated = mosaic.linearise(capture)
    light = colour.choose_light(raw_e, saturated, capture.camera, bank.lights, bank.signature)
    frame = Frame(
        raw_e, variances(raw_e, capture), saturated, capture.camera, bank.kernel[light], bank.signature[light]
    )
    if settings.score == "joint":
        behind = None if bank.behind is None else bank.behind.kernel[light]
        joined = joint_levels(frame, settings, behind)
        known = np.isfinite(joined.sd)
        level, sd = (_on_pixels(np.where(known, image, np.float32(np.nan))) for image in (joined.level, joined.sd))
        side: Side = "assumed" if behind is None else "estimated"
        return DepthEstimate(level=level, sd=sd, joined=True, align_steps=settings.windows == "all", side=side)
    level, confidence = raw_levels(frame, settings)
    known = np.isfinite(level)
    share = np.where(known, confidence, 1).astype(np.float64)
    sd = np.where(known, REFERENCE_ERROR * np.sqrt(1 / share - 1), np.nan)
    return DepthEstimate(level=_on_pixels(level), sd=_on_pixels(sd))


METHODS: dict[str, Method] = {name: partial(estimate, settings=settings) for name, settings in PRESETS.items()}


def method_name(method: Method) -> str:
    """Name of a bundled method in ``METHODS``; of any other, the module and the function."""
    return next((name for name, bundled in METHODS.items() if bundled is method), None) or function_name(method)


def run_method(method: Method, capture: Capture, bank: PsfBank) -> DepthEstimate:
    """The estimate of a method for a capture; InputError with the method's name where it is invalid."""
    label = f"method '{method_name(method)}'"
    try:
        result = method(capture, bank)
    except InputError as error:
        raise InputError(f"{label}: {error}") from None
    if not isinstance(result, DepthEstimate):
        raise InputError(f"{label}: returns {type(result).__name__}; it must be a recon.DepthEstimate")
    if result.shape != capture.raw_dn.shape:
        raise InputError(
            f"{label}: returns a map of shape {result.shape}, the raw frame has {capture.raw_dn.shape}; "
            "return one value per raw pixel, NaN where there is no estimate"
        )
    if not result.coverage:
        raise InputError(f"{label}: estimates nothing, all values are NaN; at least one pixel needs a value")
    return result


def on_blocks(estimate: DepthEstimate, bank: PsfBank) -> tuple[Float32Array, Float32Array, float]:
    """Levels of the mosaic's 2x2 blocks and their confidence, [h/2, w/2]; share of the estimates out of range, 0..1.

    A block's level is the mean of its pixels' estimates, NaN without any. Estimates out of range are clamped, because
    the bank has no kernels there. The range extends from the last level to the focus, or, if the method tells the sides
    apart, to the last level behind the focus.
    The confidence is s^2 / (s^2 + sd^2) with s of one level.
    """
    level, sd = estimate.level, estimate.sd
    if estimate.depth_m is not None:
        level = levels.level_of(estimate.depth_m, bank.depth_m, None if bank.behind is None else bank.behind.depth_m)
        sd = None if sd is None else levels.level_sd_of(sd, estimate.depth_m, bank.depth_m)
    assert level is not None  # DepthEstimate has a level or a depth
    known = np.isfinite(level)
    farthest = 0 if bank.behind is None or estimate.side == "assumed" else 1 - len(bank.behind.depth_m)
    inside = np.clip(level, farthest, len(bank.depth_m) - 1)
    deviation = np.full(level.shape, UNKNOWN_SD) if sd is None else sd.astype(np.float64)
    confidence = confidence_of(deviation)
    count = _block_sums(known)
    with np.errstate(invalid="ignore"):  # 0 / 0 gives NaN, a block without estimates
        blocks = [(_block_sums(np.where(known, a, 0)) / count).astype(np.float32) for a in (inside, confidence)]
    return blocks[0], np.nan_to_num(blocks[1]), float((inside != level)[known].mean())


def _on_pixels(blocks: np.ndarray) -> np.ndarray:
    """A map of the 2x2 blocks, [h/2, w/2], at every pixel, [h, w]."""
    return blocks.repeat(2, axis=0).repeat(2, axis=1)


def _block_sums(image: np.ndarray) -> np.ndarray:
    """Sums of an image [h, w] over the 2x2 blocks, [h/2, w/2]."""
    return np.asarray(image[::2, ::2].astype(np.float64) + image[1::2, ::2] + image[::2, 1::2] + image[1::2, 1::2])
