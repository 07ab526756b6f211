"""Colour (sec. 4.4, 5.2): which light it is, and from linear camera colours to sRGB."""

from __future__ import annotations

from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray

from dasim import illuminants, spectra
from dasim.camera import Camera, response
from dasim.errors import InputError
from dasim.values import PsfBank
from recon.infrared import crosstalk

Float32Array = NDArray[np.float32]
FloatArray = NDArray[np.float64]

DARK_SHARE = 0.02  # of the brightest: darker areas tell little of the light
MINKOWSKI = 4.0  # between grey world (1) and white patch (infinity): "shades of grey", Finlayson and Trezzi 2004
BLOCK_PX = 8  # of the planes: averaging takes noise and clipped points out of the high power
EXPOSED_PERCENTILE = 99.0
EXPOSED_LUMINANCE = 0.9
LUMINANCE = np.array([0.2126, 0.7152, 0.0722])  # of linear sRGB, IEC 61966-2-1


def choose_light(planes: dict[str, NDArray], saturated: NDArray, bank: PsfBank) -> int:
    """Index of the bank's light that fits the raw picture, by automatic white balance (sec. 5.1).

    Minkowski means of the four colour planes [h/2, w/2] over unsaturated blocks, compared with
    ``bank.signature`` in log-chromaticity (R, B and IR against G): infrared tells lamps from daylight.
    """
    mean = np.array([_minkowski(planes[name], saturated) for name in spectra.CHANNELS])
    if not np.all(mean > 0):
        return 0
    green = spectra.CHANNELS.index("G")
    measured = np.log(mean / mean[green])
    known = np.log(np.maximum(bank.signature, np.finfo(np.float32).tiny))
    return int(np.argmin(((known - measured) ** 2).sum(axis=1)))


def _minkowski(plane: NDArray, saturated: NDArray) -> float:
    """(mean x^p)^(1/p) over blocks without saturated pixels; 0 where there is no light."""
    share = (~saturated).astype(np.float32)
    size = (max(plane.shape[1] // BLOCK_PX, 1), max(plane.shape[0] // BLOCK_PX, 1))
    block = cv2.resize(plane.astype(np.float32) * share, size, interpolation=cv2.INTER_AREA)
    whole = cv2.resize(share, size, interpolation=cv2.INTER_AREA) > 1 - 1e-3
    if not whole.any():
        return 0.0
    value = np.maximum(block[whole].astype(np.float64), 0)
    bright = value[value > DARK_SHARE * value.max()]
    return float(np.mean(bright**MINKOWSKI) ** (1 / MINKOWSKI)) if bright.size else 0.0


def colour_matrix(camera: Camera, light: str) -> FloatArray:
    """Matrix [3, 3] from camera electrons without infrared (R, G, B) to linear sRGB under D65.

    Least squares over the 24 reflectances of the ColorChecker, each weighted by 1 / its luminance: responses
    of the camera under the light after eq. (7), against CIE 1931 colours adapted to D65 (Bradford). White
    is kept exactly: a perfect diffuser that gives n green electrons maps to (n, n, n). A light that
    ``dasim.illuminants`` does not know is treated as D65.
    """
    return _colour_matrix(camera.model_dump_json(), light)


@lru_cache(maxsize=64)
def _colour_matrix(camera_json: str, light: str) -> FloatArray:
    camera = Camera.model_validate_json(camera_json)
    try:
        power = illuminants.illuminant(light)
    except InputError:
        power = illuminants.illuminant("D65")
    patches = np.vstack([_colour_checker(), np.ones_like(spectra.WAVELENGTH_NM)])
    electrons = spectra.integrate(patches[:, None, :] * response(camera) * power)
    seen = electrons[:, :3] - crosstalk(camera) * electrons[:, 3:]
    wanted = _linear_srgb(patches * power)
    seen_white, wanted_white = seen[-1], wanted[-1]
    balanced, target = seen[:-1] / seen_white, wanted[:-1] / wanted_white
    weight = 1 / np.maximum(target @ LUMINANCE, DARK_SHARE)[:, None]
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
    return np.stack([np.interp(spectra.WAVELENGTH_NM, sd.wavelengths, sd.values) for sd in table.values()])


def _linear_srgb(power: FloatArray) -> FloatArray:
    """Linear sRGB [n, 3] of spectra [n, wavelength], the last of them the white that is adapted to D65."""
    import colour

    observer = colour.MSDS_CMFS["CIE 1931 2 Degree Standard Observer"]
    curves = [np.interp(spectra.WAVELENGTH_NM, observer.wavelengths, c, right=0.0) for c in observer.values.T]
    xyz = spectra.integrate(power[:, None, :] * np.stack(curves))
    d65 = colour.xy_to_XYZ(colour.CCS_ILLUMINANTS["CIE 1931 2 Degree Standard Observer"]["D65"])
    adapt = colour.adaptation.matrix_chromatic_adaptation_VonKries(xyz[-1] / xyz[-1, 1], d65, transform="Bradford")
    return (xyz / xyz[-1, 1]) @ adapt.T @ colour.RGB_COLOURSPACES["sRGB"].matrix_XYZ_to_RGB.T


def exposure_scale(linear_e: Float32Array, matrix: FloatArray) -> float:
    """Factor from electrons to display light that puts the 99th percentile of luminance at 0.9."""
    luminance = linear_e.reshape(-1, 3) @ (LUMINANCE @ matrix).astype(np.float32)
    bright = float(np.percentile(luminance, EXPOSED_PERCENTILE))
    return EXPOSED_LUMINANCE / bright if bright > 0 else 0.0


def to_srgb(linear_e: Float32Array, matrix: FloatArray, scale: float) -> Float32Array:
    """Display values 0..1 of linear camera colours [h, w, 3]: matrix, exposure, clip, sRGB curve (IEC 61966-2-1)."""
    linear = np.clip(linear_e @ (scale * matrix.T).astype(np.float32), 0, 1)
    curved = np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** np.float32(1 / 2.4) - 0.055)
    return curved.astype(np.float32)
