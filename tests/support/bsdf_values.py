"""Values of BSDFs at given points and wavelengths, in the variant named on the command line.

The tests compare these values between variants. Run as a program, the module prints them as JSON.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path

import numpy as np

SIZE = 8  # pixels per side of the pictures
UV = [(0.5 / SIZE, 0.5 / SIZE), (3.5 / SIZE, 5.5 / SIZE), (0.41, 0.77), (1.3, 0.2), (0.0, 0.6)]
WAVELENGTHS_NM = (431.0, 552.0, 655.0, 790.5)  # nodes of the JIT texture, which has no interpolation
TOWARDS = ((0.3, -0.2), (-0.5, 0.4))  # x, y of the directions of light and view


def surfaces() -> dict:
    """Surfaces by name: one for each way in which images mix materials."""
    from dasim.materials import library
    from dasim.materials.surfaces import Finished

    random = np.random.default_rng(5)
    image = random.random((SIZE, SIZE, 3)).astype(np.float32)
    mask = random.random((SIZE + 3, SIZE)).astype(np.float32)
    result = {rule: library.photograph_surface(image, rule, (2.0, 1.0)) for rule in library.NEAR_INFRARED_RULES}
    leaf, gilt = (library.surface(name, Path(".")) for name in ("leaf-green", "gold"))
    porcelain = library.surface("porcelain", Path("."))
    result["layers"] = library.Mixture(mask, result["dyed"], leaf, (1.0, 3.0))
    result["coated"] = library.Coated(result["layers"], 0.2)
    result["smooth"] = library.Coated(result["print"], 0.0)
    result["gilded"] = library.Mixture(mask, result["achromatic"], gilt, (1.5, 1.0))
    plain = library.photograph_surface(image, "achromatic")
    result["finished"] = Finished(plain, image[..., 0], 0.3 + 0.7 * image[..., 1], None)
    result["china"] = library.Mixture(mask, porcelain, library.Mixture(mask, leaf, gilt), (1.0, 1.0))
    return result


def directions() -> list[np.ndarray]:
    """Unit vectors to light and view, z along the normal."""
    return [np.array([x, y, np.sqrt(1 - x * x - y * y)]) for x, y in TOWARDS]


def values() -> dict[str, list[list[float]]]:
    """BSDF times cosine in the active variant: for each surface, [point][wavelength]."""
    import mitsuba as mi

    from dasim.render.reflection import surface_bsdf

    light, view = directions()
    result: dict[str, list[list[float]]] = {}
    for name, surface in surfaces().items():
        bsdf = surface_bsdf(surface, flip=False)
        result[name] = []
        for u, v in UV:
            si = mi.SurfaceInteraction3f()
            si.uv, si.wi = mi.Point2f(u, v), mi.Vector3f(*view.tolist())
            si.wavelengths = mi.Spectrum(*WAVELENGTHS_NM)
            value = bsdf.eval(mi.BSDFContext(), si, mi.Vector3f(*light.tolist()))
            result[name].append(np.array(value, float).ravel().tolist())
    return result


if __name__ == "__main__":
    import mitsuba as mi

    mi.set_variant(sys.argv[1])
    print(json.dumps(values()))
