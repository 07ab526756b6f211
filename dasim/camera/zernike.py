"""Zernike polynomials over the open lens, by name, with an RMS of 1 (ANSI Z80.28, ISO 24157; Noll 1976).

Places are ratios of the lens's radius in camera axes, x right and y down; angles run from x towards y. A positive
coefficient has the sign of the defocus of a point nearer than the focus.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import factorial
from typing import Any

import numpy as np
from pydantic import Field, model_validator

from dasim.base.toml import Specification
from dasim.spectra.grid import WHOLE_GRID_NM
from dasim.typing import FloatArray

# Radial order n and azimuthal order m; sines for m < 0.
TERMS: dict[str, tuple[int, int]] = {
    "defocus": (2, 0),
    "astigmatism": (2, 2),
    "oblique_astigmatism": (2, -2),
    "coma": (3, 1),
    "vertical_coma": (3, -1),
    "trefoil": (3, 3),
    "oblique_trefoil": (3, -3),
    "spherical": (4, 0),
    "secondary_astigmatism": (4, 2),
    "secondary_coma": (5, 1),
    "secondary_spherical": (6, 0),
}
LARGEST_NM = 500.0  # RMS of a term: beyond, the pupil's grid has too few cells per wave
LARGEST_ANGLE_DEG = 80.0
_GRADIENT_STEP = 1e-4  # of the lens's radius

Coefficients = tuple[float, ...]  # by TERMS


class Wavefront(Specification):
    """Zernike coefficients of a lens, or of the light through one of its stops, in nm RMS over the open lens."""

    defocus: float = Field(default=0.0, ge=-LARGEST_NM, le=LARGEST_NM)
    astigmatism: float = Field(default=0.0, ge=-LARGEST_NM, le=LARGEST_NM)
    oblique_astigmatism: float = Field(default=0.0, ge=-LARGEST_NM, le=LARGEST_NM)
    coma: float = Field(default=0.0, ge=-LARGEST_NM, le=LARGEST_NM)
    vertical_coma: float = Field(default=0.0, ge=-LARGEST_NM, le=LARGEST_NM)
    trefoil: float = Field(default=0.0, ge=-LARGEST_NM, le=LARGEST_NM)
    oblique_trefoil: float = Field(default=0.0, ge=-LARGEST_NM, le=LARGEST_NM)
    spherical: float = Field(default=0.0, ge=-LARGEST_NM, le=LARGEST_NM)
    secondary_astigmatism: float = Field(default=0.0, ge=-LARGEST_NM, le=LARGEST_NM)
    secondary_coma: float = Field(default=0.0, ge=-LARGEST_NM, le=LARGEST_NM)
    secondary_spherical: float = Field(default=0.0, ge=-LARGEST_NM, le=LARGEST_NM)

    def coefficients(self) -> Coefficients:
        """The coefficients in the order of ``TERMS``."""
        return tuple(getattr(self, name) for name in TERMS)


class FieldWavefront(Wavefront):
    """The coefficients at an angle of the chief ray, and at a wavelength if they depend on it.

    Angles in the pupil run from the direction away from the axis, in which the lens has mirror symmetry.
    """

    angle_deg: float = Field(ge=0, le=LARGEST_ANGLE_DEG)
    wavelength_nm: float | None = Field(default=None, ge=WHOLE_GRID_NM[0], le=WHOLE_GRID_NM[1])

    @model_validator(mode="after")
    def _symmetric(self) -> FieldWavefront:
        for name, (_, m) in TERMS.items():
            if getattr(self, name) and (m < 0 or (m > 0 and self.angle_deg == 0)):
                where = "on the axis" if self.angle_deg == 0 else "of a lens with mirror symmetry"
                raise ValueError(f"{name} must be 0 {where}; errors of alignment belong into wavefront_nm")
        return self


def check_table(rows: Sequence[FieldWavefront]) -> None:
    """ValueError unless the rows are a table: angles from 0, each with the same wavelengths, all in rising order."""
    if not rows:
        return
    angles = sorted({row.angle_deg for row in rows})
    wavelengths = sorted({row.wavelength_nm or 0.0 for row in rows})
    places = [(row.angle_deg, row.wavelength_nm or 0.0) for row in rows]
    if angles[0] != 0:
        raise ValueError("angle_deg must begin at 0")
    if places != [(angle, wavelength) for angle in angles for wavelength in wavelengths]:
        raise ValueError("must be a table: rising angle_deg, and for each the same rising wavelength_nm, or none")
    if len(wavelengths) > 1 and wavelengths[0] == 0:
        raise ValueError("wavelength_nm must be in all rows or in none")


def at_angle(rows: Sequence[FieldWavefront], angle_deg: float) -> dict[float, Coefficients]:
    """Coefficients at an angle by wavelength (0 for all), linear between the angles and constant beyond."""
    result = {}
    for wavelength in dict.fromkeys(row.wavelength_nm or 0.0 for row in rows):
        own = [row for row in rows if (row.wavelength_nm or 0.0) == wavelength]
        angles, values = [row.angle_deg for row in own], np.array([row.coefficients() for row in own])
        result[wavelength] = tuple(float(np.interp(angle_deg, angles, column)) for column in values.T)
    return result


def polynomial(n: int, m: int, y: Any, x: Any) -> FloatArray:
    """Z_n^m at places of the pupil, with an RMS of 1 over the unit disc."""
    rho, theta = np.hypot(y, x), np.arctan2(y, x)
    order = abs(m)
    radial = np.zeros_like(rho)
    for k in range((n - order) // 2 + 1):
        share = factorial(n - k) / (factorial(k) * factorial((n + order) // 2 - k) * factorial((n - order) // 2 - k))
        radial = radial + (-1) ** k * share * rho ** (n - 2 * k)
    angular = np.cos(order * theta) if m >= 0 else np.sin(order * theta)
    return np.asarray(np.sqrt((n + 1) * (1 if m == 0 else 2)) * radial * angular)


def evaluate(coefficients: Sequence[float], y: Any, x: Any) -> FloatArray:
    """Sum of the terms at places of the pupil, in the unit of the coefficients."""
    total = np.zeros(np.broadcast(y, x).shape)
    for value, (n, m) in zip(coefficients, TERMS.values(), strict=True):
        if value:
            total = total + value * polynomial(n, m, y, x)
    return total


def gradient(coefficients: Sequence[float], y: Any, x: Any) -> tuple[FloatArray, FloatArray]:
    """Slope of the sum along y and x, per radius of the lens; central differences of polynomials."""
    h = _GRADIENT_STEP
    along_y = evaluate(coefficients, y + h, x) - evaluate(coefficients, y - h, x)
    along_x = evaluate(coefficients, y, x + h) - evaluate(coefficients, y, x - h)
    return along_y / (2 * h), along_x / (2 * h)


def is_radial(coefficients: Sequence[float]) -> bool:
    """Whether only terms of rotational symmetry are present."""
    return all(value == 0 or m == 0 for value, (_, m) in zip(coefficients, TERMS.values(), strict=True))
