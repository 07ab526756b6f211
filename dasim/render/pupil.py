"""Points on a stop, sampled uniformly over its open area, and aberrations of its rays, in the JIT variants."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from dasim.camera import pointspread, stops, wavefront
from dasim.camera.specification import Camera
from dasim.camera.stops import Mask, Polygon, Stop
from dasim.render.blur_tables import texture
from dasim.render.plugin import aligned

Draw = Callable[[Any], Any]  # two uniform numbers -> a place, in ratios of the lens's radius


def drawer(stop: Stop) -> Draw:
    """The function that turns two uniform numbers into a place on the stop, uniform over its open area."""
    import mitsuba as mi

    ring = stops.ring(stop)
    if ring is not None:
        return _OnRing(mi.Point2f(*ring.centre), ring.inner, ring.outer)
    if isinstance(stop, Polygon):
        corners = stops.triangles(stop.corners_ratio)
        choice = mi.DiscreteDistribution(stops.triangle_areas(corners).astype(np.float32))
        return _OnTriangles(choice, mi.Float(aligned(corners)))
    assert isinstance(stop, Mask)
    cells = np.array(stop.mask, dtype=np.float32)
    return _OnCells(mi.DiscreteDistribution2D(cells), len(cells))


@dataclass(frozen=True)
class _OnRing:
    centre: Any
    inner: float
    outer: float

    def __call__(self, sample: Any) -> Any:
        import drjit as dr
        import mitsuba as mi

        if self.inner == 0:
            return self.centre + self.outer * mi.warp.square_to_uniform_disk_concentric(sample)
        radius = dr.sqrt(dr.lerp(self.inner**2, self.outer**2, sample.x))
        angle = 2 * dr.pi * sample.y
        return self.centre + radius * mi.Point2f(dr.cos(angle), dr.sin(angle))


@dataclass(frozen=True)
class _OnTriangles:
    choice: Any  # of a triangle, by area
    corners: Any  # [triangle, corner, (x, y)], flat

    def __call__(self, sample: Any) -> Any:
        import drjit as dr
        import mitsuba as mi

        index, again = self.choice.sample_reuse(sample.x)
        a, b, c = (dr.gather(mi.Point2f, self.corners, 3 * index + k) for k in range(3))
        place = mi.warp.square_to_uniform_triangle(mi.Point2f(again, sample.y))
        return a + (b - a) * place.x + (c - a) * place.y


@dataclass(frozen=True)
class _OnCells:
    choice: Any  # of a cell, by transmission
    across: int

    def __call__(self, sample: Any) -> Any:
        import mitsuba as mi

        cell, _, inside = self.choice.sample(sample)
        return (mi.Point2f(cell) + inside) * (2 / self.across) - 1


@dataclass(frozen=True)
class Aberration:
    """Offset of the film position of a ray due to aberrations, in pixels."""

    table: Any  # by field angle and position on the stop
    angles: int
    step: float  # between the angles, radians
    turned: bool  # whether the aberrations are given relative to the radial direction, away from the axis

    def __call__(self, rho: Any, tangent: Any) -> Any:
        """The offset for a place on the lens, in its radii, and the tangent of the field angle, a vector."""
        import drjit as dr
        import mitsuba as mi

        along = tangent / dr.maximum(dr.norm(tangent), 1e-12) if self.turned else mi.Point2f(1.0, 0.0)
        own = mi.Point2f(dr.dot(rho, along), rho.y * along.x - rho.x * along.y) / 2 + 0.5
        ring = (dr.atan(dr.norm(tangent)) / self.step + 0.5) / self.angles
        moved = self.table.eval(mi.Point3f(own.x, own.y, ring))
        return mi.Point2f(moved[0] * along.x - moved[1] * along.y, moved[0] * along.y + moved[1] * along.x)


def aberration(camera: Camera, stop: Stop, wavelength_nm: float) -> Aberration | None:
    """Offset on the film, in pixels, through which a ray leaves for a stop; None where its light has no errors.

    A function of the place on the lens and of the field angle's tangent. The offset is the opposite of the displacement
    in the picture.
    """
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
    return Aberration(table, len(tables), float(np.radians(angle_step_deg)), bool(camera.lens.wavefront_by_field))
