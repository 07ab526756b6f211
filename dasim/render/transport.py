"""Radiance along a ray: a path tracer that uses an irradiance field where one is known.

The rays of a pixel have different positions on the lens and different weights, so that stratifying the directions of
incident light does not cancel its noise: light from extended sources and from other surfaces accounts for most of the
noise and cost.

Tested in tests/dasim/render/test_passes.py.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from dasim.render import coats, lamps
from dasim.render.irradiance import Field, lambertian
from dasim.render.light_paths import power_heuristic
from dasim.render.translate import MAX_PATH_DEPTH

# Bounces of an integrator's path after which Russian roulette may end it. With Mitsuba's 5, a capture takes 8 to 12 %
# more processor time for 2 % less variance; with 2 the variance grows as fast as the time falls.
ROULETTE_DEPTH = 3


def path_integrator() -> Any:
    """The integrator that continues a path beyond its first surface."""
    import mitsuba as mi

    return mi.load_dict({"type": "path", "max_depth": MAX_PATH_DEPTH - 1, "rr_depth": ROULETTE_DEPTH})


def radiance(
    scene: Any,
    emitters: lamps.Chosen,
    integrator: Any,
    sampler: Any,
    ray: Any,
    si: Any,
    numbers: tuple[Any, Any, Any],
    field: Field | None,
    shifts: Sequence[Any] = (),
) -> Any:
    """Spectral radiance along ``ray``, whose first intersection is ``si``.

    Where ``field`` holds the irradiance from surrounding emitters and other surfaces, only lamps are sampled
    (:mod:`dasim.render.lamps`), and the gloss of coats (:mod:`dasim.render.coats`). Elsewhere, emitters and the
    scattering function are both sampled, and combined by the power heuristic.

    Args:
        scene: a Mitsuba scene.
        emitters: emitters sampled at the end of each ray, from :func:`lamps.chosen`.
        integrator: continues the path, see :func:`path_integrator`.
        sampler: random numbers of the integrator.
        ray: the ray, with its wavelengths.
        si: its surface interaction.
        numbers: uniform numbers: two for an emitter, two for a direction, one for a lobe of the scattering function.
        field: known irradiance, or None.
        shifts: offsets of texture coordinates; where irradiance is known, the reflectance is the mean over the end of
            the ray and the points at these offsets.
    """
    import drjit as dr
    import mitsuba as mi

    aim_at, place, lobe = numbers
    context, hit = mi.BSDFContext(), si.is_valid()
    bsdf = si.bsdf(ray)
    result = si.emitter(scene).eval(si)
    traced, glossy, even, grid = hit, mi.Bool(False), None, None
    if field is not None:
        coated = coats.coated(field.coats, bsdf, hit)
        irradiance, known, cell = field.at(si, hit & (lambertian(bsdf) | coated))
        glossy = known & coated
        grid = None if field.lamps is None else (field.lamps, cell)
        traced = hit & (~known | glossy)
        upright = mi.Vector3f(0.0, 0.0, dr.select(si.wi.z < 0, -1.0, 1.0))
        own, mean = dr.dispatch(bsdf, _own_and_mean, si, upright, list(shifts), active=known)
        even = lamps.Even(known, glossy, known & coats.coated(field.coats, bsdf, hit, coats.BARE), own, mean)
        result += dr.select(known, mean * irradiance, 0.0)
    result += lamps.light(scene, emitters, bsdf, si, aim_at, hit, even, grid)

    scattered, weight = bsdf.sample(context, si, lobe, place, traced & ~glossy)
    if field is not None:
        gloss = bsdf.sample(coats.gloss_context(), si, lobe, place, glossy)
        scattered, weight = dr.select(glossy, gloss[0], scattered), dr.select(glossy, gloss[1], weight)
    # An invalid sample, as below a surface's horizon, has weight 0 and no direction. NaN is not 0, and not hidden.
    traced &= ~dr.all(weight == 0)
    onward = si.spawn_ray(si.to_world(scattered.wo))
    met = scene.ray_intersect(onward, traced)
    emitted = dr.select(traced, met.emitter(scene).eval(met), 0.0)
    aim = lamps.density(scene, si, met, traced)
    smooth = ~mi.has_flag(scattered.sampled_type, mi.BSDFFlags.Delta)
    share = dr.select(smooth & (aim > 0), power_heuristic(scattered.pdf, aim), 1.0)
    beyond, _, _ = integrator.sample(scene, sampler, mi.RayDifferential3f(onward), active=traced)
    result += dr.select(traced, weight * (beyond - emitted * (1 - share)), 0.0)
    return result


def _own_and_mean(bsdf: Any, si: Any, upright: Any, shifts: list[Any], active: Any) -> tuple[Any, Any]:
    """Values of the base of a scattering function towards ``upright``, at ``si`` and the mean over it and the points at
    ``shifts``; one call of an instance for all of them.
    """
    import mitsuba as mi

    base = coats.base_context()
    own = bsdf.eval(base, si, upright, active)
    mean = mi.Spectrum(own)
    for shift in shifts:
        beside = mi.SurfaceInteraction3f(si)
        beside.uv += shift
        mean += bsdf.eval(base, beside, upright, active)
    return own, mean / (1 + len(shifts))
