"""Optical transfer functions in closed form or by quadrature, as a reference for renders and PSFs.

Tested in tests/validation/references/test_sfr.py.
"""

from __future__ import annotations

from functools import cache

import numpy as np
from scipy.special import j1

from dasim.camera import radiometry
from dasim.camera.specification import Camera
from dasim.spectra import grid
from dasim.typing import FloatArray
from validation.references.paper import STOP_RATIOS

MTF_NM = 4  # wavelength step in nm of the average over the spectrum
OTF_NODES = 300  # Gauss-Legendre nodes of Hopkins's integral: enough for 30 waves of defocus


def hopkins_otf(v: FloatArray, waves: float) -> FloatArray:
    """Incoherent optical transfer function of a defocused circular pupil at v = lambda N f, [v]; 0 beyond v = 1.

    ``v`` is the spatial frequency f over the cut-off frequency 1 / (lambda N), and ``waves`` the defocus W20 at the
    pupil's edge in wavelengths. The OTF is the autocorrelation of the pupil exp(2 pi i W20 rho^2): with s = 2 v the
    shift in pupil radii, 4/pi times the integral over x from 0 to 1 - s/2 of
    sqrt(1 - (x + s/2)^2) cos(4 pi W20 s x). No PSF, and so no truncation of its tails, is involved.

    Source: Hopkins 1955, Proc. R. Soc. A 231, 91.
    """
    t, weight = _unit_nodes()
    half = np.clip(np.asarray(v, dtype=np.float64), 0.0, 1.0)[:, None]
    # x = (1 - s/2)(1 - t^2) turns the square root at the overlap's tip into a smooth function of t
    x = (1 - half) * (1 - t**2)
    chord = np.sqrt(np.maximum(1 - (x + half) ** 2, 0.0))
    return 4 / np.pi * (chord * np.cos(8 * np.pi * waves * half * x) * 2 * t * (1 - half)) @ weight


@cache
def _unit_nodes() -> tuple[FloatArray, FloatArray]:
    """Gauss-Legendre nodes and weights on 0..1."""
    nodes, weights = np.polynomial.legendre.leggauss(OTF_NODES)
    return (nodes + 1) / 2, weights / 2


def disc_transfer(x: FloatArray) -> FloatArray:
    """Transfer function of a uniform disc, 2 J1(pi x) / (pi x), at x = diameter * frequency."""
    safe = np.where(np.abs(x) < 1e-9, 1.0, np.pi * x)
    return np.where(np.abs(x) < 1e-9, 1.0, 2 * j1(safe) / safe)


def pixel_transfer(frequency: FloatArray, angle_rad: float) -> FloatArray:
    """Transfer function of a square pixel at ``frequency`` cycles per pixel in a direction ``angle_rad`` from a row."""
    return np.sinc(frequency * np.cos(angle_rad)) * np.sinc(frequency * np.sin(angle_rad))


def wave_mtf(
    camera: Camera, blur_px: float, spectrum: FloatArray, frequency: FloatArray, angle_deg: float
) -> FloatArray:
    """Signed MTF of optics and pixel for every channel, [channel, frequency], by Hopkins's integral.

    ``blur_px`` is the signed visible blur diameter, ``spectrum`` [wavelength] the light, ``frequency`` is in cycles per
    pixel and ``angle_deg`` its direction from a row. Stops and wavelengths are averaged with their electrons as
    weights.
    """
    lens, pitch_um = camera.lens, camera.sensor.pixel_pitch_um
    image_mm = 1 / (1 / lens.focal_length_mm - 1e-3 / lens.focus_distance_m)
    total, signal = np.zeros((4, len(frequency))), np.zeros(4)
    for stop, ratio in zip(camera.stops, STOP_RATIOS, strict=True):
        f_number = image_mm * lens.f_number / (ratio * lens.focal_length_mm)
        weights = radiometry.stop_response(camera, stop) * spectrum
        used = np.flatnonzero((weights > 1e-6 * weights.max(axis=1, keepdims=True)).any(axis=0))
        for index in used[:: MTF_NM // int(grid.WAVELENGTH_STEP_NM)]:
            scale_px = grid.WAVELENGTH_NM[index] * 1e-3 * f_number / pitch_um
            otf = hopkins_otf(scale_px * frequency, ratio * blur_px / (8 * scale_px))
            total += weights[:, index, None] * otf
            signal += weights[:, index]
    return total / signal[:, None] * pixel_transfer(frequency, np.radians(angle_deg))
