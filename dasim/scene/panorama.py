"""Surrounding light as panoramas: equirectangular maps [h, 2h] of luminance over directions.

Columns are azimuths: -180 degrees (behind) at the left edge, 0 (straight ahead, +z) in the middle, 180 at the right
edge, so that the right half lies to the right (+x). Rows are elevations, from straight up (-y) at the top to straight
down. Pixel centres lie at +0.5; luminance is interpolated bilinearly between them.

Tested in tests/dasim/render/test_lights.py and tests/dasim/scene/test_skies.py.
"""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

from dasim.base import untrusted
from dasim.base.errors import InputError
from dasim.scene.lights import Dome, Environment, Ground, Light, Sky, Surrounding, direction
from dasim.spectra.grid import LUMINANCE
from dasim.typing import FloatArray

SKY_ROWS = 256
MOST_ROWS = 1024  # larger images are reduced to this height by averaging
_ASPECT = 0.02  # relative tolerance of the aspect ratio 2:1
_QUADRATURE_ROWS = 1024  # elevations of the quadrature over the upper hemisphere


def radiance_per_lux(light: Surrounding, folder: Path) -> FloatArray:
    """Panorama [h, w] of radiance per unit of the irradiance that defines the light's level, 1/sr.

    Raises InputError if an image is missing, broken, or black in its upper half.
    """
    if isinstance(light, Dome):
        return np.full((2, 4), 1 / np.pi)
    if isinstance(light, Ground):
        above = (-directions(SKY_ROWS)[..., 1] > 0).astype(np.float64)
        return above[::-1] / irradiance_from_above(above)
    luminance = sky(light) if isinstance(light, Sky) else load(light.image, folder)
    level = irradiance_from_above(luminance)
    if isinstance(light, Environment) and level <= 0:
        raise InputError(f"image '{light.image}': its upper half is black; light must fall on level ground")
    return luminance / level


def check(light: Light, folder: Path) -> None:
    """Raise InputError if a light needs an image that is missing or unusable."""
    if isinstance(light, Environment):
        radiance_per_lux(light, folder)


def irradiance_from_above(radiance: FloatArray) -> float:
    """Irradiance, W m^-2, of a panorama of radiance L, W m^-2 sr^-1, on a surface that faces straight up.

    It is the integral of L cos(theta) over the upper hemisphere, theta being the angle from the zenith.
    """
    rows = _QUADRATURE_ROWS
    polar = (np.arange(rows, dtype=np.float64) + 0.5) * (np.pi / 2 / rows)
    ring = _rows(radiance, polar).mean(axis=1)  # equals the mean of the linear interpolation around the ring
    return float(2 * np.pi * np.sum(ring * np.cos(polar) * np.sin(polar)) * (np.pi / 2 / rows))


def _rows(radiance: FloatArray, polar: FloatArray) -> FloatArray:
    """Rows of a panorama at angles ``polar`` from straight up (radians), interpolated linearly; [len(polar), w]."""
    height = len(radiance)
    place = np.clip(polar / np.pi * height - 0.5, 0, height - 1)
    first = np.minimum(place.astype(int), height - 2)
    share = (place - first)[:, None]
    return np.asarray((1 - share) * radiance[first] + share * radiance[first + 1])


def sky(light: Sky) -> FloatArray:
    """Relative luminance of a sky, [h, 2h], 0 below the horizon.

    The overcast sky is that of the CIE (Moon and Spencer 1942): (1 + 2 sin(elevation)) / 3. The clear sky is the CIE
    standard clear sky (Kittler 1967, CIE 22), up to a constant factor:
    (0.91 + 10 exp(-3 chi) + 0.45 cos^2 chi) (1 - exp(-0.32 / sin(elevation))), with chi the angle from the sun.
    """
    towards = directions(SKY_ROWS)
    up = -towards[..., 1]
    upper = up > 0
    if light.distribution == "uniform":
        return np.where(upper, 1.0, 0.0)
    if light.distribution == "overcast":
        return np.where(upper, (1 + 2 * up) / 3, 0.0)
    cosine = np.clip(towards @ direction(light.sun_elevation_deg, light.sun_azimuth_deg), -1, 1)
    indicatrix = 0.91 + 10 * np.exp(-3 * np.arccos(cosine)) + 0.45 * cosine**2
    return np.where(upper, indicatrix * (1 - np.exp(-0.32 / np.maximum(up, 1e-3))), 0.0)


