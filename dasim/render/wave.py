"""Tables for wave-true defocus: rays drawn from the blur of geometric optics, weighted to that of wave optics.

A ray starts at rho on the stop and leaves through film position x + delta, with delta drawn from the in-focus
diffraction pattern. Where it meets a surface of visible blur c, that point's own image lies at distance u from
x with density g(u; c) = (Airy * disc of c). Wave optics has h(u; c, lambda) there, so the ray's contribution
is weighted by h / g. Exact for surfaces that face the camera; occlusion follows from the real rays.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from scipy.special import j0, j1

from dasim import pointspread, spectra
from dasim.spectra import FloatArray

OFFSET_NODES = 1 << 15  # inverse CDF of delta
TAIL_RINGS = 12.0  # delta is drawn up to this many lambda N (3 % of an Airy pattern's light lies beyond 7)
RADIUS_STEP = 0.05  # of the wave table, in lambda N
WAVES_STEP = 0.02  # of the wave table
DENSITY_STEP_PX = 0.06  # of the density table, along u
DENSITY_BLUR_STEP_PX = 0.25  # of the density table, along c


class WaveTables(NamedTuple):
    """Tables of one stop; u and c in pixels, c the stop's own geometric blur diameter."""

    offset_px: FloatArray  # [OFFSET_NODES] radius of delta at equal steps of probability
    density: FloatArray  # [c, u] g(u; c) per square pixel
    max_blur_px: float
    max_radius_px: float
    wave: FloatArray  # [waves, radius] h in units of lambda N
    max_waves: float
    max_scale_radius: float


def wave_tables(draw: FloatArray, f_number: float, pitch_um: float, max_blur_px: float, min_nm: float) -> WaveTables:
    """Tables for a stop whose wavelengths are drawn with density ``draw`` (on the grid, relative).

    ``f_number`` is the stop's working f-number, ``max_blur_px`` its largest own blur, ``min_nm`` its shortest
    wavelength.
    """
    bands = [(nm, float(weight[0])) for nm, weight in pointspread.bands(draw[None, :])]
    total = sum(weight for _, weight in bands)
    bands = [(nm * 1e-3 * f_number / pitch_um, weight / total) for nm, weight in bands]  # lambda N in pixels
    tail = TAIL_RINGS * max(scale for scale, _ in bands)
    max_radius = max_blur_px / 2 + tail
    radius = np.arange(0.0, max_radius + DENSITY_STEP_PX, DENSITY_STEP_PX)
    blurs = np.arange(0.0, max_blur_px + DENSITY_BLUR_STEP_PX, DENSITY_BLUR_STEP_PX)
    density = sum(weight * pointspread.airy_disc_profile(radius, blurs, scale) for scale, weight in bands)
    min_scale = min_nm * 1e-3 * f_number / pitch_um
    scaled = np.arange(0.0, max_radius / min_scale + RADIUS_STEP, RADIUS_STEP)
    waves = np.arange(0.0, max_blur_px / (8 * min_scale) + WAVES_STEP, WAVES_STEP)
    return WaveTables(
        offset_px=_offsets(bands, tail),
        density=np.maximum(density, 1e-12),
        max_blur_px=float(blurs[-1]),
        max_radius_px=float(radius[-1]),
        wave=pointspread.wave_profile(scaled, waves),
        max_waves=float(waves[-1]),
        max_scale_radius=float(scaled[-1]),
    )


def _offsets(bands: list[tuple[float, float]], tail_px: float) -> FloatArray:
    """Inverse of the encircled energy 1 - J0^2 - J1^2 of the mixed Airy patterns, up to ``tail_px``."""
    radius = np.linspace(0.0, tail_px, 20_000)
    inside = sum(weight * (1 - j0(np.pi * radius / s) ** 2 - j1(np.pi * radius / s) ** 2) for s, weight in bands)
    inside = np.maximum.accumulate(inside / inside[-1])
    return np.interp(np.linspace(0.0, 1.0, OFFSET_NODES), inside, radius)


def shortest_wavelength_nm(draw: FloatArray) -> float:
    """Shortest wavelength that is drawn at all, nm."""
    return float(spectra.WAVELENGTH_NM[np.argmax(draw > 0)])


def weights(tables: dict[str, Any], info: WaveTables, u_px: Any, blur_px: Any, scales_px: list[Any]) -> list[Any]:
    """Ratios h / g for each wavelength (``scales_px``: lambda N in pixels); 1 beyond the tables (geometric blur)."""
    import drjit as dr
    import mitsuba as mi

    def lookup(name: str, x: Any, y: Any) -> Any:
        # Texture coordinates put the first node at half a texel.
        rows, columns = tables[name].shape[0], tables[name].shape[1]
        return tables[name].eval(mi.Point2f((x * (columns - 1) + 0.5) / columns, (y * (rows - 1) + 0.5) / rows))[0]

    g = lookup("density", u_px / info.max_radius_px, blur_px / info.max_blur_px)
    inside = (blur_px <= info.max_blur_px) & (u_px <= info.max_radius_px) & (g > 0)
    ratios = []
    for scale in scales_px:
        h = lookup("wave", u_px / scale / info.max_scale_radius, blur_px / (8 * scale) / info.max_waves)
        ratios.append(dr.select(inside, h / (scale * scale * g), 1.0))
    return ratios
