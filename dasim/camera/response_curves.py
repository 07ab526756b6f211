"""Response curves of the bundled RGB-IR sensor, and its near-infrared crosstalk."""

from __future__ import annotations

import numpy as np

from dasim.spectra.grid import NEAR_INFRARED_NM, WAVELENGTH_NM, long_pass
from dasim.typing import FloatArray


def _bell(centre_nm: float, left_nm: float, right_nm: float) -> FloatArray:
    """Gaussian bell of height 1 with different standard deviations left and right of its centre."""
    sigma = np.where(WAVELENGTH_NM < centre_nm, left_nm, right_nm)
    return np.exp(-0.5 * ((WAVELENGTH_NM - centre_nm) / sigma) ** 2)


def rgb_ir_quantum_efficiency() -> FloatArray:
    """Quantum efficiency of a synthetic RGB-IR sensor, shape [4 (R, G, B, IR), wavelength], 0..1.

    The paper's Fig. 2(d) is not available as numbers and no measured curve of a whole RGB-IR sensor
    was found, so these are parametric: a clear silicon pixel (broad bell, 0.58 at 610 nm) behind one
    dye a channel. The visible pass bands and near-infrared tails follow published curves of silicon
    sensors in shape (the tails of green and blue open slowly beyond 700 and 780 nm); red passes nearly
    all of the near-infrared, as sec. 4.4 states. The infrared dye opens at 655 nm, so that the infrared
    pixel sees almost no visible light, which eq. (7) assumes. Green peaks at 0.55.

    What is known of the tails, as areas over 650-810 nm. Eq. (8) divides by the infrared pixel; sensors were
    measured beside their own clear pixel (MT9V024, and the range of similar ones):

    | | R | G | B | IR |
    |---|---|---|---|---|
    | ours, to our clear pixel | 0.91 | 0.145 | 0.074 | 0.91 |
    | measured, to their clear pixel | 0.55-0.59 | 0.19-0.20 | 0.10 | none |
    | ours, eq. (8) | 0.997 | 0.159 | 0.081 | 1 |

    The order and size of green and blue are those of measured dyes, a quarter below them; red is far above,
    because the paper's sensor records nearly all of the near-infrared there. Coefficients of eq. (8) are what
    an infrared pixel's signal is multiplied by and taken off R, G and B (eq. (7)); they hold exactly for light
    of equal photons in the band, see :func:`ir_crosstalk`.
    """
    clear = 0.58 * _bell(610.0, 221.0, 254.0)
    red = 0.03 + 0.88 * long_pass(592.0, 30.0)
    green = 0.05 + 0.94 * _bell(540.0, 32.0, 36.0) + 0.28 * long_pass(755.0, 120.0)
    blue = 0.05 + 0.90 * _bell(455.0, 45.0, 33.0) + 0.45 * long_pass(805.0, 45.0)
    infrared = 0.95 * long_pass(655.0, 14.0)
    return clear * np.stack([red, green, blue, infrared])


def ir_crosstalk(response: FloatArray) -> FloatArray:
    """Near-infrared crosstalk of R, G and B relative to IR, eq. (8): ratios of areas over 650-810 nm.

    ``response`` is [4, wavelength] in electrons a photon (the paper's f_i), so that the areas are the signals
    of a light with as many photons at each wavelength; returns [3].
    """
    low, high = NEAR_INFRARED_NM
    band = (WAVELENGTH_NM >= low) & (WAVELENGTH_NM <= high)
    areas = np.trapezoid(response[:, band], WAVELENGTH_NM[band], axis=-1)
    return np.asarray(areas)[:3] / np.asarray(areas)[3]
