"""Diffuse reflection beneath a dielectric coat (JIT variants).

A coat, Mitsuba's ``plastic`` or ``roughplastic``, reflects a part of the light at its surface (gloss), and transmits
the rest to a Lambertian base and back. The light from the base is the product of the transmittances towards the light
and towards the camera, and of a factor of the base. It is therefore in proportion to the irradiance weighted by the
transmittance towards the light, which changes as little from pixel to pixel as that of a Lambertian surface: the
irradiance field holds it, and only gloss needs scattered rays. With scattered rays for both, coated surfaces had up to
twenty times the noise of bare ones.

Nodes do not know which surfaces are coated. Where a coated and a bare surface lie in one plane, such as a card on a
table, those of both are averaged, and the light of a dome is up to 1.6 % off within some three pixels of the border.

Tested in tests/dasim/render/test_coats.py.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from dasim.render.plugin import aligned

COATS = {"SmoothPlastic", "RoughPlastic"}
COATED, BARE = 1, 2  # kinds of surfaces in :func:`table`; 0 for all others
LEAST_ENTRIES = 256  # of the table, so that most scenes have one of the same size


def table(scene: Any) -> Any:
    """The kind of each BSDF of a scene, by Dr.Jit's numbers of the BSDFs: a coat over one base, or a bare Lambertian
    reflector; either on one side or on both.
    """
    import drjit as dr
    import mitsuba as mi

    bsdfs = {shape.bsdf() for shape in scene.shapes()}
    numbers = {int(dr.reinterpret_array(mi.UInt32, mi.BSDFPtr(bsdf))[0]): _kind(bsdf) for bsdf in bsdfs}
    entries = np.zeros(max(LEAST_ENTRIES, 1 << max(numbers).bit_length()) if numbers else LEAST_ENTRIES, np.uint32)
    entries[list(numbers)] = list(numbers.values())
    return mi.UInt32(aligned(entries))


def _kind(bsdf: Any) -> int:
    import mitsuba as mi

    first, *others = [part.class_name() for part in mi.traverse(bsdf).hierarchy if isinstance(part, mi.BSDF)]
    if first == "TwoSidedBRDF" and len(others) == 1:
        first, others = others[0], []
    kind = COATED if first in COATS else BARE if first == "SmoothDiffuse" else 0
    return 0 if others else kind


def coated(entries: Any, bsdf: Any, active: Any, kind: int = COATED) -> Any:
    """Whether the BSDF of each ray is a coat, or of another ``kind``, by the ``entries`` of :func:`table`."""
    import drjit as dr
    import mitsuba as mi

    number = dr.reinterpret_array(mi.UInt32, bsdf)
    active = active & (number < dr.width(entries))
    return active & (dr.gather(mi.UInt32, entries, number, active) == kind)


def base_context() -> Any:
    """Mitsuba's context of the base alone; it has all of a Lambertian surface."""
    import mitsuba as mi

    context = mi.BSDFContext()
    context.type_mask = int(mi.BSDFFlags.DiffuseReflection)
    return context


def gloss_context() -> Any:
    """Mitsuba's context of the coat's surface alone."""
    import mitsuba as mi

    context = mi.BSDFContext()
    context.type_mask = int(mi.BSDFFlags.All) & ~int(mi.BSDFFlags.DiffuseReflection)
    return context


def transmittance(bsdf: Any, si: Any, direction: Any, active: Any) -> Any:
    """Transmittance of the coat along a ``direction`` over that along the normal; 1 where ``active`` is not set."""
    import drjit as dr
    import mitsuba as mi

    context, local = base_context(), si.to_local(direction)
    upright = mi.Vector3f(0.0, 0.0, dr.select(si.wi.z < 0, -1.0, 1.0))
    along, normal = (dr.sum(bsdf.eval(context, si, mi.Vector3f(way), active)) for way in (local, upright))
    whole = normal * dr.abs(local.z)
    return dr.select(active & (whole > 0), along / whole, 1.0)
