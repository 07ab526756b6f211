"""Defocus in wave optics: rays are sampled from the geometric blur and weighted to match wave optics.

A ray starts at rho on the stop, sampled uniformly, and leaves through the film position x + delta, with delta sampled
from the in-focus diffraction pattern D. If it hits a surface of blur c, the image of the hit point lies at the offset u
from x, with density g(u; c), which is D convolved with the geometric blur. The density in wave optics is
h(u; c, lambda), so the contribution of the ray is weighted by h / g. This is exact for surfaces that face the camera
and are not partly hidden; a surface seen past the edge of a nearer one gets the light that the nearer one leaves
(:mod:`dasim.render.layers`).

Off the axis (:mod:`dasim.render.field_angle`), delta is sampled from the off-axis pattern D(T delta). The weight is the
on-axis weight with u and c scaled by t = |T u| / |u|: this keeps the geometric edge in its place, and gives diffraction
the scale that belongs to the direction of the edge. For discs and rings about the axis, whose D depends on |T u| alone,
this is exact in focus. For other stops, the pattern is D(T u), but the weight takes D at the same distance in the
direction of u, which differs from that of T u by up to 9 degrees at a field angle of 31 degrees. Off-axis defocus is
astigmatic, rho T rho, which is neglected (claim ``off-axis`` measures the error).

Sampling rho and delta independently would leave u unstratified, although u determines what a pixel sees. For discs and
rings, u is therefore sampled first, stratified, for the blur c0 at the pixel centre, with a density q close to h; then
rho is sampled by rejection with density D(delta), where delta = -u - rho c1 / 2. Here c1 is the blur at u of the plane
that continues the surface seen at the pixel centre. The joint density is the same except for the factor
g(u; c1) / q(u; c0) and the volume |d delta / d u|, which multiply the weight. This is not an approximation, wherever
the ray ends.

Discs and rings are radial and need two-dimensional tables. Polygons and masks need two three-dimensional tables, and
rho and delta are sampled independently. Lengths are in pixels. c is signed, refers to the open lens, and is positive
nearer than the focus.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Any, Protocol

import numpy as np

from dasim.camera import geometry, pointspread, wavefront
from dasim.camera.specification import Camera
from dasim.camera.stops import Stop
from dasim.render import pattern_blur, radial_tables
from dasim.render.blur_tables import Drawn
from dasim.spectra import grid as spectra
from dasim.typing import FloatArray


class Blur(Protocol):
    """Sampling of the lens and weights of wave optics for one stop."""

    def draw(self, first: Any, second: Any, blur_px: Any, slope: Any, key: Any) -> Drawn:
        """A ray for an expected blur.

        Args:
            first: two uniform numbers.
            second: two uniform numbers.
            blur_px: expected signed blur of the open lens in the middle of the pixel.
            slope: its change along x and y of the picture, pixels per pixel.
            key: seed of the random numbers for rejection.
        """

    def draw_in_focus(self, first: Any, second: Any) -> Drawn:
        """A ray through the middle of the lens, where the blur is zero; ``first`` and ``second`` as for ``draw``."""

    def weights(self, u_px: Any, blur_px: Any, tangent: Any, wavelengths_nm: list[Any]) -> list[Any]:
        """Ratios h / g for each wavelength; 1 outside the tables, where the blur is that of the sampled rays.

        ``tangent`` is that of the field angle, as a vector in the picture.
        """


def blur(camera: Camera, stop: Stop, density: FloatArray, max_blur_px: float) -> Blur:
    """Tables for a stop whose wavelengths are sampled with the relative ``density`` on the grid."""
    return _blur(camera.model_dump_json(), stop, density.tobytes(), max_blur_px)


@lru_cache(maxsize=8)
def _blur(camera_json: str, stop: Stop, density_bytes: bytes, max_blur_px: float) -> Blur:
    """The tables, cached by plain values: the pictures of one capture share them."""
    camera, density = Camera.model_validate_json(camera_json), np.frombuffer(density_bytes)
    bands = [(nm, float(weight[0])) for nm, weight in spectra.bands(density[None, :])]
    total = sum(weight for _, weight in bands)
    bands = [(nm, weight / total) for nm, weight in bands]
    shortest_nm = float(spectra.WAVELENGTH_NM[np.argmax(density > 0)])
    if all(pointspread.is_radial(camera, stop, front=front) for front in wavefront.over_field(camera, stop)[1]):
        return radial_tables.tables(camera, stop, bands, shortest_nm, max_blur_px)
    return pattern_blur.tables(camera, stop, bands, shortest_nm, max_blur_px)


def blur_range_px(camera: Camera, seen_px: float, limit_px: float) -> float:
    """Largest visible blur that the tables must cover, axial colour included."""
    return min(seen_px, limit_px) + float(np.abs(geometry.chromatic_blur_px(camera)).max())
