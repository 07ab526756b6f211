"""Values of surfaces' scattering functions at given points and wavelengths, in the variant named on the command line.

What the tests compare between variants; run as a program it prints them as JSON.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path

import numpy as np

SIZE = 8  # pixels a side of the pictures
UV = [(0.5 / SIZE, 0.5 / SIZE), (3.5 / SIZE, 5.5 / SIZE), (0.41, 0.77), (1.3, 0.2), (0.0, 0.6)]
WAVELENGTHS_NM = (431.0, 552.0, 655.0, 790.5)  # nodes of the JIT texture, which looks up the nearest
TOWARDS = ((0.3, -0.2), (-0.5, 0.4))  # x, y of the directions of light and view


def surfaces() -> dict:
    """A surface of every way that images mix materials."""
    from dasim.materials import library

    random = np.random.default_rng(5)
    image = random.random((SIZE, SIZE, 3)).astype(np.float32)
    mask = random.random((SIZE + 3, SIZE)).astype(np.float32)
    made = {rule: library.photograph_surface(image, rule, (2.0, 1.0)) for rule in library.NEAR_INFRARED_RULES}
    leaf, gilt = (library.surface(name, Path(".")) for name in ("leaf-green", "gold"))
    porcelain = library.surface("porcelain", Path("."))
    made["layers"] = library.Mixture(mask, made["dyed"], leaf, (1.0, 3.0))
    made["coated"] = library.Coated(made["layers"], 0.2)
    made["smooth"] = library.Coated(made["print"], 0.0)
    made["gilded"] = library.Mixture(mask, made["achromatic"], gilt, (1.5, 1.0))
    made["china"] = library.Mixture(mask, porcelain, library.Mixture(mask, leaf, gilt), (1.0, 1.0))
    return made


def directions() -> list[np.ndarray]:
    """Unit vectors to light and view, z along the normal."""
    return [np.array([x, y, np.sqrt(1 - x * x - y * y)]) for x, y in TOWARDS]


def values() -> dict[str, list[list[float]]]:
    """``surface: [[value a wavelength] a point]`` in the active variant, with the cosine."""
    import mitsuba as mi

    from dasim.render.reflection import surface_bsdf

    light, view = directions()
    found: dict[str, list[list[float]]] = {}
    for name, surface in surfaces().items():
        bsdf = surface_bsdf(surface, flip=False)
        found[name] = []
        for u, v in UV:
            si = mi.SurfaceInteraction3f()
            si.uv, si.wi = mi.Point2f(u, v), mi.Vector3f(*view.tolist())
            si.wavelengths = mi.Spectrum(*WAVELENGTHS_NM)
            value = bsdf.eval(mi.BSDFContext(), si, mi.Vector3f(*light.tolist()))
            found[name].append(np.array(value, float).ravel().tolist())
    return found


if __name__ == "__main__":
    import mitsuba as mi

    mi.set_variant(sys.argv[1])
    print(json.dumps(values()))
