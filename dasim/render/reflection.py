"""Surfaces as Mitsuba's scattering functions."""

from __future__ import annotations

from functools import cache
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np

from dasim.materials.surfaces import Coated, Diffuse, Glass, Metal, Mixture, Surface, flipped, is_diffuse
from dasim.render.mixture import mixture_dict
from dasim.render.plugin import spectrum_dict
from dasim.spectra.grid import WAVELENGTH_NM
from dasim.typing import FloatArray

GAUSS_NODES = 24  # the coat's transmittance is smooth: the integral is good to 1e-4


def surface_bsdf(surface: Surface, *, flip: bool) -> Any:
    """A surface that is the same from both sides, one instance for all objects that have it; glass lets light through.

    ``flip`` turns its images upside down.
    """
    import mitsuba as mi

    inner = _bsdf(flipped(surface) if flip else surface)
    return mi.load_dict(inner if isinstance(surface, Glass) else {"type": "twosided", "bsdf": inner})


def normal_reflectance(surface: Surface) -> FloatArray:
    """Reflectance 0..1 at normal incidence on ``WAVELENGTH_NM`` of a surface that is the same everywhere.

    Fresnel's equations for the air side of metals and glass (both sides of a thin pane), the gloss and the base of a
    coat. Roughness is left out.
    """
    match surface:
        case Diffuse():
            return surface.reflectance
        case Metal():
            eta, k = (_measured_index(surface.conductor, part) for part in ("eta", "k"))
            return ((eta - 1) ** 2 + k**2) / ((eta + 1) ** 2 + k**2)
        case Glass():
            gloss = _gloss(surface.refractive_index)
            return np.full(len(WAVELENGTH_NM), 2 * gloss / (1 + gloss) if surface.thin else gloss)
        case Coated():
            gloss = _gloss(surface.refractive_index)
            return gloss + (1 - gloss) * normal_reflectance(surface.base)
    raise TypeError("a textured surface has no one reflectance")


def _gloss(refractive_index: float) -> float:
    """Fresnel's reflectance of a clear surface at normal incidence."""
    return float(((refractive_index - 1) / (refractive_index + 1)) ** 2)


def _measured_index(conductor: str, part: str) -> FloatArray:
    """Real (``eta``) or imaginary (``k``) index of refraction, from the table that Mitsuba reads too."""
    found = find_spec("mitsuba")
    assert found is not None and found.origin is not None
    table = np.loadtxt(Path(found.origin).parent / "data" / "ior" / f"{conductor}.{part}.spd")
    assert table[0, 0] <= WAVELENGTH_NM[0] and table[-1, 0] >= WAVELENGTH_NM[-1], "outside, Mitsuba reads zeros"
    return np.interp(WAVELENGTH_NM, table[:, 0], table[:, 1])


def _bsdf(surface: Surface) -> dict[str, Any]:
    match surface:
        case Diffuse():
            return {"type": "diffuse", "reflectance": _spectrum(surface.reflectance)}
        case Mixture() if _is_jit() and is_diffuse(surface):
            return {"type": "diffuse", "reflectance": mixture_dict(surface)}
        case Mixture():
            return _blend(surface, _bsdf(surface.first), _bsdf(surface.second))
        case Metal():
            return {"material": surface.conductor, **_rough("conductor", surface.roughness)}
        case Glass():
            plugin = "thindielectric" if surface.thin else "dielectric"
            return {"type": plugin, "int_ior": surface.refractive_index, "ext_ior": 1.0}
        case Coated():
            return _coated(surface.base, surface)


def _coated(base: Surface, coat: Coated) -> dict[str, Any]:
    """A part of a base under its coat. The plugin is linear in the base's reflectance (``nonlinear`` is off), so
    coated parts mixed are the coated mixture.
    """
    if isinstance(base, Mixture) and not _is_jit():
        return _blend(base, _coated(base.first, coat), _coated(base.second, coat))
    gain = _coat_gain(coat.roughness, coat.refractive_index, _variant())
    if isinstance(base, Mixture):
        reflectance = mixture_dict(base, gain)
    else:
        assert isinstance(base, Diffuse)
        reflectance = _spectrum(gain * base.reflectance)
    return {
        "diffuse_reflectance": reflectance,
        "nonlinear": False,
        "int_ior": coat.refractive_index,
        "ext_ior": 1.0,
        **_rough("plastic", coat.roughness),
    }


@cache
def _coat_gain(roughness: float, refractive_index: float, variant: str) -> float:
    """What the base's reflectance is multiplied by under a rough coat.

    ``roughplastic`` loses what its microfacets reflect twice (a white base under alpha 0.2 reflects 0.80). The gain
    makes a white base reflect all but the gloss at normal incidence; at other angles it then reflects at most
    everything, and 0.9 at 80 degrees from alpha 0.3. The integral over the hemisphere is by Gauss's rule.
    """
    import mitsuba as mi

    if roughness == 0:
        return 1.0
    bare = {"diffuse_reflectance": {"type": "uniform", "value": 1.0}, "nonlinear": False, "specular_reflectance": 0.0}
    plugin = mi.load_dict({**bare, "int_ior": refractive_index, "ext_ior": 1.0, **_rough("plastic", roughness)})
    cosines, weights = np.polynomial.legendre.leggauss(GAUSS_NODES)
    cosines, weights = (cosines + 1) / 2, weights / 2
    albedo = 0.0
    for cosine, weight in zip(cosines, weights, strict=True):
        si = mi.SurfaceInteraction3f()
        si.wi, si.wavelengths = mi.Vector3f(0.0, 0.0, 1.0), mi.Spectrum(550.0)
        outward = mi.Vector3f(float(np.sqrt(1 - cosine**2)), 0.0, float(cosine))
        value = np.ravel(plugin.eval(mi.BSDFContext(), si, outward))[0]  # with the cosine
        albedo += 2 * np.pi * weight * float(value)
    return (1 - _gloss(refractive_index)) / albedo


def _rough(plugin: str, roughness: float) -> dict[str, Any]:
    if roughness == 0:
        return {"type": plugin}
    return {"type": f"rough{plugin}", "distribution": "ggx", "alpha": roughness}


def _blend(surface: Mixture, first: dict[str, Any], second: dict[str, Any]) -> dict[str, Any]:
    import mitsuba as mi

    # Mitsuba's v runs down from the bitmap's top row; shapes and mesh files have v = 0 at the bottom.
    weight = np.ascontiguousarray(surface.weight[::-1, :, None], dtype=np.float32)
    uv = mi.ScalarTransform4f().scale([*surface.repeat, 1.0])
    return {
        "type": "blendbsdf",
        "weight": {"type": "bitmap", "bitmap": mi.Bitmap(weight), "raw": True, "wrap_mode": "mirror", "to_uv": uv},
        "first": first,
        "second": second,
    }


def _spectrum(values: FloatArray) -> dict[str, Any]:
    """A curve for Mitsuba, whose sampled spectra must not be zero everywhere."""
    return spectrum_dict(values) if values.any() else {"type": "uniform", "value": 0.0}


def _variant() -> str:
    import mitsuba as mi

    return str(mi.variant())


def _is_jit() -> bool:
    return not _variant().startswith("scalar")
