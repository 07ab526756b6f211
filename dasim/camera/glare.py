"""Veiling glare: light that the sensor scatters back and a reflecting stop returns to it, spread over a wide area.

The coating of a near-infrared disc reflects the light that it does not transmit. Light that has passed the hole and is
scattered back by the sensor hits the coating at the distance s of the lens and returns to the sensor. For a diffusely
scattering sensor and a wide mirror, the light of a point returns at the distance r with the density

    k(r) = 1 / (pi R^2) (1 + r^2 / R^2)^-2,  R = 2 s,

the cos^4 law over the path 2 s. Half of the veil lies within R. Its transfer function is x K_1(x), x = 2 pi R f. The
fraction of the light that takes this path depends on the sensor and the coating, and is a key of the stop
(``glare_share``).
"""

from __future__ import annotations

import numpy as np
from scipy import fft
from scipy.special import k1

from dasim.camera import geometry
from dasim.camera.specification import Camera
from dasim.camera.stops import Stop
from dasim.typing import FloatArray


def radius_px(camera: Camera, stop: Stop) -> float:
    """Radius R within which half of the veil lies, in pixels; twice the image distance by default."""
    radius_mm = stop.glare_radius_mm or 2e3 * geometry.image_distance_m(camera)
    return radius_mm * 1e3 / camera.sensor.pixel_pitch_um


def veil(distance_px: FloatArray, radius: float) -> FloatArray:
    """Share of the veil's light per square pixel, by the distance from the point's image."""
    return np.asarray(1 / (np.pi * radius**2 * (1 + (distance_px / radius) ** 2) ** 2))


def spread(picture: FloatArray, share: float, radius: float) -> FloatArray:
    """A picture [h, w, channel] of which a share is spread over the veil.

    The picture is continued beyond its frame by its mirror image, so that the sum over the frame stays and an even
    picture stays even: of what lies outside the frame nothing is known.
    """
    if share == 0:
        return picture
    fy, fx = (np.arange(count) / (2 * count) for count in picture.shape[:2])
    x = 2 * np.pi * radius * np.hypot(fy[:, None], fx)
    transfer = np.where(x > 0, x * k1(np.where(x > 0, x, 1.0)), 1.0)
    result = np.empty_like(picture)
    for channel in range(picture.shape[-1]):  # one by one: all of a large frame take gigabytes
        mirrored = fft.dctn(picture[..., channel]) * transfer
        result[..., channel] = (1 - share) * picture[..., channel] + share * fft.idctn(mirrored)
    return result
