"""Blur tables as textures, and the lookup of values in them.

Tested in tests/dasim/render/test_radial_blur.py and tests/dasim/render/test_aberrated_blur.py.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from dasim.camera import wavefront
from dasim.camera.wavefront import Phase, Wavefront
from dasim.render import plugin
from dasim.typing import FloatArray

FLOOR = 1e-12  # lower bound of densities per square pixel that are used as divisors
TURNS_STEP = 0.03  # RMS of the aberrations' change between two tabulated wavelengths, in waves


class Drawn(NamedTuple):
    """A sampled ray of a pixel."""

    rho: Any  # position on the stop, in radii of the lens
    delta: Any  # offset on the film of the point that the ray is aimed at, pixels
    weight: Any  # importance weight of the sampled rho and delta
    u: Any = (
        None  # position in the blur that was sampled first, about the image of the stop's centre; None where none was
    )
    per_density: Any = None  # inverse of the density of u, square pixels


def texture(values: Any, channels: bool = False) -> Any:
    """A texture of one to three dimensions, linear between its nodes; ``channels``: the last axis holds channels."""
    return plugin.texture(values if channels else values[..., None])


def texel(value: Any, step: float, nodes: Any) -> Any:
    """Texture coordinate of ``value`` on nodes 0, step, ...; the first node lies at half a texel."""
    return (value / step + 0.5) / nodes


def cut_off(
    profiles: FloatArray, radius: FloatArray, end: FloatArray, rings: float = 0.0, like: FloatArray | None = None
) -> FloatArray:
    """Profiles [waves, radius] truncated at a radius, with unit integral over the plane (linear between nodes).

    The light beyond ``end`` is redistributed over the profile in proportion to it. With ``like``, the profiles of the
    same pupil without its phase step, the core keeps its scale relative to theirs: a phase step sends several times as
    much light beyond ``end``, and this light is added close to the cut, in the outer half of the ``rings`` beyond the
    geometric blur.

    Args:
        profiles: intensity, [waves, radius].
        radius: radii of the nodes, [radius].
        end: radius at which each profile is truncated, [waves].
        rings: distance of ``end`` beyond the geometric blur.
        like: profiles without the phase step, [waves, radius].
    """
    inside = radius <= end[:, None]
    profiles = np.where(inside, profiles, 0.0)
    if like is None:
        return profiles / light(profiles, radius)
    profiles = profiles / light(np.where(inside, like, 0.0), radius)
    outer = np.where(radius > end[:, None] - rings / 2, profiles, 0.0)
    return np.asarray(profiles + outer * (1 - light(profiles, radius)) / light(outer, radius))


def light(profiles: FloatArray, radius: FloatArray) -> FloatArray:
    """Integral over the plane of profiles [waves, radius] that are linear between nodes, [waves, 1]."""
    low, high = radius[:-1], radius[1:]
    rings = profiles[:, :-1] * (2 * low + high) + profiles[:, 1:] * (low + 2 * high)
    return np.asarray((np.pi / 3 * rings * (high - low)).sum(axis=1, keepdims=True))


def away_from_axis(v: Any, tangent: Any) -> Any:
    """A vector of the picture by its parts along and across the direction away from the axis."""
    import drjit as dr
    import mitsuba as mi

    length = dr.norm(tangent)
    along = dr.select(length > 0, tangent / dr.maximum(length, 1e-12), mi.Point2f(1.0, 0.0))
    return mi.Point2f(dr.dot(v, along), v.y * along.x - v.x * along.y)


@dataclass(frozen=True)
class AberratedRows:
    """Row lookup in a table of aberrated kernels h by field angle, wavelength and defocus.

    Rows are ordered by field angle, then by wavelength in equal steps of 1 / lambda, then by defocus of both signs.
    With a phase step, the channels are h averaged over the phase, and the coefficients of the cosine and the sine of
    the phase.
    """

    rows: Any  # for each wavelength
    first_waves: Any
    waves_step: float
    inverse_first: Any  # 1/nm
    inverse_step: Any
    wavelengths: int
    angles: int
    angle_step: Any  # radians
    step_nm: Any | None

    def evaluate(self, read: Callable[[Any], Any], waves: Any, wavelength_nm: Any, tangent: Any) -> Any:
        """The kernel at a defocus, wavelength and field angle; ``read`` returns the table's channels at a row."""
        import drjit as dr
        import mitsuba as mi

        row = dr.clip((waves - self.first_waves) / self.waves_step, 0, mi.Float(self.rows - 1))
        wavelength = (dr.rcp(wavelength_nm) - self.inverse_first) / self.inverse_step
        angle = dr.atan(dr.norm(tangent)) / self.angle_step
        values = self._between(
            angle,
            self.angles,
            lambda a: self._between(
                wavelength,
                self.wavelengths,
                lambda w: read(row + mi.Float((a * self.wavelengths + w) * self.rows)),
            ),
        )
        if self.step_nm is None:
            return values[0]
        sine, cosine = dr.sincos(2 * dr.pi * self.step_nm / wavelength_nm)
        return values[0] + cosine * values[1] + sine * values[2]

    @staticmethod
    def _between(place: Any, count: int, values: Callable[[Any], Any]) -> Any:
        """Channels at a fractional node index, interpolated linearly; ``values`` returns the channels of a node."""
        import drjit as dr
        import mitsuba as mi

        if count == 1:
            return values(mi.UInt32(0))
        at = dr.clip(place, 0, count - 1)
        node = dr.minimum(mi.UInt32(at), count - 2)
        pairs = zip(values(node), values(node + 1), strict=True)
        return [dr.lerp(before, after, at - mi.Float(node)) for before, after in pairs]


