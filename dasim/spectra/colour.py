"""From a camera's colours to sRGB: a matrix fitted to the ColorChecker, exposure, and the display curve."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from dasim.spectra import grid
from dasim.spectra.grid import LUMINANCE
from dasim.typing import Float32Array, FloatArray

EXPOSED_PERCENTILE = 99.0
EXPOSED_LUMINANCE = 0.9
STRIP_ROWS = 256  # of a picture whose colours are converted at once
DARKEST = 0.02  # luminance below which a patch weighs no more


def fitted_matrix(response: FloatArray, power: FloatArray) -> FloatArray:
    """Matrix [3, 3] from electrons (R, G, B) to linear sRGB under D65.

    ``response`` [3, wavelength] in electrons a watt, ``power`` the spectrum [wavelength] of the light. Least squares
    over the 24 reflectances of the ColorChecker, each weighted by 1 / its luminance, against CIE 1931 colours adapted
    to D65 (Bradford). White is kept exactly: a perfect diffuser that gives n green electrons maps to (n, n, n).
    """
    patches = np.vstack([_colour_checker(), np.ones_like(grid.WAVELENGTH_NM)])
    seen = grid.integrate(patches[:, None, :] * response * power)
    wanted = _linear_srgb(patches * power)
    seen_white, wanted_white = seen[-1], wanted[-1]
    balanced, target = seen[:-1] / seen_white, wanted[:-1] / wanted_white
    weight = 1 / np.maximum(target @ LUMINANCE, DARKEST)[:, None]
    # rows sum to 1, so that white stays white: fit the two free columns against the third
    difference = weight * (balanced[:, :2] - balanced[:, 2:])
    free, *_ = np.linalg.lstsq(difference, weight * (target - balanced[:, 2:]), rcond=None)
    rows = np.vstack([free, 1 - free.sum(axis=0)]).T
    return rows / (seen_white / seen_white[1])


@lru_cache(maxsize=1)
def _colour_checker() -> FloatArray:
    """Reflectances of the 24 patches on the wavelength grid, [24, wavelength], constant beyond the table."""
    import colour

    table = colour.SDS_COLOURCHECKERS["ISO 17321-1"]
    return np.stack([np.interp(grid.WAVELENGTH_NM, sd.wavelengths, sd.values) for sd in table.values()])


def _linear_srgb(power: FloatArray) -> FloatArray:
    """Linear sRGB [n, 3] of spectra [n, wavelength], the last of them the white that is adapted to D65."""
    import colour

    observer = colour.MSDS_CMFS["CIE 1931 2 Degree Standard Observer"]
    curves = [np.interp(grid.WAVELENGTH_NM, observer.wavelengths, c, right=0.0) for c in observer.values.T]
    xyz = grid.integrate(power[:, None, :] * np.stack(curves))
    d65 = colour.xy_to_XYZ(colour.CCS_ILLUMINANTS["CIE 1931 2 Degree Standard Observer"]["D65"])
    adapt = colour.adaptation.matrix_chromatic_adaptation_VonKries(xyz[-1] / xyz[-1, 1], d65, transform="Bradford")
    return (xyz / xyz[-1, 1]) @ adapt.T @ colour.RGB_COLOURSPACES["sRGB"].matrix_XYZ_to_RGB.T


def exposure_scale(linear_e: Float32Array, matrix: FloatArray) -> float:
    """Factor from electrons to display light that puts the 99th percentile of luminance at 0.9."""
    luminance = linear_e.reshape(-1, 3) @ (np.array(LUMINANCE) @ matrix).astype(np.float32)
    bright = float(np.percentile(luminance, EXPOSED_PERCENTILE))
    return EXPOSED_LUMINANCE / bright if bright > 0 else 0.0


def to_srgb(linear_e: Float32Array, matrix: FloatArray, scale: float) -> Float32Array:
    """Display values 0..1 of linear camera colours [h, w, 3]: matrix, exposure, clip, sRGB curve (IEC 61966-2-1)."""
    to_linear = (scale * matrix.T).astype(np.float32)
    curved = np.empty(linear_e.shape, np.float32)
    for start in range(0, len(linear_e), STRIP_ROWS):  # large frames: no second and third copy of the whole
        linear = np.clip(linear_e[start : start + STRIP_ROWS] @ to_linear, 0, 1)
        curve = 1.055 * linear ** np.float32(1 / 2.4) - 0.055
        curved[start : start + STRIP_ROWS] = np.where(linear <= 0.0031308, 12.92 * linear, curve)
    return curved
