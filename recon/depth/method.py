"""Depth methods: plain functions from a capture and a PSF bank to a depth estimate, bundled ones and a user's own."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np

from dasim.base.errors import InputError
from dasim.base.loading import function_name
from dasim.typing import Float32Array
from dasim.values import Capture, DepthEstimate, PsfBank
from recon import levels
from recon.calibration.fit import check_fits
from recon.depth.peak import REFERENCE_ERROR
from recon.depth.raw_levels import raw_levels, variances
from recon.picture import colour, mosaic
from recon.settings import PRESETS, Settings

Method = Callable[[Capture, PsfBank], DepthEstimate]

UNKNOWN_SD = REFERENCE_ERROR  # levels, of an estimate without standard deviation: a confidence of one half


def estimate(capture: Capture, bank: PsfBank, settings: Settings) -> DepthEstimate:
    """Raw levels of eq. (12) with the settings' score and their standard deviation, without regularisation.

    The light is chosen by white balance among those of the bank. Each 2x2 block of the mosaic has one value.
    """
    check_fits(bank, capture)
    raw_e, saturated = mosaic.linearise(capture)
    camera = capture.camera
    light = colour.choose_light(mosaic.planes(raw_e, camera), mosaic.blocks_any(saturated), bank.signature)
    level, confidence = raw_levels(
        raw_e, variances(raw_e, capture), saturated, camera, bank.kernel[light], settings, bank.signature[light]
    )
    known = np.isfinite(level)
    share = np.where(known, confidence, 1).astype(np.float64)
    sd = np.where(known, REFERENCE_ERROR * np.sqrt(1 / share - 1), np.nan)
    return DepthEstimate(level=_on_pixels(level), sd=_on_pixels(sd))


METHODS: dict[str, Method] = {name: partial(estimate, settings=settings) for name, settings in PRESETS.items()}


def method_name(method: Method) -> str:
    """Name of a bundled method in ``METHODS``; of any other, the module and the function."""
    return next((name for name, own in METHODS.items() if own is method), None) or function_name(method)


def applied(method: Method, capture: Capture, bank: PsfBank) -> DepthEstimate:
    """The estimate of a method; InputError with the method's name where it does not fit the capture."""
    where = f"method '{method_name(method)}'"
    try:
        found = method(capture, bank)
    except InputError as error:
        raise InputError(f"{where}: {error}") from None
    if not isinstance(found, DepthEstimate):
        raise InputError(f"{where}: returns {type(found).__name__}; a recon.DepthEstimate is needed")
    if found.shape != capture.raw_dn.shape:
        raise InputError(
            f"{where}: returns a map of shape {found.shape}, the raw frame has {capture.raw_dn.shape}; "
            "return one value per raw pixel, NaN where there is no estimate"
        )
    if not found.coverage:
        raise InputError(f"{where}: estimates nothing, all values are NaN; at least one pixel needs a value")
    return found


def on_blocks(found: DepthEstimate, bank: PsfBank) -> tuple[Float32Array, Float32Array, float]:
    """Levels on the 2x2 blocks of the mosaic (NaN: none) and their confidence; share of estimates out of range.

    A block has the mean of its pixels' estimates. Depths outside the bank, farther than its focus or nearer than its
    last level, have no kernels there and count as the bank's end; the share says how many there were. The confidence
    is s^2 / (s^2 + sd^2) with s one level.
    """
    level, sd = found.level, found.sd
    if found.depth_m is not None:
        level = levels.level_of(found.depth_m, bank.depth_m)
        sd = None if sd is None else levels.level_sd_of(sd, found.depth_m, bank.depth_m)
    assert level is not None  # checked when it was made
    known = np.isfinite(level)
    inside = np.clip(level, 0, len(bank.depth_m) - 1)
    deviation = np.full(level.shape, UNKNOWN_SD) if sd is None else sd.astype(np.float64)
    confidence = REFERENCE_ERROR**2 / (REFERENCE_ERROR**2 + deviation**2)
    count = _block_sums(known)
    with np.errstate(invalid="ignore"):  # 0 / 0 is NaN, a block without any estimate
        blocks = [(_block_sums(np.where(known, a, 0)) / count).astype(np.float32) for a in (inside, confidence)]
    return blocks[0], np.nan_to_num(blocks[1]), float((inside != level)[known].mean())


def _on_pixels(blocks: np.ndarray) -> np.ndarray:
    """Each block's value at its four pixels."""
    return blocks.repeat(2, axis=0).repeat(2, axis=1)


def _block_sums(image: np.ndarray) -> np.ndarray:
    """Sums over 2x2 blocks."""
    return np.asarray(image[::2, ::2].astype(np.float64) + image[1::2, ::2] + image[::2, 1::2] + image[1::2, 1::2])
