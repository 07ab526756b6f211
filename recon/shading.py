"""Lens shading: the fall-off of light towards the frame's corners, measured from a picture of an even surface."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from dasim.camera import Camera
from dasim.errors import InputError
from dasim.values import Capture
from recon import mosaic

Float32Array = NDArray[np.float32]

DEGREE = 6  # of the polynomial in row and column: cos^4 over 45 degrees of half diagonal is met to 0.1 %
SAMPLES = 64  # blocks along the longer side that the polynomial is fitted to
MOST_SATURATED = 0.001  # of the pixels
DIMMEST_SHARE = 0.02  # of full scale that the flat must have on average
DARKEST_CORNER = 0.02  # of the brightest place: below, a gain would be guesswork


def gain(flat: Capture, camera: Camera) -> Float32Array:
    """Factor on each pixel's electrons [h, w] that makes a capture of an even surface even, 1 at the brightest place.

    ``flat`` is a capture of an even, evenly lit surface out of focus, by the same sensor at the same focus, with its
    black level. A smooth polynomial is fitted to each channel, so that noise, dust and PRNU are not taken for shading.
    """
    _check(flat, camera)
    electrons, saturated = mosaic.linearise(flat)
    if saturated.mean() > MOST_SATURATED:
        raise InputError(f"flat: {saturated.mean():.1%} of its pixels are saturated; take it with a shorter exposure")
    if electrons.mean() < DIMMEST_SHARE * camera.sensor.full_well_e / flat.gain:
        raise InputError("flat: is too dark to show the lens shading; take it with a longer exposure")
    found = np.empty_like(electrons)
    for name, own in mosaic.grids(camera).items():
        where = mosaic.sites(own, electrons.shape)
        smooth = _smooth(electrons, where)
        if smooth.min() < DARKEST_CORNER * smooth.max():
            raise InputError(f"flat: channel {name} is not lit everywhere; take an even surface that fills the frame")
        found[where] = (smooth.max() / smooth)[where]
    return found


def _check(flat: Capture, camera: Camera) -> None:
    mine, theirs = camera.sensor, flat.camera.sensor
    same = ("width_px", "height_px", "pixel_pitch_um", "mosaic")
    wrong = [name for name in same if getattr(mine, name) != getattr(theirs, name)]
    if wrong:
        raise InputError(
            f"flat: its {wrong[0]} is {getattr(theirs, wrong[0])}, the capture's {getattr(mine, wrong[0])}; "
            "take the flat with the same sensor and size"
        )


def _smooth(electrons: Float32Array, where: NDArray) -> NDArray[np.float64]:
    """Least-squares polynomial of row and column, of total degree ``DEGREE``, of a channel's pixels, [h, w]."""
    height, width = electrons.shape
    block = max(8, -(-max(height, width) // SAMPLES))
    rows, columns = (np.arange(0, n, block) for n in (height, width))
    total, count = (
        np.add.reduceat(np.add.reduceat(a.astype(np.float64), rows, axis=0), columns, axis=1)
        for a in (electrons * where, where)
    )
    middle = [(np.append(at, n)[1:] + at - 1) / 2 for at, n in ((rows, height), (columns, width))]
    powers = [(i, j) for i in range(DEGREE + 1) for j in range(DEGREE + 1 - i)]

    def basis(y: NDArray, x: NDArray) -> tuple[NDArray, NDArray]:
        scaled = [2 * (at + 0.5) / n - 1 for at, n in ((y, height), (x, width))]
        return tuple(np.polynomial.legendre.legvander(at, DEGREE) for at in scaled)  # type: ignore[return-value]

    in_y, in_x = basis(*middle)
    design = np.stack([np.outer(in_y[:, i], in_x[:, j]).ravel() for i, j in powers], axis=1)
    weight = np.sqrt(count.ravel())
    values = total.ravel() / np.maximum(count.ravel(), 1)
    found, *_ = np.linalg.lstsq(design * weight[:, None], values * weight, rcond=None)
    table = np.zeros((DEGREE + 1, DEGREE + 1))
    for (i, j), value in zip(powers, found, strict=True):
        table[i, j] = value
    full_y, full_x = basis(np.arange(height), np.arange(width))
    return np.asarray(full_y @ table @ full_x.T)
