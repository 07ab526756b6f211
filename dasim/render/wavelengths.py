"""Wavelengths of a pass: how densely they are drawn, and the table that turns a uniform number into one.

Tested in tests/dasim/render/test_passes.py.
"""

from __future__ import annotations

import numpy as np

from dasim.camera import geometry
from dasim.camera.specification import Camera
from dasim.spectra import grid
from dasim.typing import FloatArray

DRAW_NODES = 4096  # of the table that turns a uniform number into a wavelength
EVEN_SHARE = 0.1  # of the wavelengths is drawn as under a light of even spectrum


def draw_density(whole: FloatArray, response: FloatArray, light: FloatArray | None = None) -> FloatArray:
    """Relative density of drawn wavelengths on the grid: the sum over channels of signal over the whole signal.

    A channel that a stop barely reaches gets few samples there, because it needs few.

    Args:
        whole: response [channel, wavelength] of all stops together.
        response: response [channel, wavelength] of the stop.
        light: spectrum on the grid; even if None.
    """
    light = np.ones_like(grid.WAVELENGTH_NM) if light is None else light
    total = grid.integrate(whole * light)
    share = response / np.where(total > 0, total, 1.0)[:, None]
    density = np.sum(share * light, axis=0)
    # Wavelengths that the lights' common spectrum hardly has may still come from one of them.
    even = np.sum(share, axis=0) * light.mean()
    density = (1 - EVEN_SHARE) * density + EVEN_SHARE * even
    density[density < 1e-4 * density.max()] = 0.0
    return density


def draw_table(camera: Camera, response: FloatArray, light: FloatArray, density: FloatArray) -> FloatArray:
    """What depends on a drawn wavelength, at equal steps of probability, [DRAW_NODES, 3 + channel].

    Columns are the wavelength in nm, its focus vergence in 1/m, response / density of each channel, and the light's
    spectrum. The mean of response x light over the rows is its integral, so that an even surface is exact.
    """
    fine = np.linspace(grid.WAVELENGTH_NM[0], grid.WAVELENGTH_NM[-1], 20_001)
    step = fine[1] - fine[0]
    pdf = np.interp(fine, grid.WAVELENGTH_NM, density)
    cdf = np.concatenate([[0.0], np.cumsum((pdf[1:] + pdf[:-1]) / 2 * step)])
    total = cdf[-1]
    nodes = (np.arange(DRAW_NODES) + 0.5) / DRAW_NODES
    wavelength = np.interp(nodes, cdf / total, fine)
    at = np.interp(wavelength, grid.WAVELENGTH_NM, density)
    lit = np.interp(wavelength, grid.WAVELENGTH_NM, light)
    columns = [wavelength, np.interp(wavelength, grid.WAVELENGTH_NM, geometry.focus_vergence(camera))]
    for row in response:
        ratio = np.interp(wavelength, grid.WAVELENGTH_NM, row) * total / at
        mean = (ratio * lit).mean()
        columns.append(ratio * (grid.integrate(row * light) / mean if mean > 0 else 0.0))
    return np.stack([*columns, lit], axis=-1)
