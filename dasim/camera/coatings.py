"""Interference coatings: the spectral edges of such filters shift to shorter wavelengths with the angle of incidence.

The edge of a thin-film filter of effective index n lies at lambda(theta) = lambda_0 sqrt(1 - (sin theta / n)^2) for
light at the angle theta to its normal (Macleod, Thin-Film Optical Filters, ch. 8). Here theta is the angle of the chief
ray, which a thin lens does not change, so that it is the same at the disc in the lens and at the filter on the sensor.
The cone of rays around the chief ray, up to 10 degrees at f/2.8, widens the edge of the sensor's filter off the axis;
this is neglected.

Tested in tests/dasim/camera/test_rings.py.
"""

from __future__ import annotations

from typing import Annotated

import numpy as np
from pydantic import AfterValidator

DEFAULT_INDEX = 1.8  # between those of silica (1.46) and titania (2.4), of which such stacks consist
SMALLEST_INDEX, LARGEST_INDEX = 1.2, 4.0


def _allowed(index: float) -> float:
    if index != 0 and not SMALLEST_INDEX <= index <= LARGEST_INDEX:
        raise ValueError(
            f"must be an effective index of {SMALLEST_INDEX:g} to {LARGEST_INDEX:g}, or 0 for edges that do not move, "
            "as those of dyes and absorbing glass"
        )
    return index


Index = Annotated[float, AfterValidator(_allowed)]
"""Effective index of a coating; 0 for edges that stay where they are."""


def edge_factor(index: float, angle_deg: float) -> float:
    """Factor on the wavelengths of a coating's edges for light at an angle, at most 1; 1 for an index of 0."""
    return 1.0 if index == 0 else float(np.sqrt(1.0 - (np.sin(np.radians(angle_deg)) / index) ** 2))
