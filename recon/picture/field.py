"""Colour over the field: white and infrared off the axis, from the responses of the data sheet.

The coatings of disc and cut-off shift to shorter wavelengths with the angle of the light. Off the axis red loses more
than green and blue, infrared less than red, and the coefficients of eq. (8) change (that of red from 1.00 to 1.24 in
the corner of a phone camera). The data sheet gives the responses on a few rings of the field
(:mod:`dasim.camera.rings`). Here they become, ring by ring, the removal of infrared, and gains that turn the colours
into those that the axis records, so that one white and one colour matrix serve for the whole frame. The gains are exact
for neutral surfaces. Deviation: the paper has one set of coefficients for the frame.

Tested in tests/recon/picture/test_field.py.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray

from dasim.base.errors import InputError
from dasim.camera.radiometry import response
from dasim.camera.rings import field_angle_deg, rings
from dasim.camera.sensor import channels
from dasim.camera.specification import Camera
from dasim.spectra import grid
from dasim.typing import Float32Array, FloatArray
from dasim.values import PsfBank
from recon.calibration.white import relative_to_axis
from recon.picture import infrared
from recon.settings import Settings


class Separation(NamedTuple):
    """Removal of infrared on the rings of a frame."""

    matrices: FloatArray  # [ring, 3, channel] to R, G, B without infrared as the axis records them
    infrared_gain: FloatArray  # [ring] factor that turns infrared into what the axis records
    place: FloatArray  # [h, w] fractional ring of each pixel

    @property
    def on_axis(self) -> FloatArray:
        """The matrix of :func:`recon.picture.infrared.separation`, [3, channel]."""
        return self.matrices[0]


def separation(camera: Camera, light: str, settings: Settings) -> Separation:
    """Removal of infrared over the frame, under a light; see :func:`recon.picture.infrared.separation`."""
    angles, place = rings(camera)
    rows = np.stack([infrared.separation(camera, light, settings, angle) for angle in angles])
    white = _white(camera, light, angles)
    visible = np.einsum("kij,kj->ki", rows, white)
    if (visible <= 0).any():
        channel = int(np.argmin(visible.min(axis=0)))
        raise InputError(
            f"infrared removal: the alpha of {'RGB'[channel]} leaves no visible light of white under {light}; it must "
            f"be below {float((white[:, channel] / white[:, -1]).min()):.3g} (settings.crosstalk, or the camera's "
            "response curves)"
        )
    gain = white[0, -1] / white[:, -1] if "IR" in channels(camera.sensor) else np.ones(len(angles))
    return Separation(rows * (visible[:1] / visible)[..., None], gain, place)


def relative_white(camera: Camera, light: str, angles_deg: FloatArray) -> FloatArray:
    """Electrons of white at angles of the field relative to the axis, [channel, ring]; cos^4 is not included."""
    white = _white(camera, light, angles_deg)
    return np.asarray((white / white[0]).T)


def _white(camera: Camera, light: str, angles_deg: FloatArray) -> FloatArray:
    """Relative electrons of white under a light, [ring, channel]."""
    power = infrared.light_power(light)
    return np.stack([grid.integrate(response(camera, angle) * power) for angle in angles_deg])


def with_infrared_of_axis(bank: PsfBank) -> PsfBank:
    """The bank with the infrared share of its R, G and B kernels converted to that of white on the axis.

    If the bank was measured elsewhere in the field, kernels of R, G and B contain the infrared share alpha_i w_IR / w_i
    of that position; white w on the axis is the bank's ``signature``. The kernels of visible light and of infrared keep
    their shape.
    """
    angle_deg = field_angle_deg(bank.camera, bank.field_px)
    if angle_deg == 0 or "IR" not in channels(bank.camera.sensor):
        return bank
    there = bank.signature * relative_to_axis(bank.camera, bank.lights, bank.field_px)
    shares = [
        infrared.crosstalk(bank.camera, None, angle) * white[:, 3:] / white[:, :3]
        for angle, white in ((angle_deg, there), (0.0, bank.signature))
    ]
    share, wanted = (each[:, None, :, None, None] for each in shares)
    kernel = _with_share(bank.kernel, share, wanted)
    if bank.behind is None:
        return replace(bank, kernel=kernel)
    behind = replace(bank.behind, kernel=_with_share(bank.behind.kernel, share, wanted))
    return replace(bank, kernel=kernel, behind=behind)


def _with_share(measured: Float32Array, share: FloatArray, wanted: FloatArray) -> Float32Array:
    """Kernels [light, level, channel, y, x] with the infrared ``share`` of R, G and B changed to ``wanted``."""
    kernel = measured.astype(np.float64)
    of_infrared = kernel[:, :, 3:]
    kernel[:, :, :3] = (1 - wanted) * (kernel[:, :, :3] - share * of_infrared) / (1 - share) + wanted * of_infrared
    kernel = np.maximum(kernel, 0)
    return np.asarray(kernel / kernel.sum(axis=(-1, -2), keepdims=True), np.float32)


def separate(image: Float32Array, over_field: Separation) -> Float32Array:
    """Visible light of an image [h, w, channel], clipped at 0, [h, w, 3]."""
    if len(over_field.matrices) == 1:
        return infrared.separate(image, over_field.on_axis)
    result = np.empty((*image.shape[:2], 3), np.float32)
    _separate(image, over_field.matrices.astype(np.float32), over_field.place.astype(np.float32), result)
    return result


@njit(cache=True, parallel=True)
def _separate(  # pragma: no cover - compiled
    image: Float32Array, matrices: Float32Array, place: Float32Array, result: Float32Array
) -> None:
    last = matrices.shape[0] - 2
    for y in prange(image.shape[0]):
        for x in range(image.shape[1]):
            ring = min(int(place[y, x]), last)
            share = place[y, x] - np.float32(ring)
            for colour in range(3):
                total = np.float32(0)
                for channel in range(image.shape[2]):
                    low, high = matrices[ring, colour, channel], matrices[ring + 1, colour, channel]
                    total += (low + share * (high - low)) * image[y, x, channel]
                result[y, x, colour] = max(total, np.float32(0))


def infrared_as_on_axis(ir_e: Float32Array, over_field: Separation) -> Float32Array:
    """Infrared [h, w] as the axis records it."""
    return ir_e * on_grid(over_field.infrared_gain, over_field.place)


def on_grid(values: NDArray, place: FloatArray) -> Float32Array:
    """Values of the rings [ring] at fractional rings of any shape, float32."""
    return np.interp(place, np.arange(len(values)), values).astype(np.float32)
