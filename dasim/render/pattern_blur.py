"""Sampling and weights of wave optics for polygons, masks and aberrated lenses, from tables over the plane.

rho and delta are sampled independently (see :mod:`dasim.render.wave`).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dasim.base.errors import InputError
from dasim.camera import pointspread, stops, wavefront
from dasim.camera.pupil_pattern import pupil_pattern
from dasim.camera.specification import Camera
from dasim.camera.stops import Stop
from dasim.camera.wavefront import Phase, Wavefront
from dasim.render import field_angle, pupil
from dasim.render.blur_tables import (
    FLOOR,
    AberratedRows,
    Drawn,
    aberrated,
    aberrated_slices,
    away_from_axis,
    texel,
    texture,
)
from dasim.spectra import grid
from dasim.typing import FloatArray

PATTERN_TAIL = 12.0  # in lambda N of a disc of the same area
PATTERN_STEP = 0.1  # of the table of h, in lambda N of the whole lens
PATTERN_LARGEST_STEP = 0.25  # half of what the picture's highest frequency needs
PATTERN_WAVES_STEP = 0.05
PATTERN_DENSITY_STEP_PX = 0.15
PATTERN_BLUR_STEP_PX = 0.5
MOST_NODES = 48e6  # most nodes of a three-dimensional table; larger tables use larger steps
MOST_ABERRATED_NODES = 2e9  # most nodes of a table whose steps cannot be increased any further: 8 GB


@dataclass(frozen=True)
class PatternBlur:
    """Tables of a stop in two directions, relative to the image through the middle of the lens."""

    px_per_nm: float  # lambda N of the open lens in pixels per nanometre of lambda
    max_blur_px: float
    max_radius_px: float  # half a side of the tables
    on_stop: pupil.Draw
    offset_cells: Any
    offset_step_px: float
    offset_half_px: float
    density: Any  # [c, y, x] g per square pixel
    density_blur_step_px: float
    wave: Any  # [waves, y, x] h in units of lambda N
    wave_half: float
    waves_step: float
    aberrated: AberratedRows | None = None  # rows of h with aberrations
    turned: bool = False  # h in the frame of the direction away from the axis

    def draw(self, first: Any, second: Any, blur_px: Any, slope: Any, key: Any) -> Drawn:
        """See :class:`Blur`; rho and delta are sampled independently."""
        return self.draw_in_focus(first, second)._replace(rho=self.on_stop(first))

    def draw_in_focus(self, first: Any, second: Any) -> Drawn:
        """See :class:`Blur`."""
        import mitsuba as mi

        cell, _, inside = self.offset_cells.sample(second)
        delta = (mi.Point2f(cell) + inside) * self.offset_step_px - self.offset_half_px
        return Drawn(mi.Point2f(0.0), delta, mi.Float(1.0))

    def weights(self, u_px: Any, blur_px: Any, tangent: Any, wavelengths_nm: list[Any]) -> list[Any]:
        """See :class:`Blur`."""
        import drjit as dr
        import mitsuba as mi

        scale_along = field_angle.scale_along(u_px, tangent)
        u_px, blur_px = scale_along * u_px, scale_along * blur_px
        # Behind the focus the pattern is rotated by 180 degrees.
        u, blur = dr.select(blur_px < 0, -u_px, u_px), dr.abs(blur_px)
        half = self.max_radius_px
        inside = (blur <= self.max_blur_px) & (dr.abs(u.x) < half) & (dr.abs(u.y) < half)
        depth = self.density.shape[0]
        across = mi.Point2f(u / (2 * half) + 0.5)
        g = self.density.eval(mi.Point3f(across.x, across.y, texel(blur, self.density_blur_step_px, depth)))[0]
        depth = self.wave.shape[0]
        ratios = []
        for wavelength in wavelengths_nm:
            scale = wavelength * self.px_per_nm
            if self.aberrated is None:
                across = mi.Point2f(u / (2 * self.wave_half * scale) + 0.5)
                place = mi.Point3f(across.x, across.y, texel(blur / (8 * scale), self.waves_step, depth))
                h = self.wave.eval(place)[0]
            else:
                turned = away_from_axis(u_px, tangent) if self.turned else u_px
                across = mi.Point2f(turned / (2 * self.wave_half * scale) + 0.5)

                def read(row: Any, at: Any = across) -> Any:
                    return self.wave.eval(mi.Point3f(at.x, at.y, (row + 0.5) / depth))

                h = self.aberrated.evaluate(read, blur_px / (8 * scale), wavelength, tangent)
            ratios.append(dr.select(inside & (g > FLOOR), h / (scale * scale * g), 1.0))
        return ratios


def tables(
    camera: Camera, stop: Stop, bands: list[tuple[float, float]], shortest_nm: float, max_blur_px: float
) -> PatternBlur:
    """Tables of a stop of any shape; ``bands`` are wavelengths (nm) with the shares of rays that have them."""
    import mitsuba as mi

    angle_step_deg, fronts = wavefront.over_field(camera, stop)
    px_per_nm = pointspread.working_f_number(camera, 1.0) * 1e-3 / camera.sensor.pixel_pitch_um
    longest_nm = max(nm for nm, _ in bands)
    longest_px, shortest_px = longest_nm * px_per_nm, shortest_nm * px_per_nm
    rings = PATTERN_TAIL / stops.open_area(stop) ** 0.5  # in lambda N of the whole lens
    moved = 2 * max(map(wavefront.steepest, fronts))  # by aberrations, in nanometres times the f-number
    half = stops.reach(stop) * max_blur_px / 2 + rings * longest_px + moved * px_per_nm

    flat = all(wavefront.is_flat(front) for front in fronts)
    waves = np.arange(0.0, max_blur_px / (8 * shortest_px) + 2 * PATTERN_WAVES_STEP, PATTERN_WAVES_STEP)
    wave_half = half / shortest_px
    both_signs = np.concatenate([-waves[:0:-1], waves])
    slices = len(waves) if flat else len(both_signs) * aberrated_slices(fronts, (shortest_nm, longest_nm))
    wave_step = max(PATTERN_STEP, min(2 * wave_half * (slices / MOST_NODES) ** 0.5, PATTERN_LARGEST_STEP))
    wave_count = int(np.ceil(2 * wave_half / wave_step))
    scaled = (np.arange(wave_count) + 0.5) * (2 * wave_half / wave_count) - wave_half
    wave_step = 2 * wave_half / wave_count
    _check_size(camera, slices * wave_count**2)

    blurs = np.arange(0.0, max_blur_px + 2 * PATTERN_BLUR_STEP_PX, PATTERN_BLUR_STEP_PX)
    step = max(PATTERN_DENSITY_STEP_PX, 2 * half * (len(blurs) / MOST_NODES) ** 0.5)
    count = int(np.ceil(2 * half / step))
    step = 2 * half / count
    place = (np.arange(count) + 0.5) * step - half
    focus = _in_focus(stop, fronts, [(nm * px_per_nm, nm, weight) for nm, weight in bands], place)
    density = np.stack([_spread(focus, stop, blur, step) for blur in blurs])

    def kernels(phase: Phase | None, waves: FloatArray) -> Any:
        wave = np.empty((len(waves), wave_count, wave_count), np.float32)
        for row, w in zip(wave, waves, strict=True):
            # As in the tables of rings, the light farther out is added within.
            end = 4 * abs(w) * stops.reach(stop) + rings + moved / shortest_nm
            inside, middle = (_square(scaled, limit) for limit in (end, end - rings / 2))
            pattern = pupil_pattern(stop, w, scaled, scaled, phase) * inside
            if phase is None or phase.opening is None:
                row[:] = pattern / (pattern.sum() * wave_step**2)
                continue
            without_step = pupil_pattern(stop, w, scaled, scaled, phase._replace(opening=None)) * inside
            pattern /= without_step.sum() * wave_step**2
            missing, outer = 1 - pattern.sum() * wave_step**2, np.where(middle, 0.0, pattern)
            row[:] = pattern + outer * (missing / (outer.sum() * wave_step**2))
        return wave

    rows = None
    if flat:
        wave = kernels(None, waves)
    else:
        rows, wave = aberrated(fronts, angle_step_deg, (shortest_nm, longest_nm), both_signs, kernels)
    return PatternBlur(
        px_per_nm=px_per_nm,
        max_blur_px=max_blur_px,
        max_radius_px=half,
        on_stop=pupil.drawer(stop),
        offset_cells=mi.DiscreteDistribution2D(focus.astype(np.float32)),
        offset_step_px=step,
        offset_half_px=half,
        density=texture(np.maximum(density, FLOOR)),
        density_blur_step_px=PATTERN_BLUR_STEP_PX,
        wave=texture(wave, channels=rows is not None),
        wave_half=wave_half,
        waves_step=PATTERN_WAVES_STEP,
        aberrated=rows,
        turned=bool(camera.lens.wavefront_by_field),
    )


def _square(place: FloatArray, limit: float) -> NDArray[np.bool_]:
    """Whether places [y, x] lie within a square about the middle."""
    inside = np.abs(place) <= limit
    return inside[:, None] & inside


def _check_size(camera: Camera, nodes: int) -> None:
    """InputError where a table of aberrated kernels would not fit into memory."""
    if nodes > MOST_ABERRATED_NODES:
        raise InputError(
            f"camera '{camera.name}': the tables of its blur would take {4e-9 * nodes:.0f} GB, "
            f"{4e-9 * MOST_ABERRATED_NODES:.0f} GB are allowed; take smaller coefficients in wavefront_nm or "
            "lens.wavefront_by_field, a smaller frame about the axis, or diffraction 'off'"
        )


def _in_focus(
    stop: Stop, fronts: list[Wavefront], bands: list[tuple[float, float, float]], place_px: FloatArray
) -> FloatArray:
    """Mean pattern in focus, [y, x] per square pixel; ``bands`` are lambda N in pixels, wavelength in nm and weight."""
    flat = all(wavefront.is_flat(front) for front in fronts)
    focus = np.zeros((len(place_px), len(place_px)))
    for scale, nm, weight in bands:
        for front in fronts:
            phase = None if flat else wavefront.phase(front, nm, grid.BAND_NM)
            pattern = pupil_pattern(stop, 0.0, place_px / scale, place_px / scale, phase) / scale**2
            focus += weight * pattern / len(fronts)
    if flat:
        return focus
    # Averaged over quarter turns, because sampling ignores the rotation of the pattern behind the focus and off axis.
    return sum((np.rot90(focus, quarter) for quarter in range(4)), np.zeros_like(focus)) / 4


def _spread(focus: FloatArray, stop: Stop, blur_px: float, step_px: float) -> FloatArray:
    """The in-focus pattern convolved with the geometric blur, a density of unit integral on the same grid."""
    from scipy import signal  # takes half a second to import, and few stops need it

    transmitted, place = stops.pupil(stop)
    reach = int(np.ceil(blur_px / 2 / step_px)) + 2
    at = -place * blur_px / 2 / step_px + reach  # in cells of a small grid about the middle
    low = np.floor(at).astype(int)
    part = at - low
    deposit = np.zeros((2 * reach + 1, 2 * reach + 1))
    for dy, wy in ((0, 1 - part), (1, part)):
        for dx, wx in ((0, 1 - part), (1, part)):
            np.add.at(deposit, (low[:, None] + dy, low[None, :] + dx), transmitted * wy[:, None] * wx[None, :])
    spread = np.asarray(signal.fftconvolve(focus, deposit / deposit.sum(), mode="same"))
    return spread / (spread.sum() * step_px**2)
