"""Stops of the lens: each a shape in the pupil and a spectral transmittance.

Light through different stops adds: a glass disc that blocks the near-infrared outside a hole is the
open lens with the disc's transmittance, plus the hole with its complement. (Inside the few nanometres
of the coating's edge, where both stops pass light of one wavelength, the sum neglects their interference.)
"""

from __future__ import annotations

from typing import Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from dasim import spectra


class Stop(BaseModel):
    """A centred disc of the pupil that passes one side of a spectral edge."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    name: str
    shape: Literal["disc"] = "disc"
    radius_ratio: float = Field(gt=0, le=1, description="radius over that of the open lens")
    passes: Literal["all", "below", "above"] = "all"
    edge_nm: float = Field(default=650.0, ge=400, le=830)
    edge_width_nm: float = Field(default=8.0, gt=0, le=100, description="10-90 % width of the edge")


def transmittance(stop: Stop) -> spectra.FloatArray:
    """Spectral transmittance of the stop's open area on ``spectra.WAVELENGTH_NM``, 0..1."""
    if stop.passes == "below":
        return spectra.short_pass(stop.edge_nm, stop.edge_width_nm)
    if stop.passes == "above":
        return spectra.long_pass(stop.edge_nm, stop.edge_width_nm)
    return np.ones_like(spectra.WAVELENGTH_NM)


def light_loss(reductions: list[tuple[int, float]], pixels: int) -> float:
    """Share of light lost to smaller apertures, eq. (1): sum of n_k (1 - alpha_k^2) over ``pixels``.

    ``reductions`` holds (n_k, alpha_k): the pixels of the mosaic that see the k-th aperture and its
    radius relative to the lens. The formula assumes equal signals, disjoint colours and no crosstalk.
    """
    return sum(count * (1.0 - alpha**2) for count, alpha in reductions) / pixels
