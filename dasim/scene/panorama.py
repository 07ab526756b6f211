"""Light from all around as panoramas: maps [h, 2h] of luminance over directions, equirectangular.

Columns are azimuths from behind (-180 degrees, left edge) over straight ahead (+z, the middle) to behind again, the
right half lying to the right (+x); rows are elevations from straight up (-y, the top) down. Pixel centres lie at +0.5;
between them luminance is bilinear.

Tested in tests/dasim/render/test_lights.py.
"""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

from dasim.base.errors import InputError
from dasim.scene.lights import Dome, Environment, Ground, Light, Sky, Surrounding, direction
from dasim.spectra.grid import LUMINANCE
from dasim.typing import FloatArray

SKY_ROWS = 256
MOST_ROWS = 1024  # larger images are averaged down to this
_ASPECT = 0.02  # how far from 2:1, over 2
_QUADRATURE_ROWS = 1024  # directions at which a map is integrated


def radiance_per_lux(light: Surrounding, folder: Path) -> FloatArray:
    """Radiance over the irradiance that is the light's level, [h, w] in 1/sr; InputError where an image is bad."""
    if isinstance(light, Dome):
        return np.full((2, 4), 1 / np.pi)
    if isinstance(light, Ground):
        above = (-directions(SKY_ROWS)[..., 1] > 0).astype(np.float64)
        return above[::-1] / irradiance_from_above(above)
    luminance = sky(light) if isinstance(light, Sky) else load(light.image, folder)
    level = irradiance_from_above(luminance)
    if isinstance(light, Environment) and level <= 0:
        raise InputError(f"image '{light.image}': its upper half is black, so that no light falls on level ground")
    return luminance / level


def check(light: Light, folder: Path) -> None:
    """InputError where a light needs an image that is missing or bad."""
    if isinstance(light, Environment):
        radiance_per_lux(light, folder)


def irradiance_from_above(radiance: FloatArray) -> float:
    """Irradiance on a surface that faces straight up, of a panorama in W m^-2 sr^-1: the integral of L cos(theta)."""
    rows = _QUADRATURE_ROWS
    polar = (np.arange(rows, dtype=np.float64) + 0.5) * (np.pi / 2 / rows)
    ring = _rows(radiance, polar).mean(axis=1)  # a row's mean is that of its bilinear curve
    return float(2 * np.pi * np.sum(ring * np.cos(polar) * np.sin(polar)) * (np.pi / 2 / rows))


def _rows(radiance: FloatArray, polar: FloatArray) -> FloatArray:
    """The map's rows at angles from straight up, interpolated; [len(polar), w]."""
    height = len(radiance)
    place = np.clip(polar / np.pi * height - 0.5, 0, height - 1)
    first = np.minimum(place.astype(int), height - 2)
    share = (place - first)[:, None]
    return np.asarray((1 - share) * radiance[first] + share * radiance[first + 1])


def sky(light: Sky) -> FloatArray:
    """Relative luminance of a sky, [h, 2h], 0 below the horizon.

    Overcast: CIE overcast sky (Moon and Spencer 1942), (1 + 2 sin(elevation)) / 3. Clear: CIE standard clear sky
    (Kittler 1967, CIE 22), with chi the angle from the sun and Z its angle from the zenith:
    (0.91 + 10 exp(-3 chi) + 0.45 cos^2 chi) (1 - exp(-0.32 / sin(elevation))), relative to the zenith.
    """
    towards = directions(SKY_ROWS)
    up = -towards[..., 1]
    seen = up > 0
    if light.distribution == "uniform":
        return np.where(seen, 1.0, 0.0)
    if light.distribution == "overcast":
        return np.where(seen, (1 + 2 * up) / 3, 0.0)
    cosine = np.clip(towards @ direction(light.sun_elevation_deg, light.sun_azimuth_deg), -1, 1)
    around = 0.91 + 10 * np.exp(-3 * np.arccos(cosine)) + 0.45 * cosine**2
    return np.where(seen, around * (1 - np.exp(-0.32 / np.maximum(up, 1e-3))), 0.0)


def directions(rows: int) -> FloatArray:
    """Unit vectors in scene coordinates of a panorama's pixel centres, [rows, 2 rows, 3]."""
    azimuth = (np.arange(2 * rows) + 0.5) / (2 * rows) * 2 * np.pi - np.pi
    polar = ((np.arange(rows) + 0.5) / rows * np.pi)[:, None]
    x, z = np.sin(polar) * np.sin(azimuth), np.sin(polar) * np.cos(azimuth)
    return np.stack([x, -np.cos(polar) + 0 * azimuth, z], axis=-1)


def load(image: str, folder: Path) -> FloatArray:
    """Luminance of a panorama beside the scene, [h, w]; EXR and HDR are linear, other pictures sRGB."""
    path = folder / image
    if not path.is_file():
        raise InputError(f"image '{image}': no such file in {folder}")
    values = _exr(path, image) if path.suffix.lower() == ".exr" else _picture(path, image)
    height, width = values.shape[:2]
    if abs(width / height - 2) > 2 * _ASPECT or height < 2:
        raise InputError(f"image '{image}': is {width} x {height}; a panorama is twice as wide as high")
    luminance = values @ np.array(LUMINANCE) if values.ndim == 3 else values
    if not np.isfinite(luminance).all() or luminance.min() < 0:
        raise InputError(f"image '{image}': has pixels that are negative or not finite")
    if luminance.max() <= 0:
        raise InputError(f"image '{image}': is black, a map without light")
    if height > MOST_ROWS:
        luminance = cv2.resize(luminance, (2 * MOST_ROWS, MOST_ROWS), interpolation=cv2.INTER_AREA)
    return luminance


def _picture(path: Path, image: str) -> FloatArray:
    try:
        data = cv2.imread(str(path), cv2.IMREAD_ANYDEPTH | cv2.IMREAD_COLOR)
    except cv2.error:  # more pixels than it takes
        data = None
    if data is None:
        raise InputError(f"image '{image}': {path} cannot be read as a picture (EXR, HDR, PNG or JPEG)")
    colours = data[..., ::-1].astype(np.float64)
    if np.issubdtype(data.dtype, np.floating):
        return colours
    encoded = colours / np.iinfo(data.dtype).max
    return np.where(encoded <= 0.04045, encoded / 12.92, ((encoded + 0.055) / 1.055) ** 2.4)


def _exr(path: Path, image: str) -> FloatArray:
    import OpenEXR

    try:
        channels = OpenEXR.File(str(path)).channels()
    except Exception as error:  # its readers raise whatever they stumble over
        raise InputError(f"image '{image}': {path} cannot be read as EXR ({error})") from None
    for name in ("RGB", "RGBA", "Y"):
        if name in channels:
            return np.asarray(channels[name].pixels[..., :3] if name != "Y" else channels[name].pixels, np.float64)
    raise InputError(f"image '{image}': has channels {', '.join(sorted(channels))}; RGB or Y is needed")


def rotation(light: Surrounding) -> FloatArray:
    """Rotation of a panorama's directions into scene coordinates, [3, 3]: its middle towards the right."""
    angle = np.radians(light.rotation_deg) if isinstance(light, Environment) else 0.0
    cosine, sine = np.cos(angle), np.sin(angle)
    return np.array([[cosine, 0, sine], [0, 1, 0], [-sine, 0, cosine]])
