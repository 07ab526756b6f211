"""The radial tables of a disc or ring that :mod:`dasim.render.radial_blur` samples and weights rays with.

Tested in tests/dasim/render/test_radial_blur.py.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy import ndimage
from scipy.special import j1

from dasim.camera import pointspread, radial_pattern, stops, wavefront
from dasim.camera.specification import Camera
from dasim.camera.stops import Stop
from dasim.camera.wavefront import Wavefront
from dasim.render.blur_tables import FLOOR, AberratedRows, aberrated, cut_off, light, texture
from dasim.render.plugin import aligned
from dasim.render.radial_blur import (
    DENSITY_BLUR_STEP_PX,
    DENSITY_STEP_PX,
    GUIDE_NODES,
    KERNEL_RINGS,
    OFFSET_NODES,
    RADIUS_STEP,
    TAIL_RINGS,
    WAVES_STEP,
    Plain,
    RadialBlur,
)
from dasim.typing import FloatArray

GUIDE_SHARE = 0.75  # of h in q; the rest is g, which bounds the weights of rays that meet another depth
TAIL_BOOST = 0.25  # relative increase of q per width of D outside the blur: little light, but from other surfaces
GUIDE_BANDS = 8  # wavelengths that represent h in q
NEARBY = 0.2  # largest relative difference of the wavelengths of :func:`over_wavelengths`
NEARBY_STEPS = 21  # wavelengths over that range: rings of the pattern are averaged up to the fiftieth


def tables(
    camera: Camera, stop: Stop, bands: list[tuple[float, float]], shortest_nm: float, max_blur_px: float
) -> RadialBlur:
    """Tables of a disc or ring; ``bands`` are wavelengths (nm) with the shares of rays that have them."""
    import drjit as dr
    import mitsuba as mi

    ring = stops.ring(stop)
    assert ring is not None
    inner = ring.inner / ring.outer
    px_per_nm = pointspread.working_f_number(camera, ring.outer) * 1e-3 / camera.sensor.pixel_pitch_um
    scales = [(nm * px_per_nm, weight) for nm, weight in bands]
    own_px = ring.outer * max_blur_px
    tail = TAIL_RINGS * max(scale for scale, _ in scales)
    reach = 0.9 * tail
    radius = np.arange(0.0, own_px / 2 + tail + DENSITY_STEP_PX, DENSITY_STEP_PX)
    blurs = np.arange(0.0, own_px + 2 * DENSITY_BLUR_STEP_PX, DENSITY_BLUR_STEP_PX)
    density = radial_pattern.mixed_airy_profile(radius, blurs, scales, inner)
    shortest_px = shortest_nm * px_per_nm
    scaled = np.arange(0.0, radius[-1] / shortest_px + 2 * RADIUS_STEP, RADIUS_STEP)
    waves = np.arange(0.0, own_px / (8 * shortest_px) + 2 * WAVES_STEP, WAVES_STEP)
    density = np.maximum(density, FLOOR)
    (angle_step_deg, fronts), rows = wavefront.over_field(camera, stop), None
    averaged = None
    if all(wavefront.is_flat(front) for front in fronts):
        table = wave = cut_off(radial_pattern.wave_profile(scaled, waves, inner), scaled, 4 * waves + KERNEL_RINGS)
        averaged = over_wavelengths(wave, scaled).astype(np.float32)
    else:
        range_nm = shortest_nm, max(nm for nm, _ in bands)
        rows, table = _aberrated(fronts, angle_step_deg, ring, range_nm, scaled, waves)
        by_wavelength = table[..., 0].reshape(-1, 2 * len(waves) - 1, len(scaled)).mean(axis=0, dtype=np.float64)
        wave = (by_wavelength[len(waves) - 1 :] + by_wavelength[len(waves) - 1 :: -1]) / 2  # of either sign of defocus

    def number(value: float) -> Any:
        return dr.opaque(mi.Float, float(value))

    lengths = np.arange(0.0, tail + 2 * DENSITY_STEP_PX, DENSITY_STEP_PX)
    offsets, light_inside = _offsets(scales, tail, inner, lengths)
    core = 2 * float(np.average([scale for scale, _ in scales], weights=[weight for _, weight in scales]))
    return RadialBlur(
        outer=number(ring.outer),
        centre=mi.Point2f(number(ring.centre[0]), number(ring.centre[1])),
        px_per_nm=number(px_per_nm),
        max_blur_px=number(own_px),
        max_radius_px=number(radius[-1]),
        inner=number(inner),
        tail_px=number(tail),
        core_px=number(core),
        rows=dr.opaque(mi.UInt32, len(blurs)),
        columns=dr.opaque(mi.UInt32, len(radius)),
        wave_rows=dr.opaque(mi.UInt32, len(table)),
        wave_columns=dr.opaque(mi.UInt32, len(scaled)),
        offsets=mi.Float(aligned(offsets)),
        light_inside=texture(light_inside),
        light_columns=dr.opaque(mi.UInt32, len(lengths)),
        density=texture(density),
        envelope=texture(np.maximum.accumulate(density[0, ::-1])[::-1]),
        guide=mi.Float(aligned(_guide(radius, blurs, density, wave, scales, reach, inner))),
        wave=texture(table, channels=rows is not None),
        averaged=None if averaged is None else texture(averaged),
        plain=Plain(wave.astype(np.float32), averaged, px_per_nm, ring.outer, ring.centre, core),
        aberrated=rows,
    )


def over_wavelengths(profiles: FloatArray, radius: FloatArray) -> FloatArray:
    """Profiles [waves, radius] averaged over wavelengths that differ by up to ``NEARBY``, of unit integral.

    Radius and defocus are in units of the wavelength: at 1 + e times the wavelength, the profile is that at both over
    1 + e, over (1 + e)^2.
    """
    total = np.zeros_like(profiles)
    rows, columns = (np.arange(length) for length in profiles.shape)
    for step in range(NEARBY_STEPS):
        longer = 1 + NEARBY * ((2 * step + 1) / NEARBY_STEPS - 1)
        at = _between(_between(profiles, rows / longer, 0), columns / longer, 1)
        total += at / longer**2
    return total / light(total, radius)


def _between(values: FloatArray, place: FloatArray, axis: int) -> FloatArray:
    """Values at fractional indices along an axis, linear between nodes; those at the end beyond it."""
    last = values.shape[axis] - 1
    node = np.minimum(place.astype(int), max(last - 1, 0))
    share = np.minimum(place - node, 1.0)
    share = share[:, None] if axis == 0 else share
    before, after = (np.take(values, np.minimum(index, last), axis=axis) for index in (node, node + 1))
    return np.asarray(before + share * (after - before))


def _aberrated(
    fronts: list[Wavefront],
    angle_step_deg: float,
    ring: stops.Ring,
    range_nm: tuple[float, float],
    radius: FloatArray,
    waves: FloatArray,
) -> tuple[AberratedRows, FloatArray]:
    """The table of h of a disc or ring whose wavefront has aberrations; ``waves`` are one side's, from 0."""
    moved = 2 * max(map(wavefront.steepest, fronts)) * ring.outer / range_nm[0]  # in lambda N of the stop

    def end(waves: FloatArray) -> FloatArray:
        return 4 * np.abs(waves) + KERNEL_RINGS + moved

    def kernels(phase: wavefront.Phase, waves: FloatArray) -> FloatArray:
        inner, turns = ring.inner / ring.outer, phase._replace(opening=None)
        profiles = radial_pattern.wave_profile(radius, waves, inner, turns, ring.outer)
        if phase.opening is None:
            return cut_off(profiles, radius, end(waves))
        stepped = radial_pattern.wave_profile(radius, waves, inner, phase, ring.outer)
        return cut_off(stepped, radius, end(waves), KERNEL_RINGS, like=profiles)

    return aberrated(fronts, angle_step_deg, range_nm, np.concatenate([-waves[:0:-1], waves]), kernels)


