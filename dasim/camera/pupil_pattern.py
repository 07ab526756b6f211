"""Intensity of the light behind a stop of any shape: the squared modulus of the transform of its defocused pupil.

Off the axis, the stop is foreshortened, and its light reaches the sensor obliquely. The optical path from a point rho
of the stop to an offset u from the geometric image is then rho T u / s, with the image distance s and
T = diag(cos^3, cos) of the field angle in the tangential and sagittal directions. Defocus adds rho T rho times the
on-axis coefficient. The pattern is therefore that of the pupil drawn at T rho. For small stops, this equals Huygens's
principle (claim ``off-axis``).
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from scipy import ndimage

from dasim.camera import stops, wavefront
from dasim.camera.stops import Stop
from dasim.camera.wavefront import Phase
from dasim.typing import FloatArray


def pupil_pattern(
    stop: Stop,
    waves: float,
    y: FloatArray,
    x: FloatArray,
    phase: Phase | None = None,
    foreshortening: FloatArray | None = None,
    turn_rad: float = 0.0,
) -> FloatArray:
    """Intensity of a defocused stop at places of the picture, [y, x], of unit integral over the plane.

    U(u) = int P(rho) exp(2 pi i W20 rho^2 + pi i rho u), h = |U|^2 / (4 int |P|^2), as a product of matrices (Jurling
    et al., J. Opt. Soc. Am. A 35, 2018).

    Args:
        stop: the stop.
        waves: defocus W20 at the lens's rim, positive for points nearer than the focus.
        y: places down the picture, in units of lambda N with N the working f-number of the whole lens.
        x: places across the picture.
        phase: that of P, if any.
        foreshortening: T [2, 2] in the order (y, x), from :func:`dasim.camera.geometry.foreshortening`, or None
        turn_rad: from the picture's x to that of ``phase``, towards y.
    """
    if foreshortening is None:
        transmitted, place = stops.pupil(stop)
        amplitude = _amplitude(stop, transmitted)
        down = across = place
        rho = place[:, None], place[None, :]
        along = np.exp(2j * np.pi * waves * place**2)
        defocus: tuple[FloatArray, ...] = (along[:, None], along[None, :])
    else:
        transmitted, amplitude, down, across, rho = _foreshortened(stop, foreshortening.tobytes())
        defocus = (np.exp(2j * np.pi * waves * (down[:, None] * rho[0] + across * rho[1])),)
    cell = down[1] - down[0]
    for factor in defocus:
        amplitude = amplitude * factor

    def field(amplitude: FloatArray) -> FloatArray:
        left, right = np.exp(1j * np.pi * np.outer(y, down)), np.exp(1j * np.pi * np.outer(across, x))
        return np.asarray(left @ amplitude @ right * cell**2)

    norm = 4 * transmitted.sum() * cell**2
    if phase is None:
        return np.abs(field(amplitude)) ** 2 / norm
    amplitude = amplitude * wavefront.factor(phase, *turned(*rho, turn_rad))
    if phase.opening is None:
        return np.abs(field(amplitude)) ** 2 / norm
    inside = _opening(phase.opening, place) if foreshortening is None else _at(stops.pupil(phase.opening)[0], rho)
    return wavefront.two_parts(phase, field(amplitude * (1 - inside)), field(amplitude * inside)) / norm


def turned(y: FloatArray, x: FloatArray, turn_rad: float) -> tuple[FloatArray, FloatArray]:
    """Components (y, x) along axes that are turned by an angle from x towards y."""
    if turn_rad == 0:
        return y, x
    sine, cosine = np.sin(turn_rad), np.cos(turn_rad)
    return y * cosine - x * sine, x * cosine + y * sine


@lru_cache(maxsize=8)
def _foreshortened(
    stop: Stop, foreshortening: bytes
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray, tuple[FloatArray, FloatArray]]:
    """A stop drawn at T rho: transmittance and amplitude [y, x] without the closed rim, axes, and rho (y, x) there."""
    transmitted, place = stops.pupil(stop)
    inverse = np.linalg.inv(np.frombuffer(foreshortening).reshape(2, 2))

    def rho(down: FloatArray, across: FloatArray) -> tuple[FloatArray, FloatArray]:
        y, x = np.tensordot(inverse, np.stack(np.meshgrid(down, across, indexing="ij")), axes=1)
        return y, x

    drawn = _at(transmitted, rho(place, place))
    rows, columns = (np.flatnonzero(drawn.max(axis=axis)) for axis in (1, 0))
    down, across = place[rows[0] : rows[-1] + 1], place[columns[0] : columns[-1] + 1]
    places = rho(down, across)
    return _at(transmitted, places), _at(_amplitude(stop, transmitted), places), down, across, places


def _amplitude(stop: Stop, transmitted: FloatArray) -> FloatArray:
    """Amplitude of each cell: its covered share for geometric shapes, the root of its transmittance for masks."""
    return np.sqrt(transmitted) if isinstance(stop, stops.Mask) else transmitted


def _at(values: FloatArray, rho: tuple[FloatArray, FloatArray]) -> FloatArray:
    """A pupil's values at places (y, x), linear between the centres of its cells, 0 outside."""
    cells = [(along + 1) / 2 * len(values) - 0.5 for along in rho]
    return np.asarray(ndimage.map_coordinates(values, cells, order=1, mode="grid-constant"))


def _opening(opening: Stop, place: FloatArray) -> FloatArray:
    """Share of each cell about ``place`` that an opening covers."""
    opened, _ = stops.pupil(opening)
    index = ((place + 1) / 2 * len(opened)).astype(int)  # masks may have more cells than other stops
    return opened[np.ix_(index, index)]
