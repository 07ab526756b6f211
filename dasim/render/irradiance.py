"""Irradiance from extended sources and from other surfaces, interpolated where it is smooth (JIT variants).

The irradiance of a Lambertian surface, bare or beneath a coat (:mod:`dasim.render.coats`), from the sky and from its
surroundings changes little from pixel to pixel, but accounts for most of the cost and the noise of a picture. It is
traced once, on a grid of points that the lens sees, with many directions each, and interpolated: Ward, Rubinstein and
Clear, "A ray tracing solution for diffuse interreflection", SIGGRAPH 1988. Lamps are excluded: every ray samples them
where it lands, so that shadows are sharp (:mod:`dasim.render.lamps`).

Over wavelength, irradiance is smooth only relative to the spectrum of its source. Each distinct spectrum therefore has
its own grid; all grids share the rays.

Cells in which rays would find no irradiance are refined (:mod:`dasim.render.irradiance_tracing`).

A ray uses the corners of its cell that lie on its own surface. If all four do and receive nearly the same irradiance,
linear interpolation is accurate to a fraction of their differences. At depth discontinuities and creases, where fewer
corners remain, each of them must agree with the nodes around it. In both cases, Ward's measure limits the distance from
the point to the corners relative to the distance of the surroundings, which is short beneath objects. Elsewhere, on
other surfaces, and for the gloss of coats, rays are traced by a path tracer. The claim ``interreflection`` compares
pictures with those of the path tracer alone.

Tested in tests/dasim/render/test_irradiance.py and tests/dasim/render/test_passes.py.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from dasim.render.frozen import HOST_ONLY
from dasim.render.lamps import Cell, Grid
from dasim.render.light_spectra import NODES
from dasim.spectra import grid
from dasim.typing import FloatArray

STRIDE_PX = 3.0
PARTS = 3  # of a refined cell along each side
SAME_PLANE = 5e-3  # distance of a point from the plane of a node, over its depth
# Largest allowed error estimate of a node: its distance over that of the surroundings, plus a term for the angle
# between the normals (Ward et al., eq. 4). If all four corners of a cell are used, first-order errors cancel.
BETWEEN_ERROR, BEYOND_ERROR = 0.5, 0.3
LEAST_SHARE = 1e-3  # least bilinear weight of the corners that are used, out of all four
ON_SURFACE, ON_SURFACE_TURN = 1e-3, 2e-5  # for lamps: largest relative change of 1/z, and of the cosine (0.4 degrees)
SPAN_NM = float(grid.WAVELENGTH_NM[-1] - grid.WAVELENGTH_NM[0])


@dataclass(frozen=True)
class Field:
    """Irradiance relative to each light's spectrum on a grid of film positions, seen from the centre of the lens.

    Cells in which rays would find no irradiance are refined into ``PARTS`` x ``PARTS`` cells. In the arrays, these
    follow the cells of the grid, and their nodes follow the nodes of the grid; nodes on common sides are repeated.
    """

    start_px: tuple[float, float]  # of the first node, from the axis
    px_per_m: float
    shape: tuple[int, int]  # nodes of the grid, [y, x]
    refined: Any  # per cell of the grid: its index among the refined cells, from 1; 0 if it is not refined
    ratio: Any  # flat [node, wavelength, light]: irradiance of each light over its spectrum
    surface: Any  # flat [node, (1/z, normal, mean inverse distance of the surroundings in 1/m)]
    usable: Any  # per cell: 1 where the corners agree
    even: Any  # per node: 1 where the irradiance agrees with that of the neighbours on the same surface
    light: FloatArray = field(metadata=HOST_ONLY)  # spectrum of all lights together, on the wavelength grid
    spectra: Any  # of each light as a texture over wavelength
    spectrum_nodes: int  # of that texture
    share: float = field(metadata=HOST_ONLY)  # of the frame and its margin, where cells are usable
    lamps: Grid | None  # None where every ray draws one emitter
    coats: Any  # see :func:`dasim.render.coats.table`

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
        cell, first = row * (columns - 1) + column, row * columns + column
        corner, along, spacing = mi.Point2f(mi.Float(column), mi.Float(row)), mi.Point2f(x, y), mi.Float(1.0)
        along -= corner
        number = dr.gather(mi.UInt32, self.refined, cell, inside)
        is_refined, block = number > 0, dr.select(number > 0, number - 1, 0)
        # PARTS - 1 at most, where rounding gives PARTS
        part_x, part_y = (dr.minimum(mi.UInt32(PARTS * part), PARTS - 1) for part in (along.x, along.y))
        part = mi.Point2f(mi.Float(part_x), mi.Float(part_y))
        cell = dr.select(is_refined, (columns - 1) * (rows - 1) + (block * PARTS + part_y) * PARTS + part_x, cell)
        across = PARTS + 1
        first = dr.select(is_refined, columns * rows + (block * across + part_y) * across + part_x, first)
        columns = dr.select(is_refined, across, columns)
        corner = dr.select(is_refined, corner + part / PARTS, corner)
        along = dr.select(is_refined, PARTS * along - part, along)
        spacing = dr.select(is_refined, 1 / PARTS, spacing)

        facing, corners = towards_camera(si), []
        vergence, normal, seen = mi.Float(0.0), mi.Vector3f(0.0), mi.Float(0.0)
        whole, even = mi.Bool(inside), mi.Bool(inside)
        for right, below in ((0, 0), (1, 0), (0, 1), (1, 1)):
            node = first + right + (columns if below else 0)
            share = (along.x if right else 1 - along.x) * (along.y if below else 1 - along.y)
            own, *towards, near = (dr.gather(mi.Float, self.surface, 5 * node + index, inside) for index in range(5))
            towards = mi.Vector3f(*towards)
            vergence, normal = dr.fma(share, own, vergence), normal + share * towards
            slope = mi.Point2f(corner.x + right * spacing + start[0], corner.y + below * spacing + start[1]) / scale
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
        return self._irradiance(parts, si.wavelengths, known), known, Cell(cell, first, along, columns, on_surface)

    def _irradiance(self, parts: list[tuple[Any, Any]], wavelengths: Any, active: Any) -> Any:
        """Spectral irradiance of some nodes by their shares."""
        import drjit as dr
        import mitsuba as mi

        result = mi.Spectrum(0.0)
        for k in range(4):
            at = (wavelengths[k] - float(grid.WAVELENGTH_NM[0])) / SPAN_NM
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


def lambertian(bsdf: Any) -> Any:
    """Whether a surface is a Lambertian reflector and transmits nothing, for each ray."""
    import mitsuba as mi

    flags, kinds = bsdf.flags(), mi.BSDFFlags
    other = kinds.Glossy | kinds.Delta | kinds.Delta1D | kinds.DiffuseTransmission | kinds.Null
    return mi.has_flag(flags, kinds.DiffuseReflection) & ((flags & int(other)) == 0)


def towards_camera(si: Any) -> Any:
    """The normal of a surface on the camera's side."""
    import drjit as dr

    normal = si.sh_frame.n
    return dr.select(dr.dot(normal, si.p) > 0, -normal, normal)
