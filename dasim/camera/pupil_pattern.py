"""Intensity of the light behind a stop of any shape: the squared modulus of the transform of its defocused pupil.

Off the axis, the stop is foreshortened, and its light reaches the sensor obliquely. The optical path from a point rho
of the stop to an offset u from the geometric image is then rho T u / s, with the image distance s and
T = diag(cos^3, cos) of the field angle in the tangential and sagittal directions. Defocus adds rho T rho times the
on-axis coefficient. The pattern is therefore that of the pupil drawn at T rho. For small stops, this equals Huygens's
principle (claim ``off-axis``).
"""

from __future__ import annotations

from functools import lru_cache
from typing import Any

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
    defocus: tuple[FloatArray, ...]
    if foreshortening is None:
        transmitted, amplitude, down, across = _cropped(stop)
        rho = down[:, None], across[None, :]
        defocus = tuple(_exp_i(2 * np.pi * waves * along**2) for along in rho)
    else:
        transmitted, amplitude, down, across, rho = _foreshortened(stop, foreshortening.tobytes())
        defocus = (_exp_i(2 * np.pi * waves * (down[:, None] * rho[0] + across * rho[1])),)
    cell = down[1] - down[0]
    for factor in defocus:
        amplitude = amplitude * factor
    left = _exp_i(np.pi * np.outer(y, down))
    is_same = np.array_equal(y, x) and np.array_equal(down, across)
    right = left.T if is_same else _exp_i(np.pi * np.outer(across, x))

    def field(amplitude: FloatArray) -> FloatArray:
        return np.asarray(left @ amplitude @ right * cell**2)

    norm = 4 * transmitted.sum() * cell**2
    if phase is None:
        return np.abs(field(amplitude)) ** 2 / norm
    amplitude = amplitude * wavefront.factor(phase, *turned(*rho, turn_rad))
    if phase.opening is None:
        return np.abs(field(amplitude)) ** 2 / norm
    inside = (
        _opening(phase.opening, down, across) if foreshortening is None else _at(stops.pupil(phase.opening)[0], rho)
    )
    return wavefront.two_parts(phase, field(amplitude * (1 - inside)), field(amplitude * inside)) / norm


def _exp_i(phase: FloatArray) -> Any:
    """exp(i phase), of the same shape; its sine and cosine take half of the time of a complex exponential."""
    result = np.empty(phase.shape, complex)
    np.cos(phase, out=result.real)
    np.sin(phase, out=result.imag)
    return result


def turned(y: FloatArray, x: FloatArray, turn_rad: float) -> tuple[FloatArray, FloatArray]:
    """Components (y, x) along axes that are turned by an angle from x towards y."""
    if turn_rad == 0:
        return y, x
    sine, cosine = np.sin(turn_rad), np.cos(turn_rad)
    return y * cosine - x * sine, x * cosine + y * sine


def _open(transmitted: FloatArray) -> tuple[slice, slice]:
    """Rows and columns of a pupil without its closed rim, two at least."""
    found = []
    for axis in (1, 0):
        inside = np.flatnonzero(transmitted.max(axis=axis))
        first = min(inside[0], transmitted.shape[1 - axis] - 2)
        found.append(slice(first, max(inside[-1] + 1, first + 2)))
    return found[0], found[1]


def _cropped(stop: Stop) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """A stop without the closed rim: transmittance and amplitude [y, x], and axes."""
    transmitted, place = stops.pupil(stop)
    rows, columns = _open(transmitted)
    transmitted = transmitted[rows, columns]
    return transmitted, _amplitude(stop, transmitted), place[rows], place[columns]


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

    rows, columns = _open(_at(transmitted, rho(place, place)))
    down, across = place[rows], place[columns]
    places = rho(down, across)
    return _at(transmitted, places), _at(_amplitude(stop, transmitted), places), down, across, places


def _amplitude(stop: Stop, transmitted: FloatArray) -> FloatArray:
    """Amplitude of each cell: its covered share for geometric shapes, the root of its transmittance for masks."""
    return np.sqrt(transmitted) if isinstance(stop, stops.Mask) else transmitted


def _at(values: FloatArray, rho: tuple[FloatArray, FloatArray]) -> FloatArray:
    """A pupil's values at places (y, x), linear between the centres of its cells, 0 outside."""
    cells = [(along + 1) / 2 * len(values) - 0.5 for along in rho]
    return np.asarray(ndimage.map_coordinates(values, cells, order=1, mode="grid-constant"))


def _opening(opening: Stop, down: FloatArray, across: FloatArray) -> FloatArray:
    """Share of each cell about places along the axes that an opening covers, [y, x]."""
    opened, _ = stops.pupil(opening)
    # Masks may have more cells than other stops.
    rows, columns = (((along + 1) / 2 * len(opened)).astype(int) for along in (down, across))
    return opened[np.ix_(rows, columns)]
