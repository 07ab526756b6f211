"""Sampling and weights of wave optics for discs and rings, from radial tables (:mod:`dasim.render.wave` has the idea).

u is sampled first, stratified, for the blur at the centre of the pixel, with a density q close to h; then rho by
rejection with density D(delta), where delta = -u - rho c1 / 2 and c1 is the blur at u of the plane that the pixel sees.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

import numpy as np
from scipy import ndimage

from dasim.render import control_variate, field_angle
from dasim.render.blur_tables import AberratedRows, Drawn, texel
from dasim.render.control_variate import Control, Fine
from dasim.render.frozen import HOST_ONLY
from dasim.render.wavelengths import tents
from dasim.typing import Float32Array, FloatArray

OFFSET_NODES = 1 << 15  # of the inverse cumulative distribution of |delta|
TAIL_RINGS = 40.0  # |delta| is sampled up to this many lambda N; 0.5 % of the light of an Airy pattern lies beyond
KERNEL_RINGS = 16.0  # h ends this many lambda N beyond the geometric blur; the 1 % of light beyond is added within
RADIUS_STEP = 0.05  # of the table of h, in lambda N
WAVES_STEP = 0.02
DENSITY_STEP_PX = 0.04  # of the table of g, along u
DENSITY_BLUR_STEP_PX = 0.1  # of the table of g, along c
GUIDE_NODES = 512  # steps of equal probability of q along |u|
MOST_CHANGE = 0.15  # largest change of blur over the plane that rays are aimed for, over ``tail_px``
CONTROL_BANDS = 32  # wavelengths of the kernels of the control variate, a power of two


class Plain(NamedTuple):
    """What the control variate's kernels are made from."""

    profiles: FloatArray  # [waves, radius] h in units of lambda N, without aberrations' turns
    averaged: Float32Array | None  # the same over nearby wavelengths; None with aberrations
    px_per_nm: float
    outer: float
    centre: tuple[float, float]
    core_px: float


class Spectrum(NamedTuple):
    """The wavelengths of a stop, which its kernels are weighted with."""

    nm: FloatArray  # [wavelength]
    colour_px: FloatArray  # [wavelength] amount that axial colour subtracts from the visible blur
    weight: FloatArray  # [wavelength, band, channel] response x light, shared between the bands of the control variate


def spectrum_of(nm: FloatArray, light: FloatArray, colour_px: FloatArray, bands: int) -> Spectrum:
    """The spectrum of a stop from wavelengths at equal steps of probability, [node], reduced to ``CONTROL_BANDS``.

    ``light`` [node, channel] is response x light there over the probability, ``colour_px`` [node] as in the result.
    """
    places = (np.arange(len(nm)) + 0.5) / len(nm)
    parts = np.einsum("nb,nc->nbc", tents(places), light).reshape(CONTROL_BANDS, -1, bands, light.shape[1])
    middle_nm, middle_px = (curve.reshape(CONTROL_BANDS, -1).mean(axis=1) for curve in (nm, colour_px))
    return Spectrum(middle_nm, middle_px, parts.sum(axis=1))


