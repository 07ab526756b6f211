"""Kernels from mosaic pictures of a point source at arbitrary positions, without whole-pixel shifts.

Tested in tests/recon/files/test_point_pictures.py.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from dasim.base.errors import InputError
from dasim.camera.sensor import channels
from dasim.camera.specification import Camera
from dasim.typing import FloatArray
from dasim.values import PointPicture
from recon.calibration.pictures import CORE_SHARE, RIM_PX, averaged, common_centre
from recon.calibration.round_kernel import basis_of, knots_to, over_pixels, round_fit, subpixel_radius

# One mosaic picture undersamples a core within this radius, and its centre of mass is off by a tenth of a pixel. Its
# centre is that of the best fit of the round model instead.
SMALL_CORE_PX = 7.0
FIT_RADIUS_PX = 8.0  # radius of that fit
CENTRE_TOLERANCE_PX = 0.005
STEPS_PER_KNOT = 300  # of non-negative least squares; three, the library's limit, are too few for some pictures
# Weight of the profile's second differences, relative to the local density, against the pixels' noise: their prior
# standard deviation is ten times the density, and the profile is linear where no pixel samples it.
SMOOTHNESS = 1e-2


def scattered(group: list[PointPicture], camera: Camera) -> FloatArray:
    """Kernels of round stops from mosaic pictures with the source at any positions, [channel, size, size], electrons.

    The centre of each position is measured. The pixels have different distances from it, so that one position samples
    the radial profile, and further ones sample it more finely; no interleaving is needed. Raises InputError if a kernel
    is not round.
    """
    positions: dict[str, list[PointPicture]] = {}
    for picture in group:
        positions.setdefault(picture.position, []).append(picture)
    unit_s = min(picture.exposure_s for picture in group)
    measured = [averaged(pictures, camera, unit_s) for pictures in positions.values()]
    period = max(len(camera.sensor.mosaic), len(camera.sensor.mosaic[0]))
    centres = [_mosaic_centre(*part, period) for part in measured]
    reach = min(
        min(*centre, *(np.array(image.shape[1:]) - 1 - centre))
        for centre, (image, _, _) in zip(centres, measured, strict=True)
    )
    half = int(reach) - 1
    if half < RIM_PX:
        raise InputError("calibration: the point source is at the picture's edge; it must be near the middle")
    target = subpixel_radius((2 * half + 1, 2 * half + 1), np.array([half, half], float))
    radii = [subpixel_radius(part[0].shape[1:], centre) for centre, part in zip(centres, measured, strict=True)]
    kernels = np.empty((len(measured[0][0]), 2 * half + 1, 2 * half + 1))
    for index, name in enumerate(channels(camera.sensor)):
        inside = [radius[sampled[index].ravel()] for radius, (_, _, sampled) in zip(radii, measured, strict=True)]
        value, sigma = (
            np.concatenate([part[what][index][part[2][index]] for part in measured]) for what in (0, 1)
        )  # fmt: skip
        fit = round_fit(np.concatenate(inside), value, sigma, int(reach), SMOOTHNESS)
        if fit is None:
            raise InputError(
                f"calibration: the picture of {name} of {group[0].light} level {group[0].level} is not round; "
                "give pictures with whole-pixel shifts that cover the mosaic's period (shift_x_px, shift_y_px)"
            )
        kernels[index] = over_pixels(target, fit).reshape(kernels.shape[1:])
    return kernels


def _mosaic_centre(image: FloatArray, noise_e: FloatArray, sampled: NDArray[np.bool_], period: int) -> FloatArray:
    """Centre (y, x) of the point in one mosaic picture, pixels.

    Linear interpolation between a channel's pixels preserves the centre of mass of a kernel that is smooth on the
    mosaic's scale. The centre of a small kernel is that of the best fit of the round model.
    """
    hat = 1 - np.abs(np.arange(1 - period, period)) / period
    whole = image
    for axis in (1, 2):
        whole = ndimage.convolve1d(whole, hat, axis=axis, mode="constant")
    weight = ndimage.convolve1d(ndimage.convolve1d(sampled.astype(float), hat, axis=1), hat, axis=2)
    whole = whole / np.maximum(weight, 1e-9)
    centre = common_centre(whole)
    y, x = np.indices(image.shape[1:])
    radius_px = np.hypot(y - centre[0], x - centre[1])
    total = np.asarray(np.maximum(whole, 0).sum(axis=0))
    if radius_px[total > CORE_SHARE * total.max()].max() > SMALL_CORE_PX:
        return centre
    near = radius_px < FIT_RADIUS_PX
    top, left = (int(max(c - FIT_RADIUS_PX, 0)) for c in centre)
    side = int(2 * FIT_RADIUS_PX) + 2
    window = (slice(top, top + side), slice(left, left + side))

    from scipy.optimize import minimize, nnls  # takes a third of a second to import

    def misfit(candidate: FloatArray) -> float:
        radius = subpixel_radius(image[0][window].shape, candidate - np.array([top, left]))
        total = 0.0
        for plane, sigma, here in zip(image, noise_e, sampled, strict=True):
            used = here[window] & near[window]
            knots = knots_to(FIT_RADIUS_PX)
            basis = basis_of(radius[used.ravel()], knots).toarray() / sigma[window][used][:, None]
            total += nnls(basis, plane[window][used] / sigma[window][used], maxiter=STEPS_PER_KNOT * len(knots))[1] ** 2
        return total

    simplex = centre + 0.3 * np.array([[0.0, 0.0], [1.0, 0.2], [-0.2, 1.0]])
    options = {"initial_simplex": simplex, "xatol": CENTRE_TOLERANCE_PX, "fatol": np.inf, "maxiter": 60}
    return np.asarray(minimize(misfit, centre, method="Nelder-Mead", options=options).x)
