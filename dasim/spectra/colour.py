"""Conversion of a camera's colours to sRGB: a matrix fitted to the ColorChecker, exposure, and the sRGB curve.

Tested in tests/recon/picture/test_colour.py.
"""

from __future__ import annotations

import numpy as np

from dasim.spectra import colour_checker, grid, observer
from dasim.spectra.grid import LUMINANCE
from dasim.typing import Float32Array, FloatArray

EXPOSED_PERCENTILE = 99.0  # of luminance, which the exposure brings to ...
EXPOSED_LUMINANCE = 0.9  # ... this value
STRIP_ROWS = 256  # rows converted at a time
DARKEST = 0.02  # luminance below which the weight of a patch does not increase

# Linear sRGB from XYZ, and the white of D65 at Y = 1 (IEC 61966-2-1); cone responses from XYZ (Lam 1985, CIE 160:2004).
_SRGB_FROM_XYZ = np.array([[3.2406, -1.5372, -0.4986], [-0.9689, 1.8758, 0.0415], [0.0557, -0.2040, 1.0570]])
_D65_XYZ = np.array([0.3127 / 0.3290, 1.0, (1 - 0.3127 - 0.3290) / 0.3290])
_BRADFORD = np.array([[0.8951, 0.2664, -0.1614], [-0.7502, 1.7135, 0.0367], [0.0389, -0.0685, 1.0296]])


def fitted_matrix(response: FloatArray, power: FloatArray) -> FloatArray:
    """Matrix [3, 3] from electrons (R, G, B) to linear sRGB under D65.

    The matrix is fitted by least squares, weighted by 1 / luminance, to the CIE 1931 colours of the 24 patches of the
    ColorChecker (ISO 17321-1), adapted to D65 by the Bradford transform. White is exact: a perfect diffuser of n green
    electrons maps to (n, n, n).

    Args:
        response: electrons per unit of power, [3, wavelength].
        power: spectral power of the light, [wavelength], at any scale.
    """
    patches = np.vstack([colour_checker.iso_17321_curves(), np.ones_like(grid.WAVELENGTH_NM)])
    electrons = grid.integrate(patches[:, None, :] * response * power)
    srgb = _linear_srgb(patches * power)
    white_electrons, white_srgb = electrons[-1], srgb[-1]
    balanced, target = electrons[:-1] / white_electrons, srgb[:-1] / white_srgb
    weight = 1 / np.maximum(target @ LUMINANCE, DARKEST)[:, None]
    # White is exact if every row sums to 1: two columns are fitted, and the third follows from them.
    difference = weight * (balanced[:, :2] - balanced[:, 2:])
    free, *_ = np.linalg.lstsq(difference, weight * (target - balanced[:, 2:]), rcond=None)
    rows = np.vstack([free, 1 - free.sum(axis=0)]).T
    return rows / (white_electrons / white_electrons[1])


def fitted_from_xyz(response: FloatArray, power: FloatArray) -> FloatArray:
    """Matrix [channel, 3] from CIE 1931 XYZ under a light to electrons of any channels; the largest one of white is 1.

    This is the colour matrix of DNG, fitted by least squares, weighted by 1 / luminance, to the ColorChecker
    (ISO 17321-1) and white. XYZ contains no near-infrared, so the row of an infrared channel predicts the average
    near-infrared reflection of surfaces of a colour.

    Args:
        response: electrons per unit of power, [channel, wavelength].
        power: spectral power of the light, [wavelength], at any scale.
    """
    patches = np.vstack([colour_checker.iso_17321_curves(), np.ones_like(grid.WAVELENGTH_NM)])
    electrons = grid.integrate(patches[:, None, :] * response * power)
    xyz = _tristimulus(patches * power)
    weight = 1 / np.maximum(xyz[:, 1:2], DARKEST)
    columns, *_ = np.linalg.lstsq(weight * xyz, weight * electrons / electrons[-1].max(), rcond=None)
    return np.asarray(columns.T)


def to_srgb_matrix(white_xyz: FloatArray) -> FloatArray:
    """Matrix [3, 3] from XYZ under a light to linear sRGB under D65, by the Bradford transform.

    ``white_xyz`` [3] is a perfect diffuser under the light, of Y = 1.
    """
    cone, sharpened = _BRADFORD @ white_xyz, _BRADFORD @ _D65_XYZ
    adapt = np.linalg.inv(_BRADFORD) @ np.diag(sharpened / cone) @ _BRADFORD
    return np.asarray(_SRGB_FROM_XYZ @ adapt)


def white_xyz(power: FloatArray) -> FloatArray:
    """XYZ [3] of a perfect diffuser under a light of spectral power [wavelength], Y = 1."""
    return np.asarray(_tristimulus(power[None])[0])


def _linear_srgb(power: FloatArray) -> FloatArray:
    """Linear sRGB [n, 3] of spectra [n, wavelength], adapted to D65 from the last spectrum, which is white."""
    xyz = _tristimulus(power)
    return xyz @ to_srgb_matrix(xyz[-1]).T


def _tristimulus(power: FloatArray) -> FloatArray:
    """XYZ [n, 3] of spectra [n, wavelength] by the CIE 1931 observer; the last, which is white, has Y = 1."""
    xyz = observer.tristimulus(power)
    return np.asarray(xyz / xyz[-1, 1])


def exposure_scale(linear_e: Float32Array, matrix: FloatArray) -> float:
    """Factor that brings the 99th percentile of luminance to 0.9; 0 for a black picture.

    ``linear_e`` [..., 3] are electrons, ``matrix`` [3, 3] converts them to linear sRGB.
    """
    luminance = linear_e.reshape(-1, 3) @ (np.array(LUMINANCE) @ matrix).astype(np.float32)
    bright = float(np.percentile(luminance, EXPOSED_PERCENTILE))
    return EXPOSED_LUMINANCE / bright if bright > 0 else 0.0


def to_srgb(linear_e: Float32Array, matrix: FloatArray, scale: float) -> Float32Array:
    """Display values 0..1 of linear camera colours [h, w, 3]: matrix, exposure, clip, sRGB curve (IEC 61966-2-1)."""
    to_linear = (scale * matrix.T).astype(np.float32)
    curved = np.empty(linear_e.shape, np.float32)
    for start in range(0, len(linear_e), STRIP_ROWS):  # limits the memory for large frames
        linear = np.clip(linear_e[start : start + STRIP_ROWS] @ to_linear, 0, 1)
        curve = 1.055 * linear ** np.float32(1 / 2.4) - 0.055
        curved[start : start + STRIP_ROWS] = np.where(linear <= 0.0031308, 12.92 * linear, curve)
    return curved
