"""Irradiance from extended sources and from other surfaces, interpolated where it is smooth (JIT variants).

The irradiance of a Lambertian surface by the sky and by its surroundings changes little from pixel to pixel, and
accounts for most of the cost and the noise of a picture. It is traced once on a grid of points that the lens sees, with
many directions each, and interpolated: Ward, Rubinstein and Clear, "A ray tracing solution for diffuse
interreflection", SIGGRAPH 1988. Lamps are excluded: every ray samples them where it lands, so that shadows are sharp
(:mod:`dasim.render.lamps`).

Over wavelength, irradiance is smooth only relative to the spectrum of its source. Each distinct spectrum therefore has
its own grid; all grids share the rays.

A ray uses the corners of its cell that lie on its surface. Between four that receive nearly the same, linear
interpolation is accurate to a fraction of that. Beside steps in depth and creases, where fewer are left, each must
agree with the nodes around it. In both cases, corners must be near by Ward's measure: not far from the point for the
distance of the surroundings, which is short beneath objects. Elsewhere, and on surfaces that are not Lambertian, rays
are traced by a path tracer. The claim ``interreflection`` compares pictures with those of the path tracer alone.

Tested in tests/dasim/render/test_irradiance.py and tests/dasim/render/test_passes.py.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from dasim.render import backend, light_spectra
from dasim.render.frozen import frozen
from dasim.render.irradiance_nodes import agreeing_cells, clamped, even_nodes, smoothed
from dasim.render.lamps import Cell, Grid, from_all_around, grid_of
from dasim.render.light_paths import power_heuristic, radiance_by_light
from dasim.render.light_spectra import NODES, Shares
from dasim.render.plugin import texture
from dasim.render.sobol import Sobol, points
from dasim.spectra import grid
from dasim.typing import FloatArray

STRIDE_PX = 3.0
TILE = 4  # nodes along each side of a square whose directions are stratified together
SAME_PLANE = 5e-3  # distance of a point from the plane of a node, over its depth
# Largest error that is expected of a node: its distance over that of the surroundings, plus the turn between normals
# (Ward et al., eq. 4). Where all four corners of a cell are used, first orders cancel.
BETWEEN_ERROR, BEYOND_ERROR = 0.5, 0.3
LEAST_SHARE = 1e-3  # of the corners that are used, in the interpolation between all four
ON_SURFACE, ON_SURFACE_TURN = 1e-3, 2e-5  # relative change of 1/z and of the cosine (0.4 degrees) for lamps
DIRECTIONS_PER_SAMPLE = 4  # directions of a point per sample of a pixel
FEWEST_DIRECTIONS, MOST_DIRECTIONS = 64, 1024


@dataclass(frozen=True)
class Field:
    """Irradiance over each light's spectrum on a grid of film positions, seen from the middle of the lens."""

    start_px: tuple[float, float]  # of the first node, from the axis
    px_per_m: float
    shape: tuple[int, int]  # nodes, [y, x]
    ratio: Any  # flat [y, x, wavelength, light]: irradiance of each light over its spectrum
    surface: Any  # flat [y, x, (1/z, normal, mean inverse distance of the surroundings in 1/m)]
    usable: Any  # flat cells, 1 where corners agree
    even: Any  # flat nodes, 1 where light agrees with that of the neighbours on the same surface
    light: FloatArray  # spectrum of all lights together, on the wavelength grid
    spectra: Any  # of each light as a texture over wavelength
    spectrum_nodes: int  # of that texture
    share: float  # of the cells that are usable
    lamps: Grid | None  # None where every ray draws one emitter

    def at(self, si: Any, active: Any) -> tuple[Any, Any, Cell]:
        """Spectral irradiance at a surface point, W m^-2 nm^-1, where it is known, and the cell of the grid."""
        import drjit as dr
        import mitsuba as mi

        rows, columns = (dr.opaque(mi.UInt32, extent) for extent in self.shape)
        start, scale = [dr.opaque(mi.Float, value / STRIDE_PX) for value in self.start_px], self.px_per_m / STRIDE_PX
        scale = dr.opaque(mi.Float, scale)
        x, y = (at / si.p.z * scale - first for at, first in zip((si.p.x, si.p.y), start, strict=True))
        inside = active & (x >= 0) & (y >= 0) & (x < mi.Float(columns - 1)) & (y < mi.Float(rows - 1))
        column, row = mi.UInt32(dr.select(inside, x, 0.0)), mi.UInt32(dr.select(inside, y, 0.0))
        cell = row * (columns - 1) + column
        along = mi.Point2f(x - mi.Float(column), y - mi.Float(row))
        facing, corners = _towards_camera(si), []
        vergence, normal, seen = mi.Float(0.0), mi.Vector3f(0.0), mi.Float(0.0)
        whole, even = mi.Bool(inside), mi.Bool(inside)
        for right, below in ((0, 0), (1, 0), (0, 1), (1, 1)):
            node = (row + below) * columns + column + right
            share = (along.x if right else 1 - along.x) * (along.y if below else 1 - along.y)
            own, *towards, near = (dr.gather(mi.Float, self.surface, 5 * node + index, inside) for index in range(5))
            towards = mi.Vector3f(*towards)
            vergence, normal = dr.fma(share, own, vergence), normal + share * towards
            slope = mi.Point2f(mi.Float(column + right) + start[0], mi.Float(row + below) + start[1]) / scale
            offset = si.p - mi.Vector3f(slope.x, slope.y, 1.0) / own
            same = (own > 0) & (dr.abs(dr.dot(offset, towards)) < SAME_PLANE * si.p.z)
            turn = dr.safe_sqrt(1 - dr.dot(facing, towards))
            error = dr.norm(offset) * near + turn
            whole &= same & (error < BETWEEN_ERROR)
            same &= turn < BEYOND_ERROR
            is_even = dr.gather(mi.UInt32, self.even, node, inside) > 0
            even &= ~same | (is_even & (error < BEYOND_ERROR))
            seen += dr.select(same, share, 0.0)
            corners.append((node, share, same))
        whole &= dr.gather(mi.UInt32, self.usable, cell, inside) > 0
        away, aligned = dr.abs(vergence * si.p.z - 1), dr.dot(facing, dr.normalize(normal))
        on_surface = whole & (away < ON_SURFACE) & (aligned > 1 - ON_SURFACE_TURN)
        known = whole | (even & (seen > LEAST_SHARE))
        parts = [(node, dr.select(whole, share, dr.select(same, share / seen, 0.0))) for node, share, same in corners]
        place = Cell(cell, row * columns + column, along, columns, on_surface)
        return self._irradiance(parts, si.wavelengths, known), known, place

    def _irradiance(self, parts: list[tuple[Any, Any]], wavelengths: Any, active: Any) -> Any:
        """Spectral irradiance of some nodes by their shares."""
        import drjit as dr
        import mitsuba as mi

        result = mi.Spectrum(0.0)
        for k in range(4):
            at = (wavelengths[k] - float(grid.WAVELENGTH_NM[0])) / _SPAN_NM
            lit = self.spectra.eval(mi.Point1f((at * (self.spectrum_nodes - 1) + 0.5) / self.spectrum_nodes), active)
            place = dr.clip(at, 0.0, 1.0) * (NODES - 1)
            first = dr.minimum(mi.UInt32(place), NODES - 2)
            along = place - mi.Float(first)
            for light, power in enumerate(lit):
                ratio = mi.Float(0.0)
                for node, share in parts:
                    index = (node * NODES + first) * len(lit) + light
                    low, high = (dr.gather(mi.Float, self.ratio, index + step, active) for step in (0, len(lit)))
                    ratio = dr.fma(share, dr.fma(along, high - low, low), ratio)
                result[k] = dr.fma(ratio, power, result[k])
        return result


