"""Zernike polynomials over the open lens, by name, with an RMS of 1 (ANSI Z80.28, ISO 24157; Noll 1976).

Places are ratios of the lens's radius in camera axes, x right and y down; angles run from x towards y. A positive
coefficient has the sign of the defocus of a point nearer than the focus.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import factorial
from typing import Any

import numpy as np
from pydantic import Field

from dasim.base.toml import Specification
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
_GRADIENT_STEP = 1e-4  # of the lens's radius

Coefficients = tuple[float, ...]  # by TERMS


class Wavefront(Specification):
    """Zernike coefficients of the lens in nanometres RMS over its whole opening."""

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
