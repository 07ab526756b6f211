"""Tracing of an irradiance field: directions of incident light from the nodes of a grid (JIT variants).

Cells in which rays would find no irradiance, such as those between objects and on steeply receding surfaces, are
refined: the rays that must be traced further there cause the noise and the cost of a picture.

Tested in tests/dasim/render/test_irradiance.py and tests/dasim/render/test_passes.py.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from dasim.render import backend, coats, irradiance_nodes, lamps, light_spectra
from dasim.render.frozen import frozen
from dasim.render.irradiance import PARTS, SPAN_NM, STRIDE_PX, Field, lambertian, towards_camera
from dasim.render.irradiance_nodes import DIRECTION_GROUPS, Nodes
from dasim.render.lamps import from_all_around
from dasim.render.light_paths import power_heuristic, radiance_by_light
from dasim.render.light_spectra import NODES, Shares
from dasim.render.plugin import aligned, aligned_zeros, texture
from dasim.render.sobol import Sobol, points
from dasim.spectra import grid
from dasim.typing import Float32Array, FloatArray

TILE = 4  # nodes along each side of a square whose directions are stratified together
DIRECTIONS_PER_SAMPLE = 4  # directions of a point per sample of a pixel
FEWEST_DIRECTIONS, MOST_DIRECTIONS = 64, 1024
# Directions per node of refined cells: the minimum, and the divisor of the directions of the grid's nodes, which are
# nine times as sparse.
FEWEST_FINE, FINE_PART = 16, 4
FINE_AGREEMENT = 0.3  # as irradiance_nodes.AGREEMENT: irradiance is more nearly linear between closer corners
PROBES = 0.25, 0.75  # positions along each side of a cell that are tested to decide whether it is refined


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
        spectrum: spectrum of all lights together, on the wavelength grid. Wavelengths are sampled from it. If all
            emitters have one spectrum, it carries the spectral lines, which the ``NODES`` wavelengths of the field do
            not resolve.
        spp: samples per pixel of the picture, to which the number of directions is matched.
        seed: of the directions.
    """
    import mitsuba as mi

    width, height = size_px
    start = (-(axis_px[0] + margin_px), -(axis_px[1] + margin_px))
    columns, rows = (int(np.ceil((extent + 2 * margin_px) / STRIDE_PX)) + 1 for extent in (width, height))
    lights = light_spectra.lights_of(scene)
    floor = light_spectra.above_zero(spectrum)
    spectra, at_nm = floor[None], grid.WAVELENGTH_NM
    if len(lights.spectra) > 1 or not light_spectra.on_grid(lights.spectra[0], floor):
        spectra = np.stack([light_spectra.above_zero(curve) for curve in lights.spectra])
        at_nm = light_spectra.FINE_NM
    lit = np.stack([np.interp(light_spectra.nodes_nm(), at_nm, curve) for curve in spectra])
    coated = coats.table(scene)
    tracer = _Tracer(scene, integrator, lights.shares(), lit, coated, start, px_per_m, frozen(_trace_points))
    kinds = lights.slots if len(spectra) > 1 else 1

    def made(refined: NDArray[np.intp], found: _Found, grid_of_lamps: lamps.Grid | None) -> Field:
        number = np.zeros((rows - 1) * (columns - 1), np.uint32)
        number[refined] = np.arange(1, len(refined) + 1)
        ratio = aligned_zeros((len(found.ratio), NODES, kinds))  # in place: with several lights, hundreds of megabytes
        ratio[..., : len(spectra)] = np.moveaxis(found.ratio, -1, -2)
        return Field(
            start_px=start,
            px_per_m=px_per_m,
            shape=(rows, columns),
            refined=mi.UInt32(aligned(number)),
            ratio=mi.Float(ratio.reshape(-1)),
            surface=mi.Float(aligned(found.surface)),
            usable=mi.UInt32(aligned(found.usable.astype(np.uint32))),
            even=mi.UInt32(aligned(found.even.astype(np.uint32))),
            light=floor,
            spectra=texture(np.pad(spectra.T, ((0, 0), (0, kinds - len(spectra))))),
            spectrum_nodes=len(at_nm),
            share=_share(found.usable, number),
            lamps=grid_of_lamps,
            coats=coated,
        )

    y, x = np.mgrid[:rows, :columns]
    directions = _directions(spp)
    ratio, slope, surface = tracer.trace(y.ravel(), x.ravel(), STRIDE_PX, directions, seed)
    nodes = Nodes(np.arange(rows * columns).reshape(rows, columns), slope, surface)
    corners = nodes.corners()
    of_grid = _found(ratio, nodes, corners, spectra, STRIDE_PX / px_per_m, irradiance_nodes.AGREEMENT)
    refined = np.flatnonzero(_has_unknown(scene, made(np.empty(0, np.intp), of_grid, None)))

    places = _places(refined, columns - 1)
    numbers, (new_y, new_x) = _with_new(nodes.grid, places)
    ratio, *about = tracer.trace(new_y, new_x, STRIDE_PX / PARTS, max(directions // FINE_PART, FEWEST_FINE), seed + 1)
    both = Nodes(numbers, np.concatenate([slope, about[0]]), np.concatenate([surface, about[1]]))
    slots = numbers[places]
    parts = [slots[:, :-1, :-1], slots[:, :-1, 1:], slots[:, 1:, :-1], slots[:, 1:, 1:]]
    of_parts = np.stack(parts, axis=-1).reshape(-1, 4)  # corners of each part, [part, 4]
    ratio = np.concatenate([of_grid.ratio, ratio])
    fine = _found(ratio, both, of_parts, spectra, STRIDE_PX / PARTS / px_per_m, FINE_AGREEMENT)
    of_all = of_grid.followed_by(fine, slots.ravel())
    del ratio, of_grid, fine
    order = np.concatenate([np.arange(len(slope)), slots.ravel()])
    all_corners = np.concatenate([corners, of_parts])
    of_lamps = lamps.grid_of(scene, both.slope, both.surface[:, :5], all_corners, order, len(corners), seed)
    return made(refined, of_all, of_lamps)


def _directions(spp: float) -> int:
    """Directions of a node, a power of two."""
    directions = int(np.clip(DIRECTIONS_PER_SAMPLE * spp, FEWEST_DIRECTIONS, MOST_DIRECTIONS))
    return 1 << int(np.log2(directions))


class _Found(NamedTuple):
    """Results for nodes and cells, see :class:`Field`."""

    ratio: Float32Array  # [node, light, wavelength]
    surface: FloatArray  # [node, 5]
    even: NDArray[np.bool_]
    usable: NDArray[np.bool_]  # of cells

    def followed_by(self, other: _Found, nodes: NDArray[np.intp]) -> _Found:
        """These results, followed by those of some ``nodes`` of ``other`` and of all its cells."""
        return _Found(
            np.concatenate([self.ratio, other.ratio[nodes]]),
            np.concatenate([self.surface, other.surface[nodes]]),
            np.concatenate([self.even, other.even[nodes]]),
            np.concatenate([self.usable, other.usable]),
        )


def _found(
    ratio: Float32Array,
    nodes: Nodes,
    corners: NDArray[np.intp],
    spectra: FloatArray,
    apart: float,
    agreement: float,
) -> _Found:
    """Results for nodes with the irradiance ``ratio``, and for cells with the ``corners`` [cell, 4]; other arguments as
    in :mod:`irradiance_nodes`.
    """
    ratio = irradiance_nodes.smoothed(ratio, nodes, spectra, apart)
    surface = np.column_stack([nodes.surface[:, :4], irradiance_nodes.clamped(nodes)])
    even = irradiance_nodes.even_nodes(ratio, nodes, spectra)
    usable = irradiance_nodes.agreeing_cells(ratio, nodes.surface, spectra, corners, agreement)
    return _Found(ratio, surface, even, usable)


def _share(usable: NDArray[np.bool_], number: NDArray[np.uint32]) -> float:
    """Share of the grid's area in which cells are usable: refined ones by their parts."""
    of_cells = usable[: len(number)].astype(float)
    of_cells[number > 0] = usable[len(number) :].reshape(-1, PARTS**2).mean(axis=1)
    return float(of_cells.mean())


def _places(cells: NDArray[np.intp], across: int) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Rows and columns of the nodes of some refined cells, [cell, y, x]; ``across`` cells are in a row."""
    part = np.arange(PARTS + 1)
    rows, columns = (cells // across * PARTS)[:, None] + part, (cells % across * PARTS)[:, None] + part
    return rows[:, :, None], columns[:, None, :]


def _with_new(
    nodes: NDArray[np.intp], places: tuple[NDArray[np.intp], NDArray[np.intp]]
) -> tuple[NDArray[np.intp], tuple[NDArray[np.intp], NDArray[np.intp]]]:
    """Indices of all nodes on the refined grid, and the rows and columns of the new nodes.

    ``nodes`` [y, x] is a grid without empty positions. The new nodes, at ``places`` between them, are numbered after
    them.
    """
    rows, columns = nodes.shape
    numbers = np.full(((rows - 1) * PARTS + 1, (columns - 1) * PARTS + 1), -1, np.intp)
    is_new = np.zeros(numbers.shape, bool)
    is_new[places] = True
    is_new[::PARTS, ::PARTS] = False
    numbers[::PARTS, ::PARTS] = nodes
    y, x = np.nonzero(is_new)
    numbers[y, x] = nodes.size + np.arange(len(y))
    return numbers, (y, x)


def _has_unknown(scene: Any, found: Field) -> NDArray[np.bool_]:
    """Whether a test ray through the centre of the lens, for each cell of the grid, ends on a Lambertian surface,
    bare or coated, where the irradiance is unknown.
    """
    import drjit as dr
    import mitsuba as mi

    rows, columns = (extent - 1 for extent in found.shape)
    across, scale = dr.opaque(mi.UInt32, columns), dr.opaque(mi.Float, found.px_per_m)
    start = mi.Point2f(*(dr.opaque(mi.Float, value) for value in found.start_px))
    cell = dr.arange(mi.UInt32, rows * columns)
    corner = mi.Point2f(mi.Float(cell % across), mi.Float(cell // across))
    result = mi.Bool(False)
    for x in PROBES:
        for y in PROBES:
            slope = ((corner + mi.Point2f(x, y)) * STRIDE_PX + start) / scale
            direction = dr.normalize(mi.Vector3f(slope.x, slope.y, 1.0))
            ray = mi.RayDifferential3f(mi.Ray3f(mi.Point3f(0.0), direction))
            ray.wavelengths = mi.Spectrum(*lamps.PROBE_NM)
            si = scene.ray_intersect(ray, ray_flags=mi.RayFlags.All, coherent=True)
            bsdf, valid = si.bsdf(ray), si.is_valid()
            active = valid & (lambertian(bsdf) | coats.coated(found.coats, bsdf, valid))
            result |= active & ~found.at(si, active)[1]
    return np.array(result)


@dataclass(frozen=True)
class _Tracer:
    """Traces what nodes receive."""

    scene: Any
    integrator: Any
    shares: Shares
    lit: FloatArray  # spectra of the lights, [light, wavelength]
    coats: Any  # see :func:`coats.table`
    start_px: tuple[float, float]
    px_per_m: float
    traced: Callable[..., tuple[list[Any], list[Any]]]  # :func:`_trace_points`, frozen or not

    def trace(
        self, rows: NDArray[np.intp], columns: NDArray[np.intp], stride_px: float, directions: int, seed: int
    ) -> tuple[Float32Array, FloatArray, FloatArray]:
        """Irradiance of the nodes at ``rows`` and ``columns`` over the lights' spectra, [node, light, wavelength].

        Also returns their slopes and surfaces, see :class:`Nodes`. ``directions`` per node must be a power of two.
        """
        import drjit as dr
        import mitsuba as mi

        places = np.column_stack([columns, rows])
        slopes: FloatArray = np.asarray((places * stride_px + self.start_px) / self.px_per_m, dtype=float)
        received, met = np.zeros((len(rows), *self.lit.shape), np.float32), np.zeros((len(rows), 6))
        at_once = max(1, backend.lanes() // directions)
        each = dr.opaque(mi.UInt32, directions)
        sobol_key = np.random.SeedSequence((seed,)).generate_state(1)[0]
        within = in_tile(rows, columns)
        of_tile = (rows // TILE) * (columns.max(initial=0) + 1) + columns // TILE + int(sobol_key)
        for first in range(0, len(rows), at_once):
            part = slice(first, min(first + at_once, len(rows)))
            index = dr.arange(mi.UInt32, (part.stop - part.start) * directions) // each

            def of_nodes(kind: Any, values: Any, index: Any = index, part: slice = part) -> Any:
                numbers = np.append(values[part], values[part][-1:])  # a table of one number would be a constant
                return dr.gather(
                    kind, kind(aligned(numbers.astype(np.float32 if kind is mi.Float else np.uint32))), index
                )

            slope = mi.Point2f(*(of_nodes(mi.Float, slopes[:, axis]) for axis in (0, 1)))
            key = np.random.SeedSequence((seed, first)).generate_state(1)[0]
            stratum = of_nodes(mi.UInt32, within), of_nodes(mi.UInt32, of_tile % 2**32)
            rays = _Rays(slope, *stratum, points(TILE**2 * directions), dr.opaque(mi.UInt32, key), self.coats)
            values, geometry = _traced(self.traced, (self.scene, self.integrator, self.shares), rays, directions)
            received[part] = values[:, : len(self.lit)] / self.lit
            met[part] = geometry
        return received, slopes, met


def in_tile(row: Any, column: Any) -> Any:
    """Index of a node in its tile, in Morton order: the 4 nodes of a square are consecutive, and so are the 4 squares.

    The directions of each square together are then as evenly distributed as those of a single node.
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
    coats: Any


def _traced(
    traced: Callable[..., tuple[list[Any], list[Any]]], lit: tuple[Any, Any, Shares], rays: _Rays, directions: int
) -> tuple[Float32Array, FloatArray]:
    """Trace the irradiance at the points where rays through the middle of the lens land.

    ``traced`` is :func:`_trace_points`, frozen or not, and ``lit`` holds scene, integrator and lights. Each direction
    carries four of the wavelengths.

    Returns the irradiance from each light, [point, light, node], and (1/z, normal, known, mean inverse distance of the
    surroundings), [point, 6].
    """
    import drjit as dr
    import mitsuba as mi

    block = directions // DIRECTION_GROUPS  # directions of a group, summed together
    values, (*about, near) = traced(*lit, rays, dr.opaque(mi.UInt32, directions), dr.opaque(mi.UInt32, block))
    first = dr.arange(mi.UInt32, dr.width(near) // directions) * directions
    about = [dr.gather(mi.Float, value, first) for value in about]
    about.append(dr.block_sum(near, directions) / directions)
    dr.eval(about)
    sums = [np.array(dr.block_sum(value, block)).reshape(-1, DIRECTION_GROUPS) / block for value in values]
    geometry = np.stack([np.array(at) for at in about], axis=-1)
    irradiance = np.concatenate(sums, axis=1).reshape(-1, lit[2].count, NODES)
    return irradiance.astype(np.float32, copy=False), geometry.astype(float)


def _trace_points(
    scene: Any, integrator: Any, shares: Shares, rays: _Rays, directions: Any, block: Any
) -> tuple[list[Any], list[Any]]:
    """Irradiance carried by each ray, at four wavelengths for each light; and 1/z, normal, whether the point is known,
    and the inverse distance of the surroundings.
    """
    import drjit as dr
    import mitsuba as mi

    lanes = dr.width(rays.slope)
    sample = dr.arange(mi.UInt32, lanes) % directions
    group = sample // block
    wavelengths = mi.Spectrum(0.0)
    step = SPAN_NM / (NODES - 1)
    for k in range(4):
        wavelengths[k] = float(grid.WAVELENGTH_NM[0]) + mi.Float(group + k * DIRECTION_GROUPS) * step
    ray = mi.RayDifferential3f(mi.Ray3f(mi.Point3f(0.0), dr.normalize(mi.Vector3f(rays.slope.x, rays.slope.y, 1.0))))
    ray.wavelengths = wavelengths
    si = scene.ray_intersect(ray, ray_flags=mi.RayFlags.All, coherent=True)
    bsdf, valid = si.bsdf(ray), si.is_valid()
    coated = coats.coated(rays.coats, bsdf, valid)
    known = valid & (lambertian(bsdf) | coated) & (dr.dot(si.n, si.sh_frame.n) > 0)
    coated &= known
    normal = towards_camera(si)
    frame = mi.Frame3f(normal)

    # The nodes of a tile use different parts of their directions for a group of wavelengths, so that the directions of
    # the group are evenly distributed over the tile, too.
    number = sample ^ ((rays.within % DIRECTION_GROUPS) * block)
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
    through = dr.pi * coats.transmittance(bsdf, si, onward.d, coated)
    received = [
        through * (all_of - emitted * part * (1 - surrounding)) for all_of, part in zip(beyond, parts, strict=True)
    ]

    aimed, light = scene.sample_emitter_direction(si, aim_at, True, known)
    cosine = dr.maximum(dr.dot(normal, aimed.d), 0.0)
    reachable = known & (aimed.pdf > 0) & dr.isfinite(aimed.pdf) & from_all_around(aimed.emitter)
    direct = dr.select(reachable, light * cosine * power_heuristic(aimed.pdf, cosine / dr.pi), 0.0)
    direct *= coats.transmittance(bsdf, si, aimed.d, coated & reachable)
    parts = shares.of(aimed.emitter, aimed.d, wavelengths, reachable)
    received = [of_light + direct * part for of_light, part in zip(received, parts, strict=True)]

    is_known = dr.select(known, 1.0, 0.0)
    values = [dr.select(known, of_light[k], 0.0) for of_light in received for k in range(4)]
    about = [dr.select(known, dr.rcp(si.p.z), 0.0), normal.x, normal.y, normal.z, is_known]
    about.append(dr.select(known & met.is_valid(), dr.rcp(met.t), 0.0))
    dr.eval(values, about)
    return values, about
