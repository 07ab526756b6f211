"""Texture splitting: the mean reflectance of several points of the pixel for each ray (JIT variants).

Once irradiance is known, nearly all noise of a picture comes from which texel a ray hits. A ray from the same place on
the lens through another point of the pixel hits the same plane, at a point that needs no tracing. Each ray therefore
uses the mean reflectance of ``LOOKUPS`` points: its own, and others in the same cell of the pixel (splitting: Arvo and
Kirk, Particle transport and image synthesis, SIGGRAPH 1990). A cell is a whole pixel where all rays of the pixel end on
one surface in even light (:mod:`dasim.render.one_surface`). Elsewhere, it is a quarter of a pixel wide (half of one in
large frames), as are the nodes of the control variate. The control variate is read once per cell, so that both are
means over it (:mod:`dasim.render.control_variate`).

Every point of a cell stands in equally for every other one, so means on planes do not change. In a cell that contains
the edge of a surface, the texture of the surface continues beyond the edge.

Tested in tests/dasim/render/test_splitting.py.
"""

from __future__ import annotations

from typing import Any

from dasim.render.ray_block import Rays
from dasim.render.ray_pass import Pass

LOOKUPS, STEP = 13, 8  # points per ray, and their step along y: a Fibonacci lattice, in fractions of a cell
OTHERS = tuple((number / LOOKUPS, number * STEP % LOOKUPS / LOOKUPS) for number in range(1, LOOKUPS))
MOST_STRETCH = 1.2  # largest ratio of the depths of a point and of the ray's end; beyond it a surface is too slanted


def uv_shifts(shared: Pass, rays: Rays, si: Any) -> list[Any]:
    """Texture coordinates of the other points of each ray, relative to those of its end point.

    They are 0 where the plane through the surface is too slanted, or the point is beyond the texture's border.
    """
    import drjit as dr
    import mitsuba as mi

    corner = dr.floor(rays.place * rays.cells)
    within = rays.place * rays.cells - corner
    ray, origin = rays.ray.d / rays.ray.d.z, rays.ray.o
    depth, height = si.p.z - origin.z, dr.dot(si.n, si.p - origin)
    uu, uv, vv = (dr.dot(*pair) for pair in ((si.dp_du, si.dp_du), (si.dp_du, si.dp_dv), (si.dp_dv, si.dp_dv)))
    area = uu * vv - uv * uv
    per_area = dr.select(area > 0, dr.rcp(area), 0.0)
    result = []
    for shift in OTHERS:
        moved = within + mi.Point2f(*shift)
        film = shared.pinhole((corner + moved - dr.floor(moved)) / rays.cells - shared.axis)
        slope = (film - rays.film) / shared.px_per_m
        other = mi.Vector3f(ray.x + slope.x, ray.y + slope.y, 1.0)
        there = height / dr.dot(si.n, other)
        offset = there * other - depth * ray
        along_u, along_v = dr.dot(offset, si.dp_du), dr.dot(offset, si.dp_dv)
        moved = mi.Point2f(vv * along_u - uv * along_v, uu * along_v - uv * along_u) * per_area
        at = si.uv + moved
        usable = (there < MOST_STRETCH * depth) & (MOST_STRETCH * there > depth)
        usable &= (at.x >= 0) & (at.y >= 0) & (at.x <= 1) & (at.y <= 1)
        result.append(dr.select(usable, moved, mi.Point2f(0.0)))
    return result