def _guide(
    radius: FloatArray,
    blurs: FloatArray,
    density: FloatArray,
    wave: FloatArray,
    scales: list[tuple[float, float]],
    reach_px: float,
    inner: float,
) -> FloatArray:
    """Radii |u| at equal steps of probability of q, a mixture of g and h at some wavelengths, [c, GUIDE_NODES + 1]."""
    chosen = scales[:: max(1, len(scales) // GUIDE_BANDS)]
    total = sum(weight for _, weight in chosen)
    pattern = np.zeros_like(density)
    for scale, weight in chosen:
        rows = blurs / (8 * scale) / WAVES_STEP
        columns = radius / scale / RADIUS_STEP
        grid = np.meshgrid(rows, columns, indexing="ij")
        pattern += weight / total * ndimage.map_coordinates(wave, grid, order=1, mode="nearest") / scale**2
    # Short of the end of D, where hardly any rho is possible.
    nearest, farthest = inner * blurs[:, None] / 2 - reach_px, blurs[:, None] / 2 + reach_px
    near = (radius[None, :] >= nearest) & (radius[None, :] <= farthest)
    core = float(np.average([scale for scale, _ in chosen], weights=[weight for _, weight in chosen]))
    outside = np.maximum(radius[None, :] - blurs[:, None] / 2, 0.0) / core
    q = (GUIDE_SHARE * pattern + (1 - GUIDE_SHARE) * density) * (1 + TAIL_BOOST * outside)
    q = np.where(near, q, 0.0)
    ring = np.pi * np.diff(radius**2)
    inside = np.concatenate([np.zeros((len(blurs), 1)), np.cumsum((q[:, 1:] + q[:, :-1]) / 2 * ring, axis=1)], axis=1)
    steps = np.linspace(0.0, 1.0, GUIDE_NODES + 1)
    radii = np.stack([np.interp(steps, row / row[-1], radius) for row in inside])
    return np.clip(radii, np.maximum(nearest, 0.0), farthest)


def _offsets(
    scales: list[tuple[float, float]], tail_px: float, inner: float, lengths: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Radii |delta| at equal steps of the light of the in-focus pattern D up to ``tail_px``, and the inverse.

    D is the mean over ``scales`` (lambda N in pixels, weight). The radii are [OFFSET_NODES]; the inverse is the share
    of light within each of ``lengths``.
    """
    radius = np.linspace(0.0, tail_px, 1 << 16)
    middle = (radius[1:] + radius[:-1]) / 2

    def lobe(x: FloatArray) -> FloatArray:
        return np.where(x < 1e-9, 0.5, j1(x) / np.maximum(x, 1e-9))

    light = np.zeros_like(middle)
    for scale, weight in scales:
        x = np.pi * middle / scale
        light += weight * (lobe(x) - inner**2 * lobe(inner * x)) ** 2 / (scale**2 * (1 - inner**2)) * middle
    inside = np.concatenate([[0.0], np.cumsum(light)])
    inside /= inside[-1]
    return np.interp(np.linspace(0.0, 1.0, OFFSET_NODES), inside, radius), np.interp(lengths, radius, inside)
