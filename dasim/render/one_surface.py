"""Pixels whose rays all end on one surface in even light, where texture splitting averages over the whole pixel.

A ray stands in for rays through other points of its pixel (:mod:`dasim.render.splitting`), which must end on the same
surface. Where they do not, texture that is hidden behind an edge counts, too: with cells as wide as a pixel, a striped
wall has lines along the edges of a picture on it.

Rays through the middle of the lens are traced on a grid of ``POINTS`` per pixel and axis. On a plane, inverse depth 1/z
and the texture coordinates over depth, u/z and v/z, are affine functions of the place in the picture. Where they are
not, or the shape changes, there is an edge: the end of a surface, a step between parallel ones, a fold, a seam of the
texture, or strong curvature. Texture and light must not change together within a pixel either: where irradiance is not
known, and in penumbrae and at the edges of shadows, there is an edge, too.

Tested in tests/dasim/render/test_one_surface.py.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from dasim.camera import depth_blur, distortion, geometry
from dasim.camera.sensor import principal_point
from dasim.camera.specification import Camera
from dasim.render import coats, lamps
from dasim.render.irradiance import Field, lambertian
from dasim.render.plugin import aligned
from dasim.typing import Float32Array, FloatArray

POINTS = 2  # rays per pixel and axis
STRIP_PX = 128  # rows at once, which bounds the memory
MOST_BEND = 0.05  # largest second difference of u/z and v/z between neighbouring rays, relative to the first difference
MOST_STEP = 1e-5  # largest second difference of 1/z, relative to 1/z
TAIL_PX = 2.0  # how far rays end beyond the geometric blur: the core of the diffraction pattern, and half of a pixel
RADII_PX = np.array([2.0, 3, 4, 6, 8, 12, 16, 24, 32, 48, 64, 96])  # radii of blur, rounded up to save time


def edge_blur_px(scene: Any, camera: Camera, margin_px: int, field: Field | None) -> Float32Array:
    """Diameter of the visible blur at the pixels of a frame and its margin that see an edge, and -1 at all others,
    [h, w].

    Of the surfaces on both sides of an edge, it is that of the more blurred one. For the JIT variants.
    """
    body = camera.sensor
    columns, rows = (
        (np.arange(POINTS * (side + 2 * margin_px)) + 0.5) / POINTS - margin_px
        for side in (body.width_px, body.height_px)
    )
    height, parts = len(rows) // POINTS, []
    for top in range(0, height, STRIP_PX):
        bottom = min(top + STRIP_PX, height)
        first, last = max(top - 1, 0), min(bottom + 1, height)  # with neighbours
        part = _edges(scene, camera, rows[POINTS * first : POINTS * last], columns, field)
        parts.append(part[top - first : bottom - first])
    return np.concatenate(parts)


def _edges(scene: Any, camera: Camera, rows: FloatArray, columns: FloatArray, field: Field | None) -> Float32Array:
    """:func:`edge_blur_px` of the pixels of some rows and columns of rays."""
    vergence, u, v, edge, *kinds = _surfaces(scene, camera, rows, columns, field)
    for axis in (0, 1):
        inside = (slice(1, -1), slice(None)) if axis == 0 else (slice(None), slice(1, -1))
        first, middle, last = (
            np.stack([u, v, vergence]).take(range(start, vergence.shape[axis] - 2 + start), axis + 1)
            for start in range(3)
        )
        bend, slope = np.abs(first - 2 * middle + last), np.abs(last - first) / 2
        edge[inside] |= bend[:2].sum(axis=0) > MOST_BEND * slope[:2].sum(axis=0)
        edge[inside] |= bend[2] > MOST_STEP * middle[2]
        for kind in kinds:
            edge |= ndimage.maximum_filter1d(kind, 3, axis) != ndimage.minimum_filter1d(kind, 3, axis)
    with np.errstate(divide="ignore"):
        blur = np.abs(geometry.blur_px(camera, 1 / vergence))
    return np.where(_of_pixels(edge), _of_pixels(ndimage.maximum_filter(blur, 3)), -1.0).astype(np.float32)


def _of_pixels(values: NDArray[Any]) -> NDArray[Any]:
    """Largest of the values in each pixel, of values on the grid of rays."""
    height, width = (side // POINTS for side in values.shape)
    return np.asarray(values.reshape(height, POINTS, width, POINTS).max(axis=(1, 3)))


def seen(edge_px: Float32Array, margin_px: int, outer: float) -> NDArray[np.bool_]:
    """Mask [h, w] of the pixels of the frame whose rays end on one surface without edges.

    Args:
        edge_px: from :func:`edge_blur_px`.
        margin_px: of its margin.
        outer: outer radius of the stop over that of the lens.
    """
    reach = np.where(edge_px < 0, 0.0, np.minimum(outer * edge_px / 2 + TAIL_PX, RADII_PX[-1]))
    inside = slice(margin_px, -margin_px or None)
    return ~depth_blur.within(reach, RADII_PX)[inside, inside]


def _surfaces(scene: Any, camera: Camera, rows: FloatArray, columns: FloatArray, field: Field | None) -> list[Any]:
    """Inverse depth 1/z in 1/m, u/z and v/z of what rays through the middle of the lens meet, 0 for nothing; whether
    its light is uncertain; and the numbers of its shape and of the lamps that reach it. Each is [row, column].

    ``rows`` and ``columns`` are in pixels from the frame's corner.
    """
    import drjit as dr
    import mitsuba as mi

    place = np.stack(np.meshgrid(columns, rows), axis=-1)
    place = distortion.to_pinhole_px(camera, place - principal_point(camera.sensor))
    slope = place.reshape(-1, 2) * (camera.sensor.pixel_pitch_um * 1e-6 / geometry.image_distance_m(camera))
    x, y = (mi.Float(aligned(side)) for side in slope.T)
    ray = mi.Ray3f(mi.Point3f(0.0), mi.Vector3f(x, y, 1.0))  # t is z
    ray.wavelengths = mi.Spectrum(*lamps.PROBE_NM)
    si = scene.ray_intersect(ray, ray_flags=mi.RayFlags.All, coherent=True)
    vergence = dr.select(si.is_valid(), dr.rcp(si.t), 0.0)
    certain, reached = mi.Bool(False), mi.UInt32(0)
    if field is not None:
        bsdf, hit = si.bsdf(), si.is_valid()
        known, cell = field.at(si, hit & (lambertian(bsdf) | coats.coated(field.coats, bsdf, hit)))[1:]
        grid = None if field.lamps is None else (field.lamps, cell)
        reached, certain = lamps.shadows(scene, lamps.chosen(scene), si, known, grid)
    found = [vergence, si.uv.x * vergence, si.uv.y * vergence, ~certain]
    found += [dr.reinterpret_array(mi.UInt32, si.shape), reached]
    dr.eval(*found)
    return [np.broadcast_to(np.array(value), x.shape).reshape(len(rows), len(columns)).copy() for value in found]
