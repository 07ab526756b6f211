"""Points on a stop, sampled uniformly over its open area, and aberrations of its rays, in the JIT variants."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from dasim.camera import pointspread, stops, wavefront
from dasim.camera.specification import Camera
from dasim.camera.stops import Mask, Polygon, Stop
from dasim.render.blur_tables import texture

Draw = Callable[[Any], Any]  # two uniform numbers -> a place, in ratios of the lens's radius


def drawer(stop: Stop) -> Draw:
    """The function that turns two uniform numbers into a place on the stop, uniform over its open area."""
    ring = stops.ring(stop)
    if ring is not None:
        return _on_ring(ring)
    if isinstance(stop, Polygon):
        return _on_triangles(stop)
    assert isinstance(stop, Mask)
    return _on_cells(stop)


def _on_ring(ring: stops.Ring) -> Draw:
    import drjit as dr
    import mitsuba as mi

    centre = mi.Point2f(*ring.centre)
    if ring.inner == 0:
        return lambda sample: centre + ring.outer * mi.warp.square_to_uniform_disk_concentric(sample)

    def draw(sample: Any) -> Any:
        radius = dr.sqrt(dr.lerp(ring.inner**2, ring.outer**2, sample.x))
        angle = 2 * dr.pi * sample.y
        return centre + radius * mi.Point2f(dr.cos(angle), dr.sin(angle))

    return draw


def _on_triangles(stop: Polygon) -> Draw:
    import drjit as dr
    import mitsuba as mi

    corners = stops.triangles(stop.corners_ratio)
    choice = mi.DiscreteDistribution(stops.triangle_areas(corners).astype(np.float32))
    table = mi.Float(corners.astype(np.float32).ravel())

    def draw(sample: Any) -> Any:
        index, again = choice.sample_reuse(sample.x)
        a, b, c = (dr.gather(mi.Point2f, table, 3 * index + k) for k in range(3))
        place = mi.warp.square_to_uniform_triangle(mi.Point2f(again, sample.y))
        return a + (b - a) * place.x + (c - a) * place.y

    return draw


def _on_cells(stop: Mask) -> Draw:
    import mitsuba as mi

    cells = np.array(stop.mask, dtype=np.float32)
    choice = mi.DiscreteDistribution2D(cells)

    def draw(sample: Any) -> Any:
        cell, _, inside = choice.sample(sample)
        return (mi.Point2f(cell) + inside) * (2 / len(cells)) - 1

    return draw


def aberration(camera: Camera, stop: Stop, wavelength_nm: float) -> Callable[[Any, Any], Any] | None:
    """Offset on the film, in pixels, through which a ray leaves for a stop; None where its light has no errors.

    A function of the place on the lens and of the field angle's tangent. The offset is the opposite of the displacement
    in the picture.
    """
    import drjit as dr
    import mitsuba as mi

    angle_step_deg, fronts = wavefront.over_field(camera, stop)
    if not any(wavefront.has_errors(front) for front in fronts):
        return None
    place = stops.cell_centres(stops.PUPIL_CELLS)
    f_number, pitch_um = pointspread.working_f_number(camera, 1.0), camera.sensor.pixel_pitch_um
    tables = []
    for front in fronts:
        errors_nm = wavefront.coefficients(front, wavelength_nm)
        y, x = wavefront.displacement_px(errors_nm, f_number, pitch_um, place[:, None], place[None, :])
        tables.append(np.stack([-x, -y], axis=-1))
    table = texture(np.array(tables, dtype=np.float32), channels=True)
    step, turned = np.radians(angle_step_deg), bool(camera.lens.wavefront_by_field)

    def offset(rho: Any, tangent: Any) -> Any:
        along = tangent / dr.maximum(dr.norm(tangent), 1e-12) if turned else mi.Point2f(1.0, 0.0)
        own = mi.Point2f(dr.dot(rho, along), rho.y * along.x - rho.x * along.y) / 2 + 0.5
        ring = (dr.atan(dr.norm(tangent)) / step + 0.5) / len(tables)
        moved = table.eval(mi.Point3f(own.x, own.y, ring))
        return mi.Point2f(moved[0] * along.x - moved[1] * along.y, moved[0] * along.y + moved[1] * along.x)

    return offset
