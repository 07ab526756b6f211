"""Check that a PSF bank matches a capture: same sensor, stops, lens and focus distance, and its field position.

Tested in tests/recon/calibration/test_psf_bank.py.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from dasim.base.errors import InputError, kind_of
from dasim.camera.rings import field_angle_deg
from dasim.camera.sensor import channels, principal_point
from dasim.camera.specification import Camera
from dasim.values import Capture, PsfBank

PLACE_TOLERANCE = (
    0.05  # relative difference of the width of diffraction between the bank's place and the frame's middle
)
FOCUS_TOLERANCE = 0.01  # relative difference of the focus in dioptres between bank and capture


def check_fits(bank: PsfBank, capture: Capture) -> None:
    """Raise InputError if the bank was made for another camera or focus, or if the camera has no infrared pixels.

    Frame sizes may differ, because kernels do not depend on them. Raises InputError, too, if one is of another type.
    """
    if not isinstance(capture, Capture):
        raise InputError(f"capture: must be a Capture, not {kind_of(capture)}")
    camera = capture.camera
    if "IR" not in channels(camera.sensor):
        raise InputError(
            f"camera '{camera.name}' has no infrared pixels, so depth cannot be estimated; "
            "use recon.develop for the colour picture alone"
        )
    if not isinstance(bank, PsfBank):
        raise InputError(f"bank: must be a PsfBank, not {kind_of(bank)}; see recon.calibrate")
    if len(bank.depth_m) < 2:
        raise InputError("bank has only one level; depth needs the focus and at least one level in front of it")
    focus = f"{camera.lens.focus_distance_m:g}"
    check_lens(bank, camera, "the capture", f"make a bank with 'dasim calibrate --camera CAMERA --focus {focus}'")


def check_lens(bank: PsfBank, camera: Camera, of: str, otherwise: str) -> None:
    """Raise InputError if the bank was made for another camera or focus than ``camera``.

    The message names ``of`` as the owner of ``camera``, such as "the capture", and ends with the advice ``otherwise``.
    """
    bank_camera = bank.camera
    wrong = [name for name, value, other in _kernel_properties(camera, bank_camera) if value != other]
    if wrong:
        raise InputError(
            f"bank of camera '{bank_camera.name}' does not match {of} of camera '{camera.name}': they differ in "
            f"{', '.join(wrong)}; {otherwise}"
        )
    focus, bank_focus = camera.lens.focus_distance_m, bank_camera.lens.focus_distance_m
    if abs(1 / focus - 1 / bank_focus) > FOCUS_TOLERANCE / bank_focus or (
        camera.lens.focal_length_mm, camera.lens.f_number
    ) != (bank_camera.lens.focal_length_mm, bank_camera.lens.f_number):  # fmt: skip
        raise InputError(
            f"bank is for a lens of {bank_camera.lens.focal_length_mm:g} mm f/{bank_camera.lens.f_number:g} focused at "
            f"{bank_focus:g} m, {of} has {camera.lens.focal_length_mm:g} mm f/{camera.lens.f_number:g} at "
            f"{focus:g} m; {otherwise}"
        )


def place_notes(bank: PsfBank, camera: Camera) -> list[str]:
    """A note if the bank's kernels were measured far from the field position of the centre of the camera's frame.

    Diffraction widens by 1/cos^3 of the field angle, so the two angles determine how much the kernels differ.
    """
    x, y = principal_point(camera.sensor)
    middle_px = camera.sensor.width_px / 2 - x, camera.sensor.height_px / 2 - y
    there, here = (field_angle_deg(camera, place) for place in (bank.field_px, middle_px))
    wider = (np.cos(np.radians(there)) / np.cos(np.radians(here))) ** 3 - 1
    if abs(wider) <= PLACE_TOLERANCE:
        return []
    return [
        f"the bank's kernels are those at {there:.1f} degrees off the axis, the frame's middle is at {here:.1f}, where "
        f"diffraction is {abs(wider):.0%} {'wider' if wider > 0 else 'narrower'}; make a bank with the camera of this "
        f"frame, or with field_px = ({middle_px[0]:g}, {middle_px[1]:g})"
    ]


def _kernel_properties(camera: Camera, other: Camera) -> list[tuple[str, Any, Any]]:
    """What determines the PSFs, but for focal length, f-number and focus: name, and the value in each camera."""
    stops, other_stops = ([stop.model_dump() for stop in each.stops] for each in (camera, other))
    first, second = camera.sensor, other.sensor
    return [
        ("stops", stops, other_stops),
        ("pixel_pitch_um", first.pixel_pitch_um, second.pixel_pitch_um),
        ("channels", channels(first), channels(second)),
        ("quantum_efficiency", first.quantum_efficiency, second.quantum_efficiency),
        ("silicon_um", first.silicon_um, second.silicon_um),
        ("cutoff_nm", first.cutoff_nm, second.cutoff_nm),
        ("cutoff_width_nm", first.cutoff_width_nm, second.cutoff_width_nm),
        ("focal_shift_um", camera.lens.focal_shift_um, other.lens.focal_shift_um),
        ("wavefront_nm", camera.lens.wavefront_nm, other.lens.wavefront_nm),
        ("wavefront_by_field", camera.lens.wavefront_by_field, other.lens.wavefront_by_field),
    ]
