"""Conversion of a camera's colours to sRGB: a matrix fitted to the ColorChecker, exposure, and the sRGB curve.

Tested in tests/recon/picture/test_colour.py.
"""

from __future__ import annotations

import numpy as np

from dasim.spectra import colour_checker, grid
from dasim.spectra.grid import LUMINANCE
from dasim.typing import Float32Array, FloatArray

EXPOSED_PERCENTILE = 99.0
EXPOSED_LUMINANCE = 0.9
STRIP_ROWS = 256  # rows that are converted at once
DARKEST = 0.02  # luminance below which the weight of a patch is constant


def fitted_matrix(response: FloatArray, power: FloatArray) -> FloatArray:
    """Matrix [3, 3] from electrons (R, G, B) to linear sRGB under D65.

    ``response`` [3, wavelength] is in electrons per watt, ``power`` [wavelength] is the spectrum of the light. The fit
    is by least squares over the 24 patches of the ColorChecker, weighted by 1 / luminance, to CIE 1931 colours adapted
    to D65 (Bradford). White is exact: a perfect diffuser of n green electrons maps to (n, n, n).
    """
    patches = np.vstack([colour_checker.iso_17321_curves(), np.ones_like(grid.WAVELENGTH_NM)])
    seen = grid.integrate(patches[:, None, :] * response * power)
    wanted = _linear_srgb(patches * power)
    seen_white, wanted_white = seen[-1], wanted[-1]
    balanced, target = seen[:-1] / seen_white, wanted[:-1] / wanted_white
    weight = 1 / np.maximum(target @ LUMINANCE, DARKEST)[:, None]
    # White is exact if every row sums to 1: fit two columns, the third follows.
    difference = weight * (balanced[:, :2] - balanced[:, 2:])
    free, *_ = np.linalg.lstsq(difference, weight * (target - balanced[:, 2:]), rcond=None)
    rows = np.vstack([free, 1 - free.sum(axis=0)]).T
    return rows / (seen_white / seen_white[1])


def _linear_srgb(power: FloatArray) -> FloatArray:
    """Linear sRGB [n, 3] of spectra [n, wavelength], adapted from the last one, white, to D65."""
    import colour

    observer = colour.MSDS_CMFS["CIE 1931 2 Degree Standard Observer"]
    curves = [np.interp(grid.WAVELENGTH_NM, observer.wavelengths, c, right=0.0) for c in observer.values.T]
    xyz = grid.integrate(power[:, None, :] * np.stack(curves))
    d65 = colour.xy_to_XYZ(colour.CCS_ILLUMINANTS["CIE 1931 2 Degree Standard Observer"]["D65"])
    adapt = colour.adaptation.matrix_chromatic_adaptation_VonKries(xyz[-1] / xyz[-1, 1], d65, transform="Bradford")
    return (xyz / xyz[-1, 1]) @ adapt.T @ colour.RGB_COLOURSPACES["sRGB"].matrix_XYZ_to_RGB.T


def exposure_scale(linear_e: Float32Array, matrix: FloatArray) -> float:
    """Factor from electrons to linear sRGB that brings the 99th percentile of luminance to 0.9."""
    luminance = linear_e.reshape(-1, 3) @ (np.array(LUMINANCE) @ matrix).astype(np.float32)
    bright = float(np.percentile(luminance, EXPOSED_PERCENTILE))
    return EXPOSED_LUMINANCE / bright if bright > 0 else 0.0


def to_srgb(linear_e: Float32Array, matrix: FloatArray, scale: float) -> Float32Array:
    """Display values 0..1 of linear camera colours [h, w, 3]: matrix, exposure, clip, sRGB curve (IEC 61966-2-1)."""
    to_linear = (scale * matrix.T).astype(np.float32)
    curved = np.empty(linear_e.shape, np.float32)
    for start in range(0, len(linear_e), STRIP_ROWS):  # saves memory on large frames
        linear = np.clip(linear_e[start : start + STRIP_ROWS] @ to_linear, 0, 1)
        curve = 1.055 * linear ** np.float32(1 / 2.4) - 0.055
        curved[start : start + STRIP_ROWS] = np.where(linear <= 0.0031308, 12.92 * linear, curve)
    return curved
