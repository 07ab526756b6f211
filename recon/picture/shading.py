"""Lens shading: the fall-off of light towards the frame's corners, measured from a picture of an even surface.

Tested in tests/recon/picture/test_develop.py.
"""

from __future__ import annotations

import numpy as np
from numpy.polynomial.legendre import legvander
from numpy.typing import NDArray

from dasim.base.errors import InputError
from dasim.camera.specification import Camera
from dasim.typing import Float32Array
from dasim.values import Capture
from recon.picture import mosaic

DEGREE = 4  # of the polynomial in row and column that is the gain: cos^-4 = (1 + r^2 / s^2)^2 is one, exactly
SAMPLES = 64  # blocks along the longer side that the polynomial is fitted to
MOST_SATURATED = 0.001  # of the pixels
DIMMEST_SHARE = 0.02  # of full scale that the flat must have on average
LEAST_BLOCK_PX = 8
DARKEST_BLOCK = 0.02  # of the brightest: below, a gain would be a guess


def gain(flat: Capture, camera: Camera) -> Float32Array:
    """Factor on each pixel's electrons [h, w] that makes a capture of an even surface even, 1 at the brightest place.

    ``flat`` is a capture of an even, evenly lit surface out of focus, by the same sensor at the same focus, with its
    black level. A polynomial is fitted to the inverse of each channel, so that noise, dust and PRNU
    are not mistaken for shading.
    """
    check_flat(flat, camera)
    electrons, saturated = mosaic.linearise(flat)
    if saturated.mean() > MOST_SATURATED:
        raise InputError(f"flat: {saturated.mean():.1%} of its pixels are saturated; take it with a shorter exposure")
    if electrons.mean() < DIMMEST_SHARE * camera.sensor.full_well_e / flat.gain:
        raise InputError("flat: is too dark to show the lens shading; take it with a longer exposure")
    found = np.empty_like(electrons)
    for name, own in mosaic.grids(camera).items():
        where = mosaic.sites(own, electrons.shape)
        inverse = _inverse(electrons, where, name)
        found[where] = (inverse / inverse.min())[where]
    return found


def check_flat(flat: Capture, camera: Camera) -> None:
    """InputError where a flat is of another sensor or size."""
    mine, theirs = camera.sensor, flat.camera.sensor
    same = ("width_px", "height_px", "pixel_pitch_um", "mosaic")
    wrong = [name for name in same if getattr(mine, name) != getattr(theirs, name)]
    if wrong:
        raise InputError(
            f"flat: its {wrong[0]} is {getattr(theirs, wrong[0])}, the capture's {getattr(mine, wrong[0])}; "
            "take the flat with the same sensor and size"
        )


def _inverse(electrons: Float32Array, where: NDArray, name: str) -> NDArray[np.float64]:
    """Polynomial of row and column, of total degree ``DEGREE``, for 1 / electrons of a channel's pixels, [h, w].

    Least squares over the means of square blocks, each weighted as its inverse is known.
    """
    height, width = electrons.shape
    block = max(LEAST_BLOCK_PX, -(-max(height, width) // SAMPLES))
    rows, columns = (np.arange(0, n, block) for n in (height, width))
    y, x = (2 * (np.arange(n) + 0.5) / n - 1 for n in (height, width))

    def total(image: NDArray) -> NDArray[np.float64]:
        per_row = np.add.reduceat(image.astype(np.float64), rows, axis=0)
        return np.asarray(np.add.reduceat(per_row, columns, axis=1))

    count = total(where)
    mean = total(electrons * where) / count
    if mean.min() < DARKEST_BLOCK * mean.max():
        raise InputError(f"flat: channel {name} is not lit everywhere; take an even surface that fills the frame")
    # where a channel's pixels are on average in each block: their grid does not lie in its middle
    at_y, at_x = (legvander((total(where * at) / count).ravel(), DEGREE) for at in (y[:, None], x[None, :]))
    powers = [(i, j) for i in range(DEGREE + 1) for j in range(DEGREE + 1 - i)]
    design = np.stack([at_y[:, i] * at_x[:, j] for i, j in powers], axis=1)
    weight = (mean * np.sqrt(mean * count)).ravel()  # 1 over the standard error of 1 / mean, for photon noise
    fitted, *_ = np.linalg.lstsq(design * weight[:, None], weight / mean.ravel(), rcond=None)
    table = np.zeros((DEGREE + 1, DEGREE + 1))
    for (i, j), value in zip(powers, fitted, strict=True):
        table[i, j] = value
    return np.asarray(legvander(y, DEGREE) @ table @ legvander(x, DEGREE).T)