def directions(rows: int) -> FloatArray:
    """Unit vectors in scene coordinates towards the pixel centres of a panorama, [rows, 2 rows, 3]."""
    azimuth = (np.arange(2 * rows) + 0.5) / (2 * rows) * 2 * np.pi - np.pi
    polar = ((np.arange(rows) + 0.5) / rows * np.pi)[:, None]
    x, z = np.sin(polar) * np.sin(azimuth), np.sin(polar) * np.cos(azimuth)
    return np.stack([x, -np.cos(polar) + 0 * azimuth, z], axis=-1)


def load(image: str, folder: Path) -> FloatArray:
    """Luminance [h, w] of a panorama file in the scene's folder; EXR and HDR are linear, other formats sRGB.

    Raises InputError if the file is missing, unreadable, not 2:1, black, or has negative or non-finite pixels.
    """
    path = folder / image
    if not path.is_file():
        raise InputError(f"image '{image}': no such file in {folder}")
    values = _exr(path, image) if path.suffix.lower() == ".exr" else _picture(path, image)
    height, width = values.shape[:2]
    if abs(width / height - 2) > 2 * _ASPECT or height < 2:
        raise InputError(f"image '{image}': is {width} x {height}; a panorama must be twice as wide as high")
    luminance = values @ np.array(LUMINANCE) if values.ndim == 3 else values
    if not np.isfinite(luminance).all() or luminance.min() < 0:
        raise InputError(f"image '{image}': has pixels that are negative or not finite")
    if luminance.max() <= 0:
        raise InputError(f"image '{image}': is black; a panorama must contain light")
    if height > MOST_ROWS:
        luminance = cv2.resize(luminance, (2 * MOST_ROWS, MOST_ROWS), interpolation=cv2.INTER_AREA)
    return luminance


def _picture(path: Path, image: str) -> FloatArray:
    data = untrusted.picture(path, f"image '{image}': {path}", cv2.IMREAD_ANYDEPTH | cv2.IMREAD_COLOR)
    colours = data[..., ::-1].astype(np.float64)
    if np.issubdtype(data.dtype, np.floating):
        return colours
    encoded = colours / np.iinfo(data.dtype).max
    return np.where(encoded <= 0.04045, encoded / 12.92, ((encoded + 0.055) / 1.055) ** 2.4)


def _exr(path: Path, image: str) -> FloatArray:
    import OpenEXR

    untrusted.check_exr(path, f"image '{image}': {path}")
    try:
        with untrusted.quiet():
            channels = OpenEXR.File(str(path)).channels()
    except Exception as error:  # OpenEXR raises various exception types
        raise InputError(f"image '{image}': {path} cannot be read as EXR ({error})") from None
    for name in ("RGB", "RGBA", "Y"):
        if name in channels:
            return np.asarray(channels[name].pixels[..., :3] if name != "Y" else channels[name].pixels, np.float64)
    raise InputError(f"image '{image}': has channels {', '.join(sorted(channels))}; it must have RGB or Y")


def rotation(light: Surrounding) -> FloatArray:
    """Rotation matrix [3, 3] of a panorama's directions into scene coordinates; its centre moves towards the right."""
    angle = np.radians(light.rotation_deg) if isinstance(light, Environment) else 0.0
    cosine, sine = np.cos(angle), np.sin(angle)
    return np.array([[cosine, 0, sine], [0, 1, 0], [-sine, 0, cosine]])
