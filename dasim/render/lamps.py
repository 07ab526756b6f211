"""Direct light from emitters, with a control variate from the irradiance of whole lamps (JIT variants).

Every ray samples each of up to 32 emitters, so that the choice of an emitter adds no noise. The remaining noise
comes from the position of the sample on a lamp, and from shadows. Each node of the grid of
:mod:`dasim.render.irradiance` holds the projected solid angle of the unoccluded lamp, and of the part of it that the
node sees. With E the light from the whole lamp, L the light of one sample, V the visibility of its point, and c any
number,

    c E + (V - c) L

has the same mean as V L (a control variate: Owen, Monte Carlo theory, methods and examples, section 8.9). With c the
fraction that the nodes see, full light and full shadow have no noise, and penumbrae have only that of V. A shadow that
no node sees is still rendered, because c does not change the mean. E is interpolated where a ray ends on the surface
that the nodes see.

Among leaves, E is known in few cells, and the position on the lamp causes up to three quarters of all noise. There, a
ray samples a lamp ``SPLIT`` times if it may lie in its penumbra or E is unknown (splitting), since a shadow ray costs
less than a ray through the lens.

Tested in tests/dasim/render/test_lamps.py.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from dasim.render import backend, coats
from dasim.render.light_paths import power_heuristic
from dasim.render.plugin import aligned
from dasim.render.sobol import Sobol, points
from dasim.typing import FloatArray

MOST_EMITTERS = 32  # most emitters that every ray samples; of more, each ray samples one
AGREEMENT = 0.15  # largest relative difference of the solid angle between the corners of a cell
SAMPLES = 64  # samples of a lamp from a node
SPLIT = 2  # samples of a lamp where its light is uncertain, if it is known in less than the fraction ``CLEAR`` of cells
CLEAR = 0.7
LATTICE = 12664747, 9560334  # 2^24 times steps of Roberts' R2 sequence, between the samples of a ray
PROBE_NM = 430.0, 540.0, 610.0, 720.0  # the emitting side of a lamp has light at one of these wavelengths


@dataclass(frozen=True)
class Grid:
    """What the nodes of an irradiance field receive from each of the sampled emitters."""

    whole: Any  # projected solid angle of the emitter, sr, flat [emitter, node], nodes of refined cells included
    seen: Any  # projected solid angle of the visible part of the emitter, sr
    usable: Any  # cells at whose four nodes both angles are known, and ``whole`` is nearly the same
    samples: Any  # samples of each emitter where its light is uncertain
    nodes: Any  # number of nodes per emitter, opaque
    cells: Any  # number of cells per emitter, opaque


@dataclass(frozen=True)
class Chosen:
    """The emitters that each ray samples, see :func:`sampled`."""

    numbers: Any
    count: Any  # opaque; 1 where each ray draws one


class Cell(NamedTuple):
    """Where a ray ends in the grid of an irradiance field."""

    number: Any  # of the cell
    node: Any  # of its first corner
    along: Any  # place in the cell, 0 to 1 along x and y
    columns: Any  # of nodes, from one row to the next
    is_on_surface: Any  # whether the ray ends on the surface that the nodes see


class Even(NamedTuple):
    """Rays that end where the irradiance field holds the light from the surroundings."""

    known: Any  # whether it does; no scattered ray is traced there that could count the same light again
    glossy: Any  # whether the surface has a coat, and only gloss scatters rays
    bare: Any  # whether the surface is a Lambertian reflector without a coat or a map of normals
    own: Any  # reflected radiance per irradiance at the end of the ray, 1/sr
    mean: Any  # the same, averaged with nearby points of the texture, which is the value that counts


def sampled(scene: Any) -> list[int]:
    """Numbers of the emitters that each ray samples; empty where it draws one."""
    numbers = [number for number, emitter in enumerate(scene.emitters()) if emitter.sampling_weight() > 0]
    return numbers if len(numbers) <= MOST_EMITTERS else []


def chosen(scene: Any) -> Chosen:
    """The emitters that each ray samples, for :func:`light`."""
    import drjit as dr
    import mitsuba as mi

    numbers = sampled(scene)
    table = np.zeros(MOST_EMITTERS, np.uint32)  # a table of one number would be a constant
    table[: len(numbers)] = numbers
    return Chosen(mi.UInt32(aligned(table)), dr.opaque(mi.UInt32, max(len(numbers), 1)))


def from_all_around(emitter: Any) -> Any:
    """Whether an emitter surrounds the scene (a sky, not a lamp or the sun), for each ray."""
    import mitsuba as mi

    flags = emitter.flags()
    return mi.has_flag(flags, mi.EmitterFlags.Infinite) & ~mi.has_flag(flags, mi.EmitterFlags.Delta)


def density(scene: Any, si: Any, met: Any, active: Any) -> Any:
    """Density at which :func:`light` samples the direction from ``si`` to the emitter at ``met``, per steradian."""
    import drjit as dr
    import mitsuba as mi

    direction = mi.DirectionSample3f(scene, met, si)
    if not sampled(scene):
        return scene.pdf_emitter_direction(si, direction, active)
    emitter = met.emitter(scene)
    active = active & (emitter.sampling_weight() > 0)
    return dr.select(active, emitter.pdf_direction(si, direction, active), 0.0)


def light(
    scene: Any,
    emitters: Chosen,
    bsdf: Any,
    si: Any,
    aim_at: Any,
    hit: Any,
    even: Even | None,
    grid: tuple[Grid, Cell] | None,
) -> Any:
    """Spectral radiance that leaves a surface for light that comes straight from emitters.

    Args:
        scene: a Mitsuba scene.
        emitters: of :func:`chosen`.
        bsdf: of the surface.
        si: the surface interaction.
        aim_at: two uniform numbers.
        hit: mask of the rays.
        even: where the irradiance field is known; None without a field.
        grid: the grid of :func:`grid_of`, and the cell of it in which each ray ends; None without a grid.
    """
    import drjit as dr
    import mitsuba as mi

    known, glossy, bare = (mi.Bool(False),) * 3 if even is None else even[:3]
    draws_one = not sampled(scene)

    def body(index: Any, repeat: Any, total: Any) -> tuple[Any, Any, Any]:
        number, weight = dr.gather(mi.UInt32, emitters.numbers, index), mi.Float(1.0)
        place = mi.Point2f(*(_shifted(at, repeat, step) for at, step in zip(aim_at, LATTICE, strict=True)))
        if draws_one:
            number, weight, reused = scene.sample_emitter(place.x, hit)
            place = mi.Point2f(reused, place.y)
        emitter = dr.gather(mi.EmitterPtr, scene.emitters_dr(), number)
        is_around = from_all_around(emitter)
        reached = hit & ~(known & ~glossy & is_around)
        aimed, arriving = emitter.sample_direction(si, place, reached)
        # A lamp that samples itself gives infinities.
        active = reached & (aimed.pdf > 0) & dr.isfinite(aimed.pdf) & dr.any(arriving != 0)
        local = si.to_local(aimed.d)
        value, other, base, gloss, of_gloss = dr.dispatch(bsdf, _towards, si, local, active=active & ~bare)
        if even is not None:
            value = mi.Spectrum(dr.select(glossy, base, value))
            # The cosine factor as the BSDF applies it; where its reflectance is 0, the cosine itself.
            plain = mi.Spectrum(dr.select(local.z * si.wi.z > 0, dr.abs(local.z), 0.0))
            factor = dr.select(bare | (even.own <= 0), plain, value / even.own)
            value = mi.Spectrum(dr.select(known, even.mean * factor, value))
        share = dr.select(aimed.delta | known, 1.0, power_heuristic(aimed.pdf / weight, other))
        sample = value * arriving * (weight * share)
        if even is not None:
            sample &= ~(glossy & is_around)
            share = dr.select(aimed.delta, 1.0, power_heuristic(aimed.pdf / weight, of_gloss))
            sample += dr.select(active & glossy, gloss * arriving * (weight * share), 0.0)
        is_seen = active & ~scene.ray_test(si.spawn_ray_to(aimed.p), active)
        added, count = dr.select(is_seen, sample, 0.0), mi.UInt32(1)
        if grid is not None and even is not None:
            whole, seen = _interpolated(*grid, index, known & ~glossy & reached)
            control = dr.select(whole > 0, seen / whole, 0.0)
            added += control * dr.select(active, even.mean * (whole * aimed.pdf) * arriving - sample, 0.0)
            # The number of samples must not depend on their values.
            doubted = reached & ~mi.has_flag(emitter.flags(), mi.EmitterFlags.Delta)
            doubted &= ~((whole > 0) & ((seen <= 0) | (seen >= whole)))
            count = dr.select(doubted, dr.gather(mi.UInt32, grid[0].samples, index, doubted), 1)
        is_last = repeat + 1 >= count
        following = dr.select(is_last, index + 1, index), dr.select(is_last, 0, repeat + 1)
        return *following, total + added / mi.Float(count)

    none = mi.UInt32(dr.zeros(mi.UInt32, dr.width(hit)))
    start = none, mi.UInt32(none), mi.Spectrum(dr.zeros(mi.Spectrum, dr.width(hit)))
    labels = "index", "repeat", "total"
    return dr.while_loop(start, lambda index, repeat, total: index < emitters.count, body, labels=labels)[2]


def _towards(bsdf: Any, si: Any, local: Any, active: Any) -> tuple[Any, Any, Any, Any, Any]:
    """Value and density of a scattering function in a direction, the value of its base, and value and density of its
    gloss; one call of an instance for all of them.
    """
    import mitsuba as mi

    value, density = bsdf.eval_pdf(mi.BSDFContext(), si, local, active)
    base = bsdf.eval(coats.base_context(), si, local, active)
    return value, density, base, *bsdf.eval_pdf(coats.gloss_context(), si, local, active)


def shadows(scene: Any, emitters: Chosen, si: Any, active: Any, grid: tuple[Grid, Cell] | None) -> tuple[Any, Any]:
    """Number of the set of emitters whose direct light reaches a surface point, and whether it is certain: no
    emitter is partly hidden. Arguments are those of :func:`light`; emitters that surround the scene do not count.
    """
    import drjit as dr
    import mitsuba as mi

    middle = mi.Point2f(dr.opaque(mi.Float, 0.5, dr.width(active)), 0.5)

    def body(index: Any, reached: Any, certain: Any) -> tuple[Any, Any, Any]:
        emitter = dr.gather(mi.EmitterPtr, scene.emitters_dr(), dr.gather(mi.UInt32, emitters.numbers, index))
        aimed, arriving = emitter.sample_direction(si, middle, active)
        towards = active & ~from_all_around(emitter) & (aimed.pdf > 0) & dr.any(arriving != 0)
        towards &= dr.dot(aimed.d, si.n) * dr.dot(si.wi, si.sh_frame.to_local(si.n)) > 0
        is_point = mi.has_flag(emitter.flags(), mi.EmitterFlags.Delta)
        is_seen = towards & is_point & ~scene.ray_test(si.spawn_ray_to(aimed.p), towards & is_point)
        whole, seen = (mi.Float(0.0),) * 2 if grid is None else _interpolated(*grid, index, towards & ~is_point)
        known = is_point | ((whole > 0) & ((seen <= 0) | (seen >= whole)))
        is_seen |= seen > 0
        return index + 1, 3 * reached + dr.select(towards & is_seen, 1, 0), certain & (~towards | known)

    none = mi.UInt32(dr.zeros(mi.UInt32, dr.width(active)))
    start = none, mi.UInt32(none), mi.Bool(active)
    labels = "index", "reached", "certain"
    found = dr.while_loop(start, lambda index, *_: index < emitters.count, body, labels=labels)
    return found[1], found[2]


def _shifted(place: Any, repeat: Any, step: int) -> Any:
    """A 24-bit number in 0..1, combined with ``repeat`` x ``step`` by exclusive or (digital shift).

    This keeps the stratification of a pixel's samples, which addition modulo 1 would change.
    """
    import drjit as dr
    import mitsuba as mi

    shifted = mi.Float(mi.UInt32(place * 2.0**24) ^ ((repeat * step) & 0xFFFFFF)) * 2.0**-24
    return dr.select(repeat > 0, shifted, place)


def _interpolated(grid: Grid, cell: Cell, lamp: Any, active: Any) -> tuple[Any, Any]:
    """Projected solid angle of a lamp, and of what is seen of it, sr; 0 where they are not known."""
    import drjit as dr
    import mitsuba as mi

    active = active & cell.is_on_surface
    active &= dr.gather(mi.UInt32, grid.usable, lamp * grid.cells + cell.number, active) > 0
    first = lamp * grid.nodes + cell.node
    whole, seen = mi.Float(0.0), mi.Float(0.0)
    for right, below in ((0, 0), (1, 0), (0, 1), (1, 1)):
        share = (cell.along.x if right else 1 - cell.along.x) * (cell.along.y if below else 1 - cell.along.y)
        node = first + right + (cell.columns if below else 0)
        whole = dr.fma(share, dr.gather(mi.Float, grid.whole, node, active), whole)
        seen = dr.fma(share, dr.gather(mi.Float, grid.seen, node, active), seen)
    return whole, seen


def grid_of(
    scene: Any,
    slope: FloatArray,
    surface: FloatArray,
    corners: NDArray[np.intp],
    slots: NDArray[np.intp],
    even_cells: int,
    key: int,
) -> Grid | None:
    """The grid of all lamps whose radiance is the same everywhere on them; None where every ray draws one emitter.

    Args:
        scene: a Mitsuba scene.
        slope: x / z and y / z of the nodes, [node, 2].
        surface: what the nodes see, [node, 5], see :class:`dasim.render.irradiance_nodes.Nodes`.
        corners: numbers of the nodes at the corners of each cell, [cell, 4].
        slots: numbers of the nodes in the order in which the grid holds them, some of them repeatedly.
        even_cells: how many of the first cells cover all of the frame evenly.
        key: of the samples.
    """
    import drjit as dr
    import mitsuba as mi

    numbers = sampled(scene)
    if not numbers:
        return None
    results = [_traced(scene, number, slope, surface, key) for number in numbers]
    whole, seen, is_whole = (np.stack(part) for part in zip(*results, strict=True))
    of_corners = whole[:, corners]
    usable = is_whole[:, corners].all(axis=-1) & (np.ptp(of_corners, axis=-1) < AGREEMENT * of_corners.mean(axis=-1))
    samples = np.ones(MOST_EMITTERS, np.uint32)  # a table of one number would be a constant
    samples[: len(numbers)] = np.where(usable[:, :even_cells].mean(axis=1) < CLEAR, SPLIT, 1)
    return Grid(
        whole=mi.Float(aligned(whole[:, slots])),
        seen=mi.Float(aligned(seen[:, slots])),
        usable=mi.UInt32(aligned(usable.astype(np.uint32))),
        samples=mi.UInt32(aligned(samples)),
        nodes=dr.opaque(mi.UInt32, len(slots)),
        cells=dr.opaque(mi.UInt32, len(corners)),
    )


def _traced(
    scene: Any, number: int, slope: FloatArray, surface: FloatArray, key: int
) -> tuple[FloatArray, FloatArray, NDArray[np.bool_]]:
    """Projected solid angle of an emitter at each node, that of its visible part, and whether both are known.

    They are known for lamps of uniform radiance whose emitting side faces the node.
    """
    import drjit as dr
    import mitsuba as mi

    count = len(slope)
    at_once = max(1, backend.lanes() // SAMPLES)
    result = np.zeros((3, count))
    emitter_number, each = dr.opaque(mi.UInt32, number), dr.opaque(mi.UInt32, SAMPLES)
    for first in range(0, count, at_once):
        part = slice(first, min(first + at_once, count))
        size = part.stop - part.start
        here = np.where(surface[part, 4:] > 0, surface[part], [1.0, 0.0, 0.0, -1.0, 0.0])
        lane = dr.arange(mi.UInt32, size * SAMPLES)
        node = lane // each

        def of_nodes(values: FloatArray, node: Any = node) -> list[Any]:
            columns = np.ascontiguousarray(values.T, dtype=np.float32)
            return [dr.gather(mi.Float, mi.Float(aligned(column)), node) for column in columns]

        at = dr.zeros(mi.SurfaceInteraction3f, size * SAMPLES)
        at.p = mi.Point3f(*of_nodes(np.column_stack([slope[part], np.ones(size)]) / here[:, :1]))
        normal = mi.Vector3f(*of_nodes(here[:, 1:4]))
        at.n, at.wavelengths = mi.Normal3f(normal), mi.Spectrum(*PROBE_NM)
        known = of_nodes(here[:, 4:])[0] > 0
        emitter = dr.gather(mi.EmitterPtr, scene.emitters_dr(), emitter_number + dr.zeros(mi.UInt32, size * SAMPLES))
        sobol = Sobol(points(SAMPLES), lane % each, node + dr.opaque(mi.UInt32, (key + first) % 2**32))
        aimed, arriving = emitter.sample_direction(at, sobol.next_2d(), known)
        cosine = dr.dot(normal, aimed.d)
        flags, kinds = emitter.flags(), mi.EmitterFlags
        other = kinds.SpatiallyVarying | kinds.Infinite | kinds.DeltaPosition | kinds.DeltaDirection
        known &= ((flags & int(other)) == 0) & (aimed.pdf > 0) & dr.isfinite(aimed.pdf)
        known &= dr.any(arriving != 0)
        angle = dr.select(known, dr.maximum(cosine, 0.0) / aimed.pdf, 0.0)
        is_seen = known & ~scene.ray_test(at.spawn_ray_to(aimed.p), known)
        values = [angle, dr.select(is_seen, angle, 0.0), dr.select(known, 1.0, 0.0)]
        dr.eval(values)
        result[:, part] = [np.array(dr.block_sum(value, SAMPLES)) / SAMPLES for value in values]
    return result[0], result[1], result[2] == 1.0
