"""Tiling: one capture from the central parts of several.

Tested in tests/dasim/scene/test_targets.py.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from dasim.base.errors import InputError
from dasim.base.toml import parse
from dasim.camera import noise, pointspread
from dasim.camera.rings import rings
from dasim.camera.sensor import Sensor
from dasim.camera.specification import Camera
from dasim.values import Capture, Truth

FIXED_PATTERN = 0.01  # of full scale, by which a full well may be read lower
LABELS = {"objects": "object_id", "materials": "material_id"}  # names in a truth, and the image that counts in them


def margin_px(camera: Camera, blur_px: float) -> int:
    """Radius in pixels of the kernel of a visible blur, including the diffraction tail."""
    return pointspread.kernel_size_px(camera, blur_px) // 2


def tiled(tiles: Sequence[tuple[Capture, Truth]], width_px: int, height_px: int) -> tuple[Capture, Truth]:
    """One capture from the central parts of several, stacked with the first at the bottom (Fig. 10 of the paper).

    Every part is at least :func:`margin_px` of its largest blur away from the border of its capture, so that the blur
    at the border does not affect it. The camera of the result has a sensor of the result's size: its off-axis angles
    differ from those of the captures, and windows across a seam contain pixels of two captures. Its coatings do not
    shift with the angle, because all parts are from near the axis.

    Args:
        tiles: captures with their truths, of the same camera, focus and exposure.
        width_px: width of each part, a multiple of the mosaic's.
        height_px: height of each part, a multiple of the mosaic's.
    """
    if not tiles:
        raise InputError("tiles: must hold at least one capture")
    first = tiles[0][0]
    cell_height, cell_width = len(first.camera.sensor.mosaic), len(first.camera.sensor.mosaic[0])
    if height_px % cell_height or width_px % cell_width or min(width_px, height_px) <= 0:
        raise InputError(
            f"tiles of {width_px}x{height_px} pixels: sides must be multiples of the mosaic, {cell_width}x{cell_height}"
        )
    for number, (capture, truth) in enumerate(tiles):
        _check(number, capture, truth, first, width_px, height_px)
    height, width = first.raw_dn.shape
    top = (height - height_px) // 2 // cell_height * cell_height
    left = (width - width_px) // 2 // cell_width * cell_width
    part = (slice(top, top + height_px), slice(left, left + width_px))
    if rings(first.camera).place[height // 2, width // 2] > 1:
        raise InputError(
            "tiles: the parts lie off the optical axis, where filter edges shift; give captures centred on the axis"
        )

    def stack(*images: np.ndarray) -> np.ndarray:
        return np.concatenate([image[part] for image in reversed(images)])

    size = {"width_px": width_px, "height_px": height_px * len(tiles), "principal_point_px": None}
    sensor = parse(Sensor, first.camera.sensor.model_dump() | size | {"coating_index": 0.0}, "tiles")
    lens = first.camera.lens.model_copy(update={"coating_index": 0.0})
    raw_dn = stack(*(capture.raw_dn for capture, _ in tiles))
    picture = replace(
        first,
        raw_dn=raw_dn,
        camera=first.camera.model_copy(update={"lens": lens, "sensor": sensor}),
        provenance=first.provenance
        | {
            "scene": {"name": "tiles", "tiles": [capture.provenance.get("scene", {}) for capture, _ in tiles]},
            "tiles": {"height_px": height_px, "seeds": [capture.seed for capture, _ in tiles]},
            "saturated_pixels": int(np.count_nonzero(raw_dn >= _full_dn(sensor, first.gain))),
            "notes": list(dict.fromkeys(note for shot, _ in tiles for note in shot.provenance.get("notes", []))),
        },
    )
    truths = _with_common_names([truth for _, truth in tiles])
    arrays: dict[str, Any] = {
        name: stack(*(getattr(truth, name) for truth in truths))
        for name, value in vars(truths[0]).items()
        if isinstance(value, np.ndarray)
    }
    return picture, replace(truths[0], **arrays)


def _full_dn(sensor: Sensor, gain: float) -> int:
    """Least raw number of a saturated pixel: that of a full well, less ``FIXED_PATTERN``, or the converter's end."""
    full = noise.saturation_e(sensor, gain) / noise.electrons_per_dn(sensor, gain)
    return min(int(sensor.black_level_dn + (1 - FIXED_PATTERN) * full), 2**sensor.adc_bits - 1)


def _with_common_names(truths: list[Truth]) -> list[Truth]:
    """The truths with labels that count in the same lists of objects and of materials, those of all of them."""
    for name, image in LABELS.items():
        if len({getattr(truth, name) for truth in truths}) == 1:
            continue
        common = tuple(dict.fromkeys(own for truth in truths for own in getattr(truth, name)))
        for place, truth in enumerate(truths):
            numbers = np.array([0, *(common.index(own) + 1 for own in getattr(truth, name))], np.uint32)
            changes: dict[str, Any] = {name: common, image: numbers[getattr(truth, image)]}
            truths[place] = replace(truth, **changes)
    return truths


def _check(number: int, capture: Capture, truth: Truth, first: Capture, width_px: int, height_px: int) -> None:
    """Raise InputError if a tile differs from the first, or the blur of its border reaches its central part."""
    where = f"tile {number}"
    if capture.camera != first.camera:
        raise InputError(f"{where}: its camera, focus or size differs from that of tile 0")
    if (capture.exposure_s, capture.gain) != (first.exposure_s, first.gain):
        raise InputError(
            f"{where}: exposed {capture.exposure_s:g} s at gain {capture.gain:g}, tile 0 {first.exposure_s:g} s at "
            f"{first.gain:g}; give all captures the exposure of the first"
        )
    height, width = capture.raw_dn.shape
    cell = max(len(first.camera.sensor.mosaic), len(first.camera.sensor.mosaic[0]))
    needed = (
        margin_px(capture.camera, float(np.abs(truth.blur_px).max())) + cell
    )  # alignment with the mosaic may shift the part by a cell
    if min(height - height_px, width - width_px) // 2 < needed:
        smallest = f"{width_px + 2 * needed}x{height_px + 2 * needed}"
        raise InputError(
            f"{where}: its blur reaches {needed} pixels inwards from the border; for parts of {width_px}x{height_px} "
            f"pixels, a capture must have at least {smallest}, not {width}x{height}"
        )
