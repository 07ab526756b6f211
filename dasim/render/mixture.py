"""A surface's mixture of spectra as one Mitsuba texture, for the JIT variants.

It is what nested ``blendbsdf`` plugins describe (the way of ``scalar_spectral``), evaluated once a hit instead of
once a leaf of the tree: a print of eight overprints and black renders about four times faster.
"""

from __future__ import annotations

import itertools
from functools import cache
from typing import Any

import numpy as np

from dasim.materials import Diffuse, Mixture, Surface
from dasim.spectra import WAVELENGTH_NM

_numbers = itertools.count()
_surfaces: dict[int, Mixture] = {}  # what a plugin's properties cannot carry, until the plugin has read it


def mixture_dict(surface: Mixture) -> dict[str, Any]:
    """Mitsuba's description of a mixture as a texture."""
    _register()
    number = next(_numbers)
    _surfaces[number] = surface
    return {"type": "dasim_mixture", "number": number}


def _leaves(surface: Surface) -> list[Diffuse]:
    return [surface] if isinstance(surface, Diffuse) else [*_leaves(surface.first), *_leaves(surface.second)]


def _images(surface: Surface) -> list[Any]:
    """Weight images of a tree, each once."""
    if isinstance(surface, Diffuse):
        return []
    found = [surface.weight, *_images(surface.first), *_images(surface.second)]
    return [image for index, image in enumerate(found) if not any(image is other for other in found[:index])]


@cache
def _register() -> None:
    import drjit as dr
    import mitsuba as mi

    class MixtureTexture(mi.Texture):
        """Reflectance spectrum of a tree of mixtures at a surface point."""

        def __init__(self, props: Any) -> None:
            super().__init__(props)
            self.surface = _surfaces.pop(props["number"])  # each description is read once
            self.images = _images(self.surface)
            # v = 0 is the bottom row, as in translate
            weights = np.stack([image[::-1] for image in self.images], axis=-1)
            self.weights = mi.Texture2f(mi.TensorXf(weights.astype(np.float32)), wrap_mode=dr.WrapMode.Mirror)
            spectra = np.stack([leaf.reflectance for leaf in _leaves(self.surface)], axis=-1)
            self.spectra = mi.Texture1f(mi.TensorXf(spectra.astype(np.float32)))

        def eval(self, si: Any, active: Any = True) -> Any:
            repeat = self.surface.repeat
            weights = self.weights.eval(mi.Point2f(si.uv.x * repeat[0], si.uv.y * repeat[1]), active)
            result = mi.Spectrum(0.0)
            nodes = len(WAVELENGTH_NM)
            span = float(WAVELENGTH_NM[-1] - WAVELENGTH_NM[0])
            for k in range(4):
                place = (si.wavelengths[k] - float(WAVELENGTH_NM[0])) / span * (nodes - 1)
                leaves = iter(self.spectra.eval(mi.Point1f((place + 0.5) / nodes), active))
                result[k] = self._mixed(self.surface, weights, leaves)
            return result

        def _mixed(self, surface: Surface, weights: list[Any], leaves: Any) -> Any:
            if isinstance(surface, Diffuse):
                return next(leaves)
            first = self._mixed(surface.first, weights, leaves)
            second = self._mixed(surface.second, weights, leaves)
            share = weights[next(i for i, image in enumerate(self.images) if image is surface.weight)]
            return dr.fma(share, second - first, first)

        def mean(self) -> Any:
            return mi.Float(0.5)  # only steers light sampling of textured lights, which there are none of

        def is_spatially_varying(self) -> bool:
            return True

        def to_string(self) -> str:
            return "MixtureTexture[]"

    mi.register_texture("dasim_mixture", lambda props: MixtureTexture(props))
