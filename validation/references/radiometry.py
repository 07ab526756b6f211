"""Electrons of a pixel by quadrature, written out from the data sheet, apart from the simulator's radiometry.

Tested in tests/dasim/render/test_passes.py.
"""

from __future__ import annotations

import itertools
from functools import cache

import numpy as np
from scipy import constants, integrate

from dasim.camera import response_curves
from dasim.camera.specification import Camera
from dasim.spectra import grid

WALL_LUX = 500.0  # of illuminant A
GLASS_NM, CUTOFF_NM, EDGE_NM = 650.0, 810.0, 8.0  # the disc's and the sensor's edges, 10-90 %


def wall_electrons(camera: Camera, channel: int, column_px: float, row_px: float, ratio: float, side: str) -> float:
    """Electrons a second that a channel (R, G, B, IR) of a camera like da-mobile gets from a grey wall.

    The wall is a grey card under ``WALL_LUX`` of illuminant A; the pixel lies ``column_px`` and ``row_px`` from the
    axis; ``ratio`` is the stop's radius over the lens's, ``side`` the light it passes: "open" up to 650 nm, "hole"
    beyond. E = pi L (r/s)^2 cos^4 with L = rho E_wall / pi, integrated over wavelength with CODATA constants and
    Planck's law.
    """
    lens, sensor = camera.lens, camera.sensor
    image_mm = 1 / (1 / lens.focal_length_mm - 1 / (1e3 * lens.focus_distance_m))
    radius_mm = ratio * lens.focal_length_mm / lens.f_number / 2
    off_axis_mm = np.hypot(column_px, row_px) * sensor.pixel_pitch_um / 1e3
    cosine = image_mm / np.hypot(image_mm, off_axis_mm)
    lumens = _lumens_of_planck()

    def rate(nm: float) -> float:
        irradiance = WALL_LUX * _planck(nm) / lumens  # W m^-2 nm^-1 on the wall
        reflectance = np.interp(nm, [400, 830], [0.18, 0.185])
        on_pixel = np.pi * (radius_mm / image_mm) ** 2 * cosine**4 * irradiance * reflectance / np.pi
        glass = _edge(nm, GLASS_NM) if side == "hole" else 1 - _edge(nm, GLASS_NM)
        photon_j = constants.h * constants.c / (nm * 1e-9)
        efficiency = np.interp(nm, grid.WAVELENGTH_NM, response_curves.rgb_ir_quantum_efficiency()[channel])
        area = (sensor.pixel_pitch_um * 1e-6) ** 2
        passed = lens.transmittance * glass * (1 - _edge(nm, CUTOFF_NM))
        return float(on_pixel * passed * efficiency / photon_j * area)

    # Gauss-Legendre between the edges' corners: adaptive quadrature stumbles over tabulated curves.
    corners = [400, 640, 660, 800, 820, 830]
    parts = (integrate.fixed_quad(np.vectorize(rate), a, b, n=60)[0] for a, b in itertools.pairwise(corners))
    return float(sum(parts))


def _planck(nm):  # type: ignore[no-untyped-def]
    return nm**-5.0 / np.expm1(0.01435 / (2848 * nm * 1e-9))  # illuminant A, CIE 015


@cache
def _lumens_of_planck() -> float:
    import colour

    v = colour.SDS_LEFS["CIE 1924 Photopic Standard Observer"]
    return float(683.002 * np.trapezoid(v.values * _planck(v.wavelengths), v.wavelengths))


def _edge(nm: float, at: float) -> float:
    return float((1 + np.tanh(np.log(9) * (nm - at) / EDGE_NM)) / 2)  # 10 % to 90 % over the width
