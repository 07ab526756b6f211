"""Absorption of light in silicon: the absorption coefficient by wavelength, and the absorptance of a layer."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np

from dasim.spectra import grid, tables
from dasim.typing import FloatArray

_TABLE = Path(__file__).parents[1] / "data" / "silicon.csv"


@cache
def absorption_per_um() -> FloatArray:
    """Absorption coefficient of silicon at 300 K on the wavelength grid, 1/um: 4 pi k / lambda (Green 2008).

    Interpolated linearly in its logarithm. The length 1 / alpha is 0.4 um at 450 nm, 1.6 um at 550 nm, 3.6 um at
    650 nm, 6.5 um at 730 nm and 11.8 um at 800 nm.
    """
    nm, extinction = tables.columns(_TABLE).values()
    alpha = 4 * np.pi * extinction / (nm * 1e-3)
    result = np.exp(np.interp(grid.WAVELENGTH_NM, nm, np.log(alpha)))
    result.flags.writeable = False
    return result


def absorptance(thickness_um: float) -> FloatArray:
    """Share of the light entering a layer of silicon that it absorbs, on the wavelength grid: 1 - exp(-alpha d).

    No pixel collects more electrons per photon. Reflection at the surface and light that metal returns through the
    layer are left out.
    """
    return np.asarray(-np.expm1(-absorption_per_um() * thickness_um))
