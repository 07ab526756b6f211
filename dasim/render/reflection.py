"""Surfaces as Mitsuba's scattering functions."""

from __future__ import annotations

from typing import Any

import numpy as np

from dasim import materials
from dasim.materials import Diffuse, Surface
from dasim.render.mixture import mixture_dict
from dasim.render.plugin import spectrum_dict


def surface_bsdf(surface: Surface, *, flip: bool) -> Any:
    """A two-sided surface, one instance for all objects that have it."""
    import mitsuba as mi

    return mi.load_dict({"type": "twosided", "bsdf": _bsdf(materials.flipped(surface) if flip else surface)})


def _bsdf(surface: Surface) -> dict[str, Any]:
    import mitsuba as mi

    if isinstance(surface, Diffuse):
        return {"type": "diffuse", "reflectance": spectrum_dict(surface.reflectance)}
    if not mi.variant().startswith("scalar"):
        return {"type": "diffuse", "reflectance": mixture_dict(surface)}
    # Mitsuba's v runs down from the bitmap's top row; shapes and mesh files have v = 0 at the bottom.
    weight = np.ascontiguousarray(surface.weight[::-1, :, None], dtype=np.float32)
    uv = mi.ScalarTransform4f().scale([*surface.repeat, 1.0])
    return {
        "type": "blendbsdf",
        "weight": {"type": "bitmap", "bitmap": mi.Bitmap(weight), "raw": True, "wrap_mode": "mirror", "to_uv": uv},
        "first": _bsdf(surface.first),
        "second": _bsdf(surface.second),
    }