_SPAN_NM = float(grid.WAVELENGTH_NM[-1] - grid.WAVELENGTH_NM[0])


def lambertian(bsdf: Any) -> Any:
    """Whether a surface is a Lambertian reflector and transmits nothing, for each ray."""
    import mitsuba as mi

    flags, kinds = bsdf.flags(), mi.BSDFFlags
    other = kinds.Glossy | kinds.Delta | kinds.Delta1D | kinds.DiffuseTransmission | kinds.Null
    return mi.has_flag(flags, kinds.DiffuseReflection) & ((flags & int(other)) == 0)


def field(
    scene: Any,
    integrator: Any,
    *,
    size_px: tuple[int, int],
    axis_px: tuple[float, float],
    px_per_m: float,
    margin_px: float,
    spectrum: FloatArray,
    spp: float,
    seed: int,
) -> Field:
    """Trace the irradiance on a grid over the frame and a margin around it.

    Args:
        scene: a Mitsuba scene.
        integrator: continues paths, see :func:`dasim.render.transport.path_integrator`.
        size_px: width and height of the frame.
        axis_px: where the optical axis meets the sensor, from the frame's corner.
        px_per_m: pixels on the sensor per metre at a distance of one metre.
        margin_px: width of the margin.
        spectrum: of all lights together, on the wavelength grid. Wavelengths are drawn by it; where all emitters have
            one spectrum, it carries the spectral lines, which the ``NODES`` wavelengths of the field do not resolve.
        spp: samples per pixel of the picture, to which the number of directions is matched.
        seed: of the directions.
    """
    import drjit as dr
    import mitsuba as mi

    width, height = size_px
    start = tuple(-(axis + margin_px) for axis in axis_px)
    columns, rows = (int(np.ceil((extent + 2 * margin_px) / STRIDE_PX)) + 1 for extent in (width, height))
    directions = int(np.clip(DIRECTIONS_PER_SAMPLE * spp, FEWEST_DIRECTIONS, MOST_DIRECTIONS))
    directions = 1 << int(np.log2(directions))
    lights = light_spectra.lights_of(scene)
    floor = light_spectra.above_zero(spectrum)
    spectra, at_nm = floor[None], grid.WAVELENGTH_NM
    if len(lights.spectra) > 1 or not light_spectra.on_grid(lights.spectra[0], floor):
        spectra = np.stack([light_spectra.above_zero(curve) for curve in lights.spectra])
        at_nm = light_spectra.FINE_NM
    lit = np.stack([np.interp(light_spectra.nodes_nm(), at_nm, curve) for curve in spectra])
    shares = lights.shares()
    count = rows * columns
    received = np.zeros((count, *lit.shape))
    met = np.zeros((count, 6))
    at_once, traced = max(1, backend.lanes() // directions), frozen(_trace_points)
    across, each = dr.opaque(mi.UInt32, columns), dr.opaque(mi.UInt32, directions)
    corner = mi.Point2f(*(dr.opaque(mi.Float, value) for value in start))
    scale, tile = dr.opaque(mi.Float, px_per_m), dr.opaque(mi.UInt32, TILE)
    sobol_key = dr.opaque(mi.UInt32, np.random.SeedSequence((seed,)).generate_state(1)[0])
    for first in range(0, count, at_once):
        part = slice(first, min(first + at_once, count))
        size = part.stop - part.start
        index = dr.arange(mi.UInt32, size * directions) // each + dr.opaque(mi.UInt32, first)
        row = index // across
        column = index - row * across
        film = mi.Point2f(mi.Float(column), mi.Float(row)) * STRIDE_PX + corner
        key = mi.UInt32(np.random.SeedSequence((seed, first)).generate_state(1))
        stratum = in_tile(row, column), sobol_key + (row // tile) * across + column // tile
        rays = _Rays(film / scale, *stratum, points(TILE**2 * directions), dr.opaque(mi.UInt32, key[0]))
        values, geometry = _traced(traced, (scene, integrator, shares), rays, directions)
        received[part] = values[:, : len(lit)] / lit
        met[part] = geometry
    grid_y, grid_x = np.mgrid[:rows, :columns] * STRIDE_PX
    slopes = np.column_stack([(grid_x + start[0]).ravel(), (grid_y + start[1]).ravel()]) / px_per_m
    ratio, surface = received.reshape(rows, columns, *lit.shape), met.reshape(rows, columns, 6)
    ratio = smoothed(ratio, surface, spectra, STRIDE_PX / px_per_m)
    usable = agreeing_cells(ratio, surface, spectra)
    surface[..., 5] = clamped(surface, slopes.reshape(rows, columns, 2))
    empty = lights.slots - len(spectra) if len(spectra) > 1 else 0
    ratio = np.pad(ratio, ((0, 0), (0, 0), (0, empty), (0, 0)))
    return Field(
        start_px=(start[0], start[1]),
        px_per_m=px_per_m,
        shape=(rows, columns),
        ratio=mi.Float(np.moveaxis(ratio, -1, -2).astype(np.float32).ravel()),
        surface=mi.Float(surface[..., [0, 1, 2, 3, 5]].astype(np.float32).ravel()),
        usable=mi.UInt32(usable.ravel().astype(np.uint32)),
        even=mi.UInt32(even_nodes(ratio, surface, spectra).ravel().astype(np.uint32)),
        light=floor,
        spectra=texture(np.pad(spectra.T, ((0, 0), (0, empty)))),
        spectrum_nodes=len(at_nm),
        share=float(usable.mean()),
        lamps=grid_of(scene, slopes, met[:, :5], (rows, columns), seed),
    )


def _towards_camera(si: Any) -> Any:
    import drjit as dr

    normal = si.sh_frame.n
    return dr.select(dr.dot(normal, si.p) > 0, -normal, normal)


def in_tile(row: Any, column: Any) -> Any:
    """Number of a node in its tile, in the order of Morton: 4 nodes of a square follow each other, and their 4 squares.

    The directions of each square together are then as evenly spread as those of a node.
    """
    return (column & 1) | ((row & 1) << 1) | ((column & 2) << 1) | ((row & 2) << 2)


@dataclass(frozen=True)
class _Rays:
    """Rays of some points in the renderer's memory."""

    slope: Any  # of the ray through the middle of the lens that sees each ray's point
    within: Any  # number of the point in its tile
    tile: Any  # key of the tile
    points: Any  # of the Sobol' sequence, for the directions of a tile
    key: Any


def _traced(
    traced: Callable[..., tuple[list[Any], list[Any]]], lit: tuple[Any, Any, Shares], rays: _Rays, directions: int
) -> tuple[FloatArray, FloatArray]:
    """Trace the irradiance at the points where rays through the middle of the lens land.

    ``traced`` is :func:`_trace_points`, frozen or not, and ``lit`` holds scene, integrator and lights. Each direction
    carries four of the wavelengths.

    Returns the irradiance from each light, [point, light, node], and (1/z, normal, known, mean inverse distance of the
    surroundings), [point, 6].
    """
    import drjit as dr
    import mitsuba as mi

    groups = NODES // 4
    block = directions // groups  # directions of a group, summed together
    values, (*about, near) = traced(*lit, rays, dr.opaque(mi.UInt32, directions), dr.opaque(mi.UInt32, block))
    first = dr.arange(mi.UInt32, dr.width(near) // directions) * directions
    about = [dr.gather(mi.Float, value, first) for value in about]
    about.append(dr.block_sum(near, directions) / directions)
    dr.eval(about)
    sums = [np.array(dr.block_sum(value, block)).reshape(-1, groups) / block for value in values]
    geometry = np.stack([np.array(at) for at in about], axis=-1)
    irradiance = np.concatenate(sums, axis=1).reshape(-1, lit[2].count, NODES)
    return irradiance.astype(float), geometry.astype(float)


def _trace_points(
    scene: Any, integrator: Any, shares: Shares, rays: _Rays, directions: Any, block: Any
) -> tuple[list[Any], list[Any]]:
    """Irradiance that each ray brings, of each light four wavelengths; and 1/z, normal, known and the inverse distance
    of the surroundings.
    """
    import drjit as dr
    import mitsuba as mi

    lanes = dr.width(rays.slope)
    groups = NODES // 4
    sample = dr.arange(mi.UInt32, lanes) % directions
    group = sample // block
    wavelengths = mi.Spectrum(0.0)
    step = _SPAN_NM / (NODES - 1)
    for k in range(4):
        wavelengths[k] = float(grid.WAVELENGTH_NM[0]) + mi.Float(group + k * groups) * step
    ray = mi.RayDifferential3f(mi.Ray3f(mi.Point3f(0.0), dr.normalize(mi.Vector3f(rays.slope.x, rays.slope.y, 1.0))))
    ray.wavelengths = wavelengths
    si = scene.ray_intersect(ray, ray_flags=mi.RayFlags.All, coherent=True)
    known = si.is_valid() & lambertian(si.bsdf(ray)) & (dr.dot(si.n, si.sh_frame.n) > 0)
    normal = _towards_camera(si)
    frame = mi.Frame3f(normal)

    # Another part of each node's directions per group, so that those of a group are spread evenly over the tile too.
    number = sample ^ ((rays.within % groups) * block)
    numbers = Sobol(rays.points, rays.within * directions + number, rays.tile)
    place, aim_at = numbers.next_2d(), numbers.next_2d()
    sampler = mi.load_dict({"type": "independent"})
    sampler.seed(rays.key, lanes)
    local = mi.warp.square_to_cosine_hemisphere(place)
    onward = si.spawn_ray(frame.to_world(local))
    onward.wavelengths = wavelengths
    met = scene.ray_intersect(onward, known)
    emitter = met.emitter(scene)
    emitted = dr.select(known, emitter.eval(met), 0.0)
    aim = scene.pdf_emitter_direction(si, mi.DirectionSample3f(scene, met, si), known)
    density = local.z / dr.pi
    around = dr.select(aim > 0, power_heuristic(density, aim), 1.0)
    surrounding = dr.select(from_all_around(emitter), around, 0.0)
    if shares.count == 1:
        beyond = [integrator.sample(scene, sampler, mi.RayDifferential3f(onward), active=known)[0]]
    else:
        beyond = radiance_by_light(scene, sampler, mi.RayDifferential3f(onward), known, shares)
    parts = shares.of(emitter, onward.d, wavelengths, known)
    received = [
        dr.pi * (all_of - emitted * part * (1 - surrounding)) for all_of, part in zip(beyond, parts, strict=True)
    ]

    aimed, light = scene.sample_emitter_direction(si, aim_at, True, known)
    cosine = dr.maximum(dr.dot(normal, aimed.d), 0.0)
    reachable = known & (aimed.pdf > 0) & dr.isfinite(aimed.pdf) & from_all_around(aimed.emitter)
    direct = dr.select(reachable, light * cosine * power_heuristic(aimed.pdf, cosine / dr.pi), 0.0)
    parts = shares.of(aimed.emitter, aimed.d, wavelengths, reachable)
    received = [of_light + direct * part for of_light, part in zip(received, parts, strict=True)]

    valid = dr.select(known, 1.0, 0.0)
    values = [dr.select(known, of_light[k], 0.0) for of_light in received for k in range(4)]
    about = [dr.select(known, dr.rcp(si.p.z), 0.0), normal.x, normal.y, normal.z, valid]
    about.append(dr.select(known & met.is_valid(), dr.rcp(met.t), 0.0))
    dr.eval(values, about)
    return values, about