@dataclass(frozen=True)
class RadialBlur:
    """Radial tables of a disc or ring; blur and distances are relative to its own centre."""

    outer: Any  # radius over that of the lens; numbers are opaque, so that stops and cameras share a compiled kernel
    centre: Any
    px_per_nm: Any  # lambda N in pixels per nanometre of lambda
    max_blur_px: Any
    max_radius_px: Any
    inner: Any  # inner radius over the outer one
    tail_px: Any
    core_px: Any  # approximate width of D
    rows: Any  # of the table of g
    columns: Any
    wave_rows: Any
    wave_columns: Any
    offsets: Any  # [OFFSET_NODES] |delta| at equal steps of probability, 0 to 1
    light_inside: Any  # [u] the inverse: share of D's light within u
    light_columns: Any
    density: Any  # [c, u] g per square pixel; its first row is D
    envelope: Any  # [u] maximum of D at u and beyond
    guide: Any  # [c, GUIDE_NODES + 1], flat: |u| at equal steps of probability of q
    wave: Any  # [waves, radius] h in units of lambda N
    averaged: Any | None  # the same over nearby wavelengths, see :meth:`over_wavelengths`; None with aberrations
    plain: Plain = field(metadata=HOST_ONLY)
    aberrated: AberratedRows | None = None  # rows of h with aberrations

    def over_wavelengths(self) -> RadialBlur:
        """The blur whose weights are averaged over nearby wavelengths, for rays with a control variate.

        At a place of the blur, h of single wavelengths has rings at different radii. A ray then has one colour of the
        surface too much and the other too little, which is most of the noise on surfaces of one colour. Kernels
        averaged over wavelengths that differ by up to a fifth have nearly the same width. The difference, 0.1 % of
        contrast where it is 40 % and up to 4 % of the peak of a point's picture, is added from the picture of the
        control variate (``lacking`` of :class:`dasim.render.control_variate.Control`).
        """
        return self if self.averaged is None else replace(self, wave=self.averaged)

    def draw(self, first: Any, second: Any, blur_px: Any, slope: Any, key: Any) -> Drawn:
        """See :class:`Blur`."""
        import drjit as dr
        import mitsuba as mi

        expected = dr.abs(blur_px) * (self.outer / DENSITY_BLUR_STEP_PX)
        row = dr.minimum(mi.UInt32(dr.round(dr.minimum(expected, 1e6))), self.rows - 1)
        own = mi.Float(row) * DENSITY_BLUR_STEP_PX
        length, u, per_density = self._image_place(first, row)
        there, change = self._plane(dr.select(blur_px < 0, -own, own), self.outer * slope, u, length)
        side, own = there / 2, dr.abs(there)  # rho = 1 moves the image by -side
        rho = self._on_stop(u, side, length, own, key)
        delta = -u - rho * side
        volume = dr.abs(1 + dr.dot(rho, change) / 2)  # of d delta over d u
        weight = self._density(length, own) * per_density * volume
        return Drawn(self.centre + self.outer * rho, delta, weight, u, per_density)

    def _plane(self, blur: Any, slope: Any, u: Any, length: Any) -> tuple[Any, Any]:
        """Signed blur of the stop at the image position u if the surface is a plane, and its gradient over u.

        The plane extends to the edge of the geometric blur, but no farther than ``MOST_CHANGE`` of the in-focus pattern
        allows, because some rho must lead to u. Beyond this border, the blur is that at the border in the same
        direction.
        """
        import drjit as dr

        steep = dr.norm(slope)
        border = dr.minimum(dr.abs(blur) / 2 + self.core_px, MOST_CHANGE * self.tail_px / dr.maximum(steep, 1e-6))
        inside = length <= border
        towards = u / dr.maximum(length, 1e-6)
        along = dr.dot(slope, towards)
        around = (slope - towards * along) * (border / dr.maximum(length, 1e-6))
        return blur - along * dr.minimum(length, border), -dr.select(inside, slope, around)

    def draw_in_focus(self, first: Any, second: Any) -> Drawn:
        """See :class:`Blur`."""
        import mitsuba as mi

        length, u, per_density = self._image_place(first, mi.UInt32(0))
        return Drawn(mi.Point2f(0.0), -u, self._density(length, mi.Float(0.0)) * per_density, u, per_density)

    def _image_place(self, first: Any, row: Any) -> tuple[Any, Any, Any]:
        """Length of the sampled u, u itself, and its 1 / q, for the blur of a row of the tables."""
        import drjit as dr
        import mitsuba as mi

        place = first.x * GUIDE_NODES
        index = dr.minimum(mi.UInt32(place), GUIDE_NODES - 1)
        start = row * (GUIDE_NODES + 1) + index
        low, high = dr.gather(mi.Float, self.guide, start), dr.gather(mi.Float, self.guide, start + 1)
        length = dr.fma(place - mi.Float(index), high - low, low)
        per_density = GUIDE_NODES * (high - low) * 2 * dr.pi * dr.maximum(length, 1e-6)
        return length, length * _direction(first.y), per_density

    def control(self, fine: Fine, blur_px: FloatArray, spectrum: Spectrum) -> Control | None:
        """The control variate of a frame with these kernels, see :func:`control_variate.control`; None where they are
        too fine for its grid.

        Args:
            fine: the pinhole's picture, of the stop's bands.
            blur_px: signed visible blur at the middle of each pixel, [h, w].
            spectrum: of the stop.
        """
        points = self.points(spectrum, fine.cells)
        if points is None:
            return None

        def profiles(levels: FloatArray, radius: FloatArray) -> FloatArray:
            return self.profiles(spectrum, levels, radius, self.plain.averaged)

        def of_single(levels: FloatArray, radius: FloatArray) -> FloatArray:
            return self.profiles(spectrum, levels, radius)

        return control_variate.control(
            fine, blur_px, self.plain.outer, self.plain.centre, self.extent_px(spectrum), profiles, points, of_single
        )

    def extent_px(self, spectrum: Spectrum) -> float:
        """Radius at which the kernels in focus end, and how far others reach beyond the geometric blur."""
        return KERNEL_RINGS * float(spectrum.nm.max()) * self.plain.px_per_nm

    def points(self, spectrum: Spectrum, cells: int) -> int | None:
        """Points per pixel of a grid that has all of the kernels, see :func:`control_variate.points_of`."""
        return control_variate.points_of(float(spectrum.nm.min()) * self.plain.px_per_nm, cells)

    def profiles(
        self, spectrum: Spectrum, levels: FloatArray, radius: FloatArray, averaged: Float32Array | None = None
    ) -> FloatArray:
        """Kernels for visible blurs [level] at radii [radius] in pixels, weighted by a spectrum,
        [level, radius, band, channel].

        The kernels are those of single wavelengths, or of a table that is ``averaged`` over nearby ones.
        """
        table = self.plain.profiles if averaged is None else averaged
        total = np.zeros((len(levels), len(radius), *spectrum.weight.shape[1:]))
        for wavelength, moved, weight in zip(*spectrum, strict=True):
            scale = wavelength * self.plain.px_per_nm
            own = self.plain.outer * np.abs(levels - moved)
            rows, columns = own / (8 * scale) / WAVES_STEP, radius / scale / RADIUS_STEP
            at = np.meshgrid(rows, columns, indexing="ij")
            kernel = ndimage.map_coordinates(table, at, order=1, mode="nearest") / scale**2
            total += kernel[..., None, None] * weight
        return total

    def _on_stop(self, u: Any, side: Any, length: Any, own: Any, key: Any) -> Any:
        """Sample rho with density D(-u - rho side), by rejection.

        Where the blur is narrower than D, proposals are uniform on the ring and accepted with probability
        proportional to D. Where it is wider, rho side + u is proposed from D: its length r from the range in which the
        circle of radius r crosses the lens, accepted in proportion to the arc on the lens, and its direction within
        this arc. Few proposals are rejected, which matters because all rays wait for the last one.
        """
        import drjit as dr
        import mitsuba as mi

        reach = own / 2
        wide = own > self.core_px / 2
        nearest = dr.maximum(dr.maximum(length - reach, self.inner * reach - length), 0)
        columns = self.columns
        highest = self.envelope.eval(mi.Point1f(texel(nearest, DENSITY_STEP_PX, columns)))[0]
        # Wider by one step of the table on both sides; proposals that this adds are rejected.
        low = self._inside(nearest - DENSITY_STEP_PX)
        span = self._inside(length + reach + DENSITY_STEP_PX) - low
        towards = -u / dr.maximum(length, 1e-6)
        largest = dr.select(length > reach, dr.safe_asin(reach / length), dr.pi)  # half the angle of the widest part
        random = mi.PCG32(initstate=mi.UInt64(key), initseq=mi.UInt64(dr.arange(mi.UInt32, dr.width(u))))

        def again(random: Any, missing: Any, rho: Any) -> tuple[Any, Any, Any]:
            first, second, third = random.next_float32(), random.next_float32(), random.next_float32()
            place = dr.fma(first, span, low) * (OFFSET_NODES - 1)
            node = dr.minimum(mi.UInt32(place), OFFSET_NODES - 2)
            before, after = dr.gather(mi.Float, self.offsets, node), dr.gather(mi.Float, self.offsets, node + 1)
            r = dr.fma(place - mi.Float(node), after - before, before)
            cosine = (length * length + r * r - reach * reach) / dr.maximum(2 * length * r, 1e-12)
            half = dr.safe_acos(cosine)
            sine, cosine = dr.sincos(half * (2 * second - 1))
            turned = mi.Point2f(towards.x * cosine - towards.y * sine, towards.x * sine + towards.y * cosine)
            from_ring = dr.sqrt(dr.lerp(self.inner * self.inner, 1.0, first)) * _direction(second)
            proposed = dr.select(wide, (r * turned + u) / -side, from_ring)
            away = dr.norm(u + proposed * side)
            chance = self._density(away, mi.Float(0.0), ~wide) / highest
            accepted = dr.select(wide, third * largest < half, (third < chance) & (away <= self.tail_px))
            radius = dr.norm(proposed)
            accepted &= (radius >= self.inner) & (radius <= 1)
            return random, missing & ~accepted, dr.select(missing & accepted, proposed, rho)

        _, _, rho = dr.while_loop(
            state=(random, mi.Bool(dr.full(mi.Bool, True, dr.width(u))), mi.Point2f(0.0)),
            cond=lambda random, missing, rho: missing,
            body=again,
            labels=("random", "missing", "rho"),
        )
        return rho

    def _inside(self, length: Any) -> Any:
        """Share of D's light within a radius."""
        import mitsuba as mi

        return self.light_inside.eval(mi.Point1f(texel(length, DENSITY_STEP_PX, self.light_columns)))[0]

    def _density(self, length: Any, own: Any, active: Any = True) -> Any:
        import mitsuba as mi

        rows, columns = self.rows, self.columns
        place = mi.Point2f(texel(length, DENSITY_STEP_PX, columns), texel(own, DENSITY_BLUR_STEP_PX, rows))
        return self.density.eval(place, active)[0]

    def kernel(self, length: Any, own: Any, wavelength: Any) -> Any:
        """The kernel h per square pixel at a distance ``length`` from the centre for the blur ``own`` of the stop."""
        import mitsuba as mi

        scale = wavelength * self.px_per_nm
        column = texel(length / scale, RADIUS_STEP, self.wave_columns)
        return self.wave.eval(mi.Point2f(column, texel(own / (8 * scale), WAVES_STEP, self.wave_rows)))[0] / (
            scale * scale
        )

    def weights(self, u_px: Any, blur_px: Any, tangent: Any, wavelengths_nm: list[Any]) -> list[Any]:
        """See :class:`Blur`."""
        import drjit as dr
        import mitsuba as mi

        from_centre = u_px + self.centre * (blur_px / 2)
        scale_along = field_angle.scale_along(from_centre, tangent)
        u = scale_along * dr.norm(from_centre)
        own = scale_along * self.outer * dr.abs(blur_px)
        g = self._density(u, own)
        inside = (own <= self.max_blur_px) & (u <= self.max_radius_px)
        rows, columns = self.wave_rows, self.wave_columns
        ratios = []
        for wavelength in wavelengths_nm:
            if self.aberrated is None:
                h = self.kernel(u, own, wavelength)
            else:
                scale = wavelength * self.px_per_nm
                column = texel(u / scale, RADIUS_STEP, columns)

                def read(row: Any, column: Any = column) -> Any:
                    return self.wave.eval(mi.Point2f(column, (row + 0.5) / rows))

                waves = dr.select(blur_px < 0, -own, own) / (8 * scale)
                h = self.aberrated.evaluate(read, waves, wavelength, tangent) / (scale * scale)
            ratios.append(dr.select(inside, h / g, 1.0))
        return ratios


def _direction(turn: Any) -> Any:
    """Unit vector at a fraction of a full turn."""
    import drjit as dr
    import mitsuba as mi

    sine, cosine = dr.sincos(2 * dr.pi * turn)
    return mi.Point2f(cosine, sine)