def aberrated(
    fronts: Sequence[Wavefront],
    angle_step_deg: float,
    range_nm: tuple[float, float],
    waves: FloatArray,
    kernels: Callable[[Phase, FloatArray], FloatArray],
) -> tuple[AberratedRows, FloatArray]:
    """Row lookup and table of a stop's aberrated kernels; the table is [angle x wavelength x waves, ..., channel].

    Args:
        fronts: wavefronts of the light through the stop, at equal steps of the field angle from 0.
        angle_step_deg: step of the field angle.
        range_nm: shortest and longest wavelength.
        waves: evenly spaced values of defocus.
        kernels: kernels [waves, ...] of unit integral for a phase and values of defocus.
    """
    import drjit as dr
    import mitsuba as mi

    low, high = 1 / range_nm[1], 1 / range_nm[0]
    inverses = _wavelengths(fronts, low, high)
    table: FloatArray = np.zeros(0)
    for number, (front, inverse) in enumerate(itertools.product(fronts, inverses)):
        phase = wavefront.phase(front, 1 / inverse)
        if front.opening is None:
            part = kernels(phase, waves)[..., None]
        else:
            mean, cosine, sine = (kernels(phase._replace(step=step), waves) for step in (0.0, 1.0, 1j))
            part = np.stack([mean, cosine - mean, sine - mean], axis=-1)
        if number == 0:  # allocated once, because tables may take gigabytes
            table = np.empty((len(fronts) * len(inverses), *part.shape), np.float32)
        table[number] = part
    place = AberratedRows(
        rows=dr.opaque(mi.UInt32, len(waves)),
        first_waves=dr.opaque(mi.Float, float(waves[0])),
        waves_step=float(waves[1] - waves[0]),
        inverse_first=dr.opaque(mi.Float, low),
        inverse_step=dr.opaque(mi.Float, (high - low) / max(len(inverses) - 1, 1)),
        wavelengths=len(inverses),
        angles=len(fronts),
        angle_step=dr.opaque(mi.Float, float(np.radians(angle_step_deg))),
        step_nm=None if fronts[0].opening is None else dr.opaque(mi.Float, fronts[0].step_nm),
    )
    return place, table.reshape(-1, *table.shape[2:])


def aberrated_slices(fronts: Sequence[Wavefront], range_nm: tuple[float, float]) -> int:
    """Kernels per value of defocus in the table of :func:`aberrated`."""
    wavelengths = len(_wavelengths(fronts, 1 / range_nm[1], 1 / range_nm[0]))
    return len(fronts) * wavelengths * (1 if fronts[0].opening is None else 3)


def _wavelengths(fronts: Sequence[Wavefront], low: float, high: float) -> FloatArray:
    """Inverse wavelengths so close that the aberrations change by ``TURNS_STEP`` from one to the next."""
    fine = np.linspace(low, high, 9)
    change = 0.0
    for front in fronts:
        turns = np.array([np.array(wavefront.coefficients(front, 1 / inverse)) * inverse for inverse in fine])
        change = max(change, 8 * float(np.linalg.norm(np.diff(turns, axis=0), axis=1).max()))
    count = 1 + int(np.ceil(change / TURNS_STEP))
    return np.linspace(low, high, count) if count > 1 else np.array([(low + high) / 2])
