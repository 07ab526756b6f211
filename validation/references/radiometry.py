"""Electrons of a pixel by quadrature from the data sheet, independent of the simulator's radiometry.

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

WALL_LUX = 500.0  # illuminance of the wall under illuminant A
GLASS_NM, CUTOFF_NM, EDGE_NM = 650.0, 810.0, 8.0  # spectral edges of disc and sensor, and their 10-90 % width
COATING_INDEX = 1.8  # effective index of both coatings


def wall_electrons(camera: Camera, channel: int, column_px: float, row_px: float, ratio: float, side: str) -> float:
    """Electrons per second in a pixel of a camera with da-mobile's filters, from a grey wall through one stop.

    The wall is a grey card under ``WALL_LUX`` of illuminant A. ``channel`` is the index of R, G, B or IR. The pixel
    lies ``column_px`` and ``row_px`` from the optical axis. ``ratio`` is the stop's radius ratio, and ``side`` the band
    that it passes: "open" up to 650 nm, "hole" beyond.

    The irradiance is E = pi L (r/s)^2 cos^4 (Abbe lens) with L = rho E_wall / pi, integrated over wavelength with
    CODATA constants and Planck's law. Off the axis both edges move to lambda_0 sqrt(1 - (sin theta / n)^2).
    """
    lens, sensor = camera.lens, camera.sensor
    image_mm = 1 / (1 / lens.focal_length_mm - 1 / (1e3 * lens.focus_distance_m))
    radius_mm = ratio * lens.focal_length_mm / lens.f_number / 2
    off_axis_mm = np.hypot(column_px, row_px) * sensor.pixel_pitch_um / 1e3
    cosine = image_mm / np.hypot(image_mm, off_axis_mm)
    moved = np.sqrt(1 - (1 - cosine**2) / COATING_INDEX**2)
    glass_nm, cutoff_nm = GLASS_NM * moved, CUTOFF_NM * moved
    lumens = _lumens_of_planck()

    def rate(nm: float) -> float:
        irradiance = WALL_LUX * _planck(nm) / lumens  # W m^-2 nm^-1 on the wall
        reflectance = np.interp(nm, [400, 830], [0.18, 0.185])
        on_pixel = np.pi * (radius_mm / image_mm) ** 2 * cosine**4 * irradiance * reflectance / np.pi
        glass = _edge(nm, glass_nm) if side == "hole" else 1 - _edge(nm, glass_nm)
        photon_j = constants.h * constants.c / (nm * 1e-9)
        efficiency = np.interp(nm, grid.WAVELENGTH_NM, response_curves.rgb_ir_quantum_efficiency()[channel])
        area = (sensor.pixel_pitch_um * 1e-6) ** 2
        passed = lens.transmittance * glass * (1 - _edge(nm, cutoff_nm))
        return float(on_pixel * passed * efficiency / photon_j * area)

    # Gauss-Legendre between the spectral edges: adaptive quadrature converges badly on tabulated curves.
    corners = [400, glass_nm - 10, glass_nm + 10, cutoff_nm - 10, cutoff_nm + 10, 830]
    parts = (integrate.fixed_quad(np.vectorize(rate), a, b, n=60)[0] for a, b in itertools.pairwise(corners))
    return float(sum(parts))


def _planck(nm):  # type: ignore[no-untyped-def]
    """Relative spectral power of illuminant A by Planck's law, CIE 015."""
    return nm**-5.0 / np.expm1(0.01435 / (2848 * nm * 1e-9))


@cache
def _lumens_of_planck() -> float:
    """Luminous flux in lumens of the spectral power :func:`_planck` taken as watts per nanometre."""
    import colour

    v = colour.SDS_LEFS["CIE 1924 Photopic Standard Observer"]
    return float(683.002 * np.trapezoid(v.values * _planck(v.wavelengths), v.wavelengths))


def _edge(nm: float, at: float) -> float:
    """A logistic edge from 0 to 1 at ``at`` nanometres, which rises from 10 % to 90 % over ``EDGE_NM``."""
    return float((1 + np.tanh(np.log(9) * (nm - at) / EDGE_NM)) / 2)
