"""A diffuse surface's mixture of spectra as one Mitsuba texture, for the JIT variants.

It is what nested ``blendbsdf`` plugins describe (the way of ``scalar_spectral``), evaluated once a hit instead of
once a leaf of the tree.

Tested in tests/dasim/render/test_reflection.py.
"""

from __future__ import annotations

import itertools
from functools import cache
from typing import Any

import numpy as np

from dasim.materials.surfaces import Diffuse, Mixture, Surface, leaves
from dasim.render.plugin import tensor
from dasim.spectra.grid import WAVELENGTH_NM
from dasim.typing import Float32Array

# The nearest node is looked up, which is twice as fast as a line between two: off by at most an eighth of a nanometre,
# to either side alike, so that a drawn wavelength's error is none on the mean.
FINE_STEP_NM = 0.25
_FINE_NM = np.arange(WAVELENGTH_NM[0], WAVELENGTH_NM[-1] + FINE_STEP_NM / 2, FINE_STEP_NM)

_numbers = itertools.count()
_surfaces: dict[
    int, tuple[Mixture, float]
] = {}  # what a plugin's properties cannot carry, until the plugin has read it


def mixture_dict(surface: Mixture, gain: float = 1.0) -> dict[str, Any]:
    """Mitsuba's description of a mixture of diffuse parts as a texture, its reflectance multiplied by ``gain``."""
    _register()
    number = next(_numbers)
    _surfaces[number] = surface, gain
    return {"type": "dasim_mixture", "number": number}


def _places(surface: Surface) -> list[tuple[Float32Array, tuple[float, float]]]:
    """Weight images of a tree and how often they repeat, each once."""
    if not isinstance(surface, Mixture):
        return []
    found = [(surface.weight, surface.repeat), *_places(surface.first), *_places(surface.second)]
    kept: list[tuple[Float32Array, tuple[float, float]]] = []
    for image, repeat in found:
        if not any(image is other and repeat == often for other, often in kept):
            kept.append((image, repeat))
    return kept


def _mean(surface: Surface) -> float:
    """Mean reflectance over area and spectrum, from the mean of every image."""
    if isinstance(surface, Mixture):
        share = float(surface.weight.mean())
        return (1 - share) * _mean(surface.first) + share * _mean(surface.second)
    assert isinstance(surface, Diffuse)
    return float(surface.reflectance.mean())


@cache
def _register() -> None:
    import drjit as dr
    import mitsuba as mi

    def mirrored(place: Any) -> Any:
        """A texture coordinate folded into 0..1, as ``WrapMode.Mirror`` would for each of its four pixels in turn."""
        return dr.abs(place - 2 * dr.round(0.5 * place))

    class MixtureTexture(mi.Texture):
        """Reflectance spectrum of a tree of mixtures at a surface point."""

        def __init__(self, props: Any) -> None:
            super().__init__(props)
            self.surface, gain = _surfaces.pop(props["number"])  # each description is read once
            self.average = gain * _mean(self.surface)
            self.places = _places(self.surface)
            # Without a graphics card's own textures, whose interpolation has eight bits.
            # Images of one size and repeat are looked up together.
            groups: dict[Any, list[int]] = {}
            for number, (image, repeat) in enumerate(self.places):
                groups.setdefault((image.shape, repeat), []).append(number)
            # Opaque numbers, and everything else as arrays: surfaces with as many images share one compiled function.
            self.groups = [
                ([dr.opaque(mi.Float, often) for often in repeat], numbers, self._weights(numbers))
                for (_, repeat), numbers in groups.items()
            ]
            spectra = [leaf.reflectance for leaf in leaves(self.surface) if isinstance(leaf, Diffuse)]
            table = np.stack([gain * np.interp(_FINE_NM, WAVELENGTH_NM, curve) for curve in spectra], axis=-1)
            self.spectra = mi.Texture1f(tensor(table), use_accel=False, filter_mode=dr.FilterMode.Nearest)

        def _weights(self, numbers: list[int]) -> Any:
            # v = 0 is the bottom row, as in translate
            stack = np.stack([self.places[number][0][::-1] for number in numbers], axis=-1)
            return mi.Texture2f(tensor(stack), use_accel=False, wrap_mode=dr.WrapMode.Clamp)

        def eval(self, si: Any, active: Any = True) -> Any:
            weights: list[Any] = [None] * len(self.places)
            for repeat, numbers, texture in self.groups:
                found = texture.eval(mi.Point2f(mirrored(si.uv.x * repeat[0]), mirrored(si.uv.y * repeat[1])), active)
                for number, value in zip(numbers, found, strict=True):
                    weights[number] = value
            shares = self._shares(self.surface, mi.Float(1.0), weights)
            result = mi.Spectrum(0.0)
            for k in range(len(result)):
                place = (si.wavelengths[k] - float(_FINE_NM[0])) / FINE_STEP_NM + 0.5
                spectra = self.spectra.eval(mi.Point1f(place / len(_FINE_NM)), active)
                total = shares[0] * spectra[0]
                for share, value in zip(shares[1:], spectra[1:], strict=True):
                    total = dr.fma(share, value, total)
                result[k] = total
            return result

        def _shares(self, surface: Surface, whole: Any, weights: list[Any]) -> list[Any]:
            """Share of each leaf in the area of ``surface``, of which ``whole`` is there."""
            if not isinstance(surface, Mixture):
                return [whole]
            place = next(
                weight
                for weight, (image, repeat) in zip(weights, self.places, strict=True)
                if image is surface.weight and repeat == surface.repeat
            )
            second = whole * place
            return [
                *self._shares(surface.first, whole - second, weights),
                *self._shares(surface.second, second, weights),
            ]

        def mean(self) -> Any:
            return mi.Float(self.average)

        def is_spatially_varying(self) -> bool:
            return True

        def to_string(self) -> str:
            return "MixtureTexture[]"

    mi.register_texture("dasim_mixture", lambda props: MixtureTexture(props))
