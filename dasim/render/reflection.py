"""Translation of surfaces into Mitsuba's scattering functions (BSDFs)."""

from __future__ import annotations

from functools import cache
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np

from dasim.materials.surfaces import Coated, Diffuse, Finished, Glass, Metal, Mixture, Surface, flip_images, is_diffuse
from dasim.render.mixture import mixture_dict
from dasim.render.plugin import spectrum_dict
from dasim.spectra.grid import WAVELENGTH_NM
from dasim.typing import Float32Array, FloatArray

GAUSS_NODES = 24  # of the hemispherical integral, whose error is 1e-4: the transmittance of a coat is smooth


def surface_bsdf(surface: Surface, *, flip: bool) -> Any:
    """Mitsuba's BSDF of a surface: two-sided, except for glass, which transmits light.

    The result is an instance, which all objects of one material share.

    Args:
        surface: the surface.
        flip: whether its images are mirrored top to bottom, for shapes on which v runs the other way.
    """
    import mitsuba as mi

    inner = bsdf_dict(flip_images(surface) if flip else surface)
    return mi.load_dict(inner if isinstance(surface, Glass) else {"type": "twosided", "bsdf": inner})


def normal_reflectance(surface: Surface) -> FloatArray:
    """Reflectance 0..1 of a uniform surface at normal incidence, [wavelength], on ``WAVELENGTH_NM``.

    Metals and glass follow Fresnel's equations for light that comes from air; a thin pane reflects at both of its
    sides, with R = 2 r / (1 + r) for r at one. A coated surface has R = r + (1 - r) R_base. Roughness is neglected.
    Raises TypeError for a surface with images.
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
    raise TypeError("a textured surface has no single reflectance")


def _gloss(refractive_index: float) -> float:
    """Fresnel reflectance of a dielectric in air at normal incidence, ((n - 1) / (n + 1))^2."""
    return float(((refractive_index - 1) / (refractive_index + 1)) ** 2)


def _measured_index(conductor: str, part: str) -> FloatArray:
    """Real (``eta``) or imaginary (``k``) part of a metal's index of refraction, [wavelength], from Mitsuba's table."""
    package = find_spec("mitsuba")
    assert package is not None and package.origin is not None
    table = np.loadtxt(Path(package.origin).parent / "data" / "ior" / f"{conductor}.{part}.spd")
    assert table[0, 0] <= WAVELENGTH_NM[0] and table[-1, 0] >= WAVELENGTH_NM[-1], "Mitsuba's table is too short"
    return np.interp(WAVELENGTH_NM, table[:, 0], table[:, 1])


def bsdf_dict(surface: Surface) -> dict[str, Any]:
    """Mitsuba's description of a surface's one-sided BSDF in the active variant.

    The JIT variants evaluate a mixture of diffuse parts as one texture; every other mixture is a tree of blends.
    """
    match surface:
        case Diffuse():
            return {"type": "diffuse", "reflectance": _reflectance_dict(surface.reflectance)}
        case Mixture() if _is_jit() and is_diffuse(surface):
            return {"type": "diffuse", "reflectance": mixture_dict(surface)}
        case Mixture():
            return _blend_dict(surface, bsdf_dict(surface.first), bsdf_dict(surface.second))
        case Metal():
            # Not Mitsuba's names of the tables: kernels would depend on the number of their entries.
            index = {part: spectrum_dict(_measured_index(surface.conductor, part)) for part in ("eta", "k")}
            return index | _microfacet_dict("conductor", surface.roughness)
        case Glass():
            plugin = "thindielectric" if surface.thin else "dielectric"
            return {"type": plugin, "int_ior": surface.refractive_index, "ext_ior": 1.0}
        case Coated():
            return _coat_dict(surface.base, surface)
        case Finished():
            finished = _finish_dict(surface.base, surface)
            if surface.normal is None:
                return finished
            # Without a shadowing function, light is shaded by the cosine to the mapped normal alone, as in glTF.
            mapped = {"type": "normalmap", "normalmap": _bitmap(surface.normal), "use_shadowing_function": False}
            return mapped | {"bsdf": finished}


def _finish_dict(base: Surface, surface: Finished) -> dict[str, Any]:
    """Mitsuba's description of ``base``, or a part of it, with the metallic share and roughness of ``surface``.

    The plugin is that of Burley (2012), whose metal has the microfacets of glTF. It is affine in the reflectance of the
    base, so that a blend of parts equals the blend with that finish.
    """
    if isinstance(base, Mixture) and not _is_jit():
        return _blend_dict(base, _finish_dict(base.first, surface), _finish_dict(base.second, surface))
    assert isinstance(base, Diffuse | Mixture)
    return {
        "type": "principled",
        "base_color": mixture_dict(base) if isinstance(base, Mixture) else _reflectance_dict(base.reflectance),
        "metallic": _bitmap(surface.metallic[..., None]),
        "roughness": _bitmap(surface.roughness[..., None]),
        "specular": 0.5,  # of index 1.5
    }


def _coat_dict(base: Surface, coat: Coated) -> dict[str, Any]:
    """Mitsuba's description of ``base``, or a part of it, under a coat.

    The plugin is linear in the base's reflectance because ``nonlinear`` is off: a blend of coated parts equals the
    coated blend.
    """
    if isinstance(base, Mixture) and not _is_jit():
        return _blend_dict(base, _coat_dict(base.first, coat), _coat_dict(base.second, coat))
    gain = _coat_gain(coat.roughness, coat.refractive_index, _variant())
    if isinstance(base, Mixture):
        reflectance = mixture_dict(base, gain)
    else:
        assert isinstance(base, Diffuse)
        reflectance = _reflectance_dict(gain * base.reflectance)
    return {
        "diffuse_reflectance": reflectance,
        "nonlinear": False,
        "int_ior": coat.refractive_index,
        "ext_ior": 1.0,
        **_microfacet_dict("plastic", coat.roughness),
    }


@cache
def _coat_gain(roughness: float, refractive_index: float, variant: str) -> float:
    """Factor on the base's reflectance that compensates for the energy lost by Mitsuba's ``roughplastic``.

    The plugin leaves out light that its microfacets reflect more than once: a white base under alpha = 0.2 reflects
    only 0.80. With this factor a white base reflects 1 - r of the light at normal incidence, r being the Fresnel
    reflectance of the coat. At other angles it reflects at most 1, and 0.9 at 80 degrees for alpha = 0.3. The albedo
    is integrated over the hemisphere by Gauss-Legendre quadrature.
    """
    import mitsuba as mi

    if roughness == 0:
        return 1.0
    bare = {"diffuse_reflectance": {"type": "uniform", "value": 1.0}, "nonlinear": False, "specular_reflectance": 0.0}
    plugin = mi.load_dict(
        {**bare, "int_ior": refractive_index, "ext_ior": 1.0, **_microfacet_dict("plastic", roughness)}
    )
    cosines, weights = np.polynomial.legendre.leggauss(GAUSS_NODES)
    cosines, weights = (cosines + 1) / 2, weights / 2
    albedo = 0.0
    for cosine, weight in zip(cosines, weights, strict=True):
        si = mi.SurfaceInteraction3f()
        si.wi, si.wavelengths = mi.Vector3f(0.0, 0.0, 1.0), mi.Spectrum(550.0)
        outward = mi.Vector3f(float(np.sqrt(1 - cosine**2)), 0.0, float(cosine))
        value = np.ravel(plugin.eval(mi.BSDFContext(), si, outward))[0]  # includes the cosine
        albedo += 2 * np.pi * weight * float(value)
    return (1 - _gloss(refractive_index)) / albedo


def _microfacet_dict(plugin: str, roughness: float) -> dict[str, Any]:
    if roughness == 0:
        return {"type": plugin}
    return {"type": f"rough{plugin}", "distribution": "ggx", "alpha": roughness}


def _blend_dict(surface: Mixture, first: dict[str, Any], second: dict[str, Any]) -> dict[str, Any]:
    import mitsuba as mi

    uv = mi.ScalarTransform4f().scale([*surface.repeat, 1.0])
    return {
        "type": "blendbsdf",
        "weight": _bitmap(surface.weight[..., None]) | {"to_uv": uv},
        "first": first,
        "second": second,
    }


def _bitmap(image: FloatArray | Float32Array) -> dict[str, Any]:
    """Mitsuba's description of an image [h, w, channel] as plain numbers, mirrored at its borders."""
    import mitsuba as mi

    # v = 0 is the top row of Mitsuba's bitmaps, and the bottom of shapes and of mesh files.
    picture = mi.Bitmap(np.ascontiguousarray(image[::-1], dtype=np.float32))
    # "accel" as in :func:`dasim.render.plugin.texture`.
    return {"type": "bitmap", "bitmap": picture, "raw": True, "accel": False, "wrap_mode": "mirror"}


def _reflectance_dict(values: FloatArray) -> dict[str, Any]:
    """Mitsuba's description of a spectrum; its sampled spectra must not be zero everywhere."""
    return spectrum_dict(values) if values.any() else {"type": "uniform", "value": 0.0}


def _variant() -> str:
    import mitsuba as mi

    return str(mi.variant())


def _is_jit() -> bool:
    return not _variant().startswith("scalar")
