"""A path tracer that keeps the light of each spectrum apart (JIT variants).

It is Mitsuba's ``path`` with one sum per light: all lights share the rays, so that several cost little more than one.

Tested in tests/dasim/render/test_light_spectra.py.
"""

from __future__ import annotations

from typing import Any

from dasim.render.light_spectra import Shares
from dasim.render.translate import MAX_PATH_DEPTH


def radiance_by_light(scene: Any, sampler: Any, ray: Any, active: Any, shares: Shares) -> list[Any]:
    """Spectral radiance along ``ray`` from each light, where ``ray`` continues a path beyond its first surface.

    Emitters and scattering functions are sampled at every surface and combined by the power heuristic.

    Args:
        scene: a Mitsuba scene.
        sampler: random numbers.
        ray: the ray, with its wavelengths.
        active: mask of the rays to trace.
        shares: the share of each light in the light of each emitter.
    """
    import drjit as dr
    import mitsuba as mi

    context, wavelengths = mi.BSDFContext(), mi.Spectrum(ray.wavelengths)

    def add(sums: list[Any], value: Any, emitter: Any, direction: Any, where: Any) -> list[Any]:
        parts = shares.of(emitter, direction, wavelengths, where)
        return [
            mi.Spectrum(dr.select(where, dr.fma(value, part, old), old)) for old, part in zip(sums, parts, strict=True)
        ]

    def body(state: tuple[Any, ...]) -> tuple[Any, ...]:
        active, depth, ray, throughput, sums, before, density, delta, sampler = state
        si = scene.ray_intersect(ray, active)
        emitter = si.emitter(scene, active)
        met = active & (emitter != None)  # noqa: E711
        aim = scene.pdf_emitter_direction(before, mi.DirectionSample3f(scene, si, before), met & ~delta)
        share = dr.select(~delta & (aim > 0), power_heuristic(density, aim), 1.0)
        sums = add(sums, throughput * emitter.eval(si, met) * share, emitter, ray.d, met)

        active = active & si.is_valid() & (depth + 1 < MAX_PATH_DEPTH - 1)
        bsdf = si.bsdf(ray)
        smooth = active & mi.has_flag(bsdf.flags(), mi.BSDFFlags.Smooth)
        aimed, light = scene.sample_emitter_direction(si, sampler.next_2d(), True, smooth)
        reachable = smooth & (aimed.pdf > 0) & dr.isfinite(aimed.pdf)
        value, other = bsdf.eval_pdf(context, si, si.to_local(aimed.d), reachable)
        share = dr.select(aimed.delta, 1.0, power_heuristic(aimed.pdf, other))
        sums = add(sums, throughput * value * light * share, aimed.emitter, aimed.d, reachable)

        lobe, place = sampler.next_1d(), sampler.next_2d()
        scattered, weight = bsdf.sample(context, si, lobe, place, active)
        onward = mi.RayDifferential3f(si.spawn_ray(si.to_world(scattered.wo)))
        throughput = throughput * weight
        active = active & dr.any(throughput != 0)
        delta = mi.has_flag(scattered.sampled_type, mi.BSDFFlags.Delta)
        return active, depth + 1, onward, throughput, sums, si, mi.Float(scattered.pdf), delta, sampler

    nothing = [mi.Spectrum(0.0) for _ in range(shares.count)]
    start = (
        mi.Bool(active),
        mi.UInt32(0),
        mi.RayDifferential3f(ray),
        mi.Spectrum(1.0),
        nothing,
        dr.zeros(mi.SurfaceInteraction3f),
        mi.Float(1.0),
        mi.Bool(True),
        sampler,
    )
    end = dr.while_loop(start, lambda *state: state[0], lambda *state: body(state), label="light paths")
    return list(end[4])


def power_heuristic(density: Any, other: Any) -> Any:
    """Weight of a sample of ``density`` that a sampler of density ``other`` could also give (Veach 1997, sec. 9.2)."""
    ratio = other / density  # squares of large densities would not be finite
    return 1 / (1 + ratio * ratio)
