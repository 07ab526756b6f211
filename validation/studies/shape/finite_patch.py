"""The bound of a patch without its surroundings, as an estimator sees a patch that is cut out of a picture.

The bound of :mod:`validation.studies.criteria` treats a patch as periodic: what a wide kernel spreads into the patch
from outside looks like the patch itself. A patch cut out of a larger picture holds less information, because its
surroundings are unknown. Its bound follows from the covariances between all of its samples.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import linalg

from dasim.bounds import cramer_rao, pupils
from dasim.camera import sensor as sensors
from dasim.camera.specification import Camera
from dasim.typing import FloatArray
from validation.studies import criteria
from validation.studies.criteria import PLANES, SPACING_PX

SIDE = 16  # samples 2 px apart: a patch of 31 px
FIELD = 128  # samples per side of the periodic field that holds the patch
CELLS = 64  # of transforms across the lens
LOWEST = 1 / 64  # cycles/px, the lowest frequency of the periodic patch


def cut_deviation(
    camera: Camera, blur_px: FloatArray, side: int, *, light: str = "D65", level_lux: float = 5000.0
) -> FloatArray:
    """Least standard deviation of the visible blur in px, [blur], from ``side`` x ``side`` samples of each plane alone.

    The Slepian-Bangs formula (as in :mod:`dasim.bounds.cramer_rao`) with the covariances between all samples: I_ab =
    1/2 tr(C^-1 dC/da C^-1 dC/db) for a and b of blur, texture strength and gain; strength and gain are unknown, the
    spectrum is known. ``blur_px`` are the visible blurs, [blur]; ``side`` is at most half of ``FIELD``.
    """
    if 2 * side > FIELD:
        raise ValueError("the field must be at least twice as wide as the patch")
    patch = criteria.texture_patch(camera, light, level_lux)
    index = [sensors.channels(camera.sensor).index(name) for name in PLANES]
    shape = (FIELD, FIELD)
    radius = np.hypot(*cramer_rao.frequencies(shape, SPACING_PX))
    contrast = patch.power[0, 4] / cramer_rao.natural_power(criteria.SHAPE, spacing_px=SPACING_PX)[0, 4]
    power = contrast * cramer_rao.natural_power(shape, spacing_px=SPACING_PX) * (radius >= LOWEST)
    y, x = (part.ravel() for part in np.indices((side, side)))
    rows, columns = (part[:, None] - part[None, :] for part in (y, x))

    def covariance(one: NDArray, other: NDArray) -> FloatArray:
        """Covariances of all samples of all planes, of signals with the transfer functions one and other."""
        spectra = power * one[:, None] * np.conj(other[None])
        return np.block([[np.fft.irfft2(part, shape)[rows, columns] for part in line] for line in spectra])

    deviations = []
    for blur in blur_px:
        steps = blur + np.array([-1, 1]) * cramer_rao.SLOPE_STEP_PX
        transfer, _ = pupils.stop_transfers(camera, steps, light, shape, spacing_px=SPACING_PX, fine_cells=CELLS)
        s = patch.gain[:, None, None] * transfer[:, index]
        middle, slope = s.mean(axis=0), (s[1] - s[0]) / (2 * cramer_rao.SLOPE_STEP_PX)
        infrared = np.where(np.arange(len(PLANES))[:, None, None] == 1, middle, 0)
        signal, by_blur, by_gain = (covariance(one, middle) for one in (middle, slope, infrared))
        factor = linalg.cho_factor(signal + np.diag(np.repeat(patch.noise, side * side)))
        changes = [linalg.cho_solve(factor, part) for part in (by_blur + by_blur.T, signal, by_gain + by_gain.T)]
        information = np.array([[0.5 * np.sum(a * b.T) for b in changes] for a in changes])
        deviations.append(np.sqrt(linalg.inv(information)[0, 0]))
    return np.array(deviations)
