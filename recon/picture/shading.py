"""Lens shading: the fall-off towards the frame's corners, measured from a picture of a uniform surface.

Tested in tests/recon/picture/test_develop.py.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.polynomial.legendre import legvander
from numpy.typing import NDArray

from dasim.base.errors import InputError
from dasim.camera.rings import rings
from dasim.camera.specification import Camera
from dasim.typing import Float32Array
from dasim.values import Capture
from recon.picture import colour, field, mosaic

DEGREE = 4  # of the gain, a polynomial in row and column; cos^-4 = (1 + r^2 / s^2)^2 has exactly this degree
BLOCKS_PER_DEGREE = 2  # along a side, at least: small windows have polynomials of a lower degree
SAMPLES = 64  # blocks along the longer side for the fit of the polynomial
MOST_SATURATED = 0.001  # largest share of saturated pixels in a flat
DIMMEST_SHARE = 0.02  # least mean of a flat, relative to full scale
LEAST_BLOCK_PX = 8
LARGEST_DEVIATION = 0.05  # of blocks from the polynomial, relative and beyond noise; a picture with texture has more
DARKEST_BLOCK = 0.02  # least mean of a block relative to the brightest one


def gain(flat: Capture, camera: Camera, lights: Sequence[str], signature: NDArray) -> Float32Array:
    """Factor on each pixel's electrons that corrects the lens shading, [h, w]; at least 1.

    ``flat`` is a capture of a uniformly lit, uniform surface out of focus, by the same sensor at the same focus. The
    factor is a polynomial fitted to the inverse of each channel, so that noise, dust and PRNU have no influence.

    The factor does not correct the colour shading that the data sheet predicts under the light of the flat: the removal
    of infrared corrects it for the light of the picture (:mod:`recon.picture.field`). Other shading, such as vignetting
    of single channels, is corrected as measured in the flat. The light of the flat is the nearest of ``lights``, whose
    white ``signature`` is [light, channel].
    """
    check_flat(flat, camera)
    electrons, saturated = mosaic.linearise(flat)
    if saturated.mean() > MOST_SATURATED:
        raise InputError(f"flat: {saturated.mean():.1%} of its pixels are saturated; use a shorter exposure")
    if electrons.mean() < DIMMEST_SHARE * camera.sensor.full_well_e / flat.gain:
        raise InputError("flat: too dark for a measurement of the lens shading; use a longer exposure")
    light = lights[colour.choose_light(electrons, saturated, flat.camera, lights, signature)]
    angles, place = rings(flat.camera)
    known = field.relative_white(flat.camera, light, angles)
    factor = np.empty_like(electrons)
    for (name, grids), relative in zip(mosaic.grids(camera).items(), known, strict=True):
        where = mosaic.sites(grids, electrons.shape)
        whole = _inverse(electrons, where, name) * field.on_grid(relative, place)
        factor[where] = (whole / whole.min())[where]
    return factor


def check_flat(flat: Capture, camera: Camera) -> None:
    """Raise InputError if a flat has another sensor or size than the camera."""
    sensor, flat_sensor = camera.sensor, flat.camera.sensor
    same = ("width_px", "height_px", "pixel_pitch_um", "mosaic", "principal_point_px")
    wrong = [name for name in same if getattr(sensor, name) != getattr(flat_sensor, name)]
    if wrong:
        raise InputError(
            f"flat: its {wrong[0]} is {getattr(flat_sensor, wrong[0])}, the capture's {getattr(sensor, wrong[0])}; "
            "use a flat of the same sensor and size"
        )


def _inverse(electrons: Float32Array, where: NDArray, name: str) -> NDArray[np.float64]:
    """Polynomial in row and column, of total degree ``DEGREE``, of 1 / electrons of a channel, [h, w].

    ``where`` [h, w] marks the channel's pixels. The fit is least squares over the means of square blocks, weighted by
    the standard errors of their inverses. Raises InputError if the picture is not that of a uniform surface.
    """
    height, width = electrons.shape
    block = max(LEAST_BLOCK_PX, -(-max(height, width) // SAMPLES))
    # The last block holds the rest, too, which may be too narrow for pixels of every channel.
    rows, columns = (np.arange(0, max(n - block, 0) + 1, block) for n in (height, width))
    y, x = (2 * (np.arange(n) + 0.5) / n - 1 for n in (height, width))

    def total(image: NDArray) -> NDArray[np.float64]:
        per_row = np.add.reduceat(image.astype(np.float64), rows, axis=0)
        return np.asarray(np.add.reduceat(per_row, columns, axis=1))

    count = total(where)
    mean = total(electrons * where) / count
    if mean.min() < DARKEST_BLOCK * mean.max():
        raise InputError(f"flat: channel {name} is not lit everywhere; use a uniform surface that fills the frame")
    # mean position of the channel's pixels in each block, which is off the block's centre
    at_y, at_x = (legvander((total(where * at) / count).ravel(), DEGREE) for at in (y[:, None], x[None, :]))
    most_i, most_j = (min(DEGREE, (len(starts) - 1) // BLOCKS_PER_DEGREE) for starts in (rows, columns))
    powers = [(i, j) for i in range(most_i + 1) for j in range(most_j + 1) if i + j <= DEGREE]
    design = np.stack([at_y[:, i] * at_x[:, j] for i, j in powers], axis=1)
    weight = (mean * np.sqrt(mean * count)).ravel()  # inverse standard error of 1 / mean for photon noise
    fitted, *_ = np.linalg.lstsq(design * weight[:, None], weight / mean.ravel(), rcond=None)
    within = np.maximum(total(electrons.astype(np.float64) ** 2 * where) / count - mean**2, 0)
    noise = within / np.maximum(count - 1, 1) / mean**2  # relative variance of a block's mean
    excess = float(np.mean((design @ fitted * mean.ravel() - 1) ** 2 - noise.ravel()))
    if excess > LARGEST_DEVIATION**2:
        raise InputError(
            f"flat: channel {name} differs by {np.sqrt(excess):.0%} (standard deviation) from a smooth shading; use a "
            "uniform surface that fills the frame and is evenly lit"
        )
    table = np.zeros((DEGREE + 1, DEGREE + 1))
    for (i, j), value in zip(powers, fitted, strict=True):
        table[i, j] = value
    return np.asarray(legvander(y, DEGREE) @ table @ legvander(x, DEGREE).T)
