"""Whether a PSF bank belongs to a capture: same sensor, stops and lens, focused at the same distance.

Tested in tests/recon/calibration/test_psf_bank.py.
"""

from __future__ import annotations

from typing import Any

from dasim.base.errors import InputError
from dasim.camera.specification import Camera, channels
from dasim.values import Capture, PsfBank

FOCUS_TOLERANCE = 0.01  # relative, in dioptres, between bank and capture


def check_fits(bank: PsfBank, capture: Capture) -> None:
    """InputError where a bank is of another camera or focus, or the camera shows no depth; frame sizes may differ."""
    mine = capture.camera
    if "IR" not in channels(mine.sensor):
        raise InputError(
            f"camera '{mine.name}' has no infrared pixels, so that its captures show no depth; "
            "recon.develop makes the picture alone"
        )
    banks = bank.camera
    wrong = [name for name, own, other in _kernel_properties(mine, banks) if own != other]
    if wrong:
        raise InputError(
            f"bank of camera '{banks.name}' does not fit a capture of camera '{mine.name}': they differ in "
            f"{', '.join(wrong)}; make one with 'dasim calibrate --camera'"
        )
    focus, bank_focus = mine.lens.focus_distance_m, banks.lens.focus_distance_m
    if abs(1 / focus - 1 / bank_focus) > FOCUS_TOLERANCE / bank_focus or (
        mine.lens.focal_length_mm, mine.lens.f_number
    ) != (banks.lens.focal_length_mm, banks.lens.f_number):  # fmt: skip
        raise InputError(
            f"bank is for a lens of {banks.lens.focal_length_mm:g} mm f/{banks.lens.f_number:g} focused at "
            f"{bank_focus:g} m, the capture has {mine.lens.focal_length_mm:g} mm f/{mine.lens.f_number:g} at "
            f"{focus:g} m; make a bank with 'dasim calibrate --focus {focus:g}'"
        )


def _kernel_properties(mine: Camera, banks: Camera) -> list[tuple[str, Any, Any]]:
    """Camera properties, other than the lens, that determine the PSFs: name, and the value in each camera."""
    own, other = ([stop.model_dump() for stop in camera.stops] for camera in (mine, banks))
    first, second = mine.sensor, banks.sensor
    return [
        ("stops", own, other),
        ("pixel_pitch_um", first.pixel_pitch_um, second.pixel_pitch_um),
        ("channels", channels(first), channels(second)),
        ("quantum_efficiency", first.quantum_efficiency, second.quantum_efficiency),
        ("cutoff_nm", first.cutoff_nm, second.cutoff_nm),
    ]
