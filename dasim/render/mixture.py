"""A mixture of diffuse spectra as one Mitsuba texture, for the JIT variants.

The texture has the values of nested ``blendbsdf`` plugins, which ``scalar_spectral`` uses, but is evaluated once per
intersection instead of once per leaf of the tree.

Tested in tests/dasim/render/test_reflection.py.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from functools import cache
from typing import Any

import numpy as np

from dasim.materials.surfaces import Diffuse, Mixture, Surface, leaves
from dasim.render.plugin import texture
from dasim.spectra.grid import WAVELENGTH_NM
from dasim.typing import Float32Array

# Spectra are looked up at the nearest node, which is twice as fast as linear interpolation. The error in wavelength is
# at most 0.125 nm, of both signs equally often, so that it has zero mean over random wavelengths.
FINE_STEP_NM = 0.25
_FINE_NM = np.arange(WAVELENGTH_NM[0], WAVELENGTH_NM[-1] + FINE_STEP_NM / 2, FINE_STEP_NM)

Images = list[tuple[Float32Array, tuple[float, float]]]  # each [y, x] with its repetitions along u and v

_numbers = itertools.count()
# Surfaces and gains by number, until their plugin reads them: a plugin's properties cannot hold Python objects.
_surfaces: dict[int, tuple[Mixture, float]] = {}


def mixture_dict(surface: Mixture, gain: float = 1.0) -> dict[str, Any]:
    """Mitsuba's description of a texture with the reflectance of a mixture of diffuse parts, times ``gain``."""
    _register()
    number = next(_numbers)
    _surfaces[number] = _as_print(surface), gain
    return {"type": "dasim_mixture", "number": number}


def _as_print(surface: Mixture) -> Mixture:
    """A photograph with a fourth weight image of zeros, as prints have four, so that both share compiled kernels."""
    images = [image for image, _ in _weight_images(surface)]
    if len(images) != 3 or len({image.shape for image in images}) > 1:
        return surface
    return Mixture(np.zeros_like(images[0]), surface, leaves(surface)[-1], surface.repeat)


def _weight_images(surface: Surface) -> Images:
    """Distinct weight images [y, x] of a tree of mixtures, each with its repetitions along u and v."""
    if not isinstance(surface, Mixture):
        return []
    images = [(surface.weight, surface.repeat), *_weight_images(surface.first), *_weight_images(surface.second)]
    distinct: Images = []
    for image, repeat in images:
        if not any(image is other and repeat == often for other, often in distinct):
            distinct.append((image, repeat))
    return distinct


def _mean(surface: Surface) -> float:
    """Mean reflectance over area and wavelength, if the weight images of nested mixtures are uncorrelated."""
    if isinstance(surface, Mixture):
        share = float(surface.weight.mean())
        return (1 - share) * _mean(surface.first) + share * _mean(surface.second)
    assert isinstance(surface, Diffuse)
    return float(surface.reflectance.mean())


def _stacked(images: Images, numbers: Sequence[int]) -> Any:
    """Some images as one texture; v = 0 is the bottom row, as for shapes."""
    import drjit as dr

    stack = np.stack([images[number][0][::-1] for number in numbers], axis=-1)
    return texture(stack, wrap_mode=dr.WrapMode.Clamp)


def _shares_of(surface: Surface, images: Images) -> Callable[[Any, Sequence[Any]], list[Any]]:
    """Function that maps a total weight and the weights of ``images`` at a point to the weights of the leaves of
    ``surface``, which add up to the total.
    """
    if not isinstance(surface, Mixture):
        return lambda whole, weights: [whole]
    first, second = (_shares_of(part, images) for part in (surface.first, surface.second))
    of_second = next(
        number for number, (image, repeat) in enumerate(images) if image is surface.weight and repeat == surface.repeat
    )

    def shares(whole: Any, weights: Sequence[Any]) -> list[Any]:
        share = whole * weights[of_second]
        return [*first(whole - share, weights), *second(share, weights)]

    return shares


@cache
def _register() -> None:
    import drjit as dr
    import mitsuba as mi

    def mirror(coordinate: Any) -> Any:
        """Texture coordinate in 0..1 after reflections at 0 and 1, once per lookup; ``WrapMode.Mirror`` does it four
        times, for each neighbouring pixel.
        """
        return dr.abs(coordinate - 2 * dr.round(0.5 * coordinate))

    class MixtureTexture(mi.Texture):
        """Reflectance spectrum of a tree of mixtures at a point of the surface."""

        def __init__(self, props: Any) -> None:
            super().__init__(props)
            surface, gain = _surfaces.pop(props["number"])  # Mitsuba reads each description once
            self.average = gain * _mean(surface)
            images = _weight_images(surface)
            # A function, not the surface: Dr.Jit traverses a plugin's attributes at each launch of a frozen function.
            self.shares_of = _shares_of(surface, images)
            self.count = len(images)
            # Images of the same size and repetition share one lookup.
            groups: dict[Any, list[int]] = {}
            for number, (image, repeat) in enumerate(images):
                groups.setdefault((image.shape, repeat), []).append(number)
            # Opaque values instead of literals: surfaces with the same number of images share one compiled kernel.
            self.groups = [
                ([dr.opaque(mi.Float, often) for often in repeat], numbers, _stacked(images, numbers))
                for (_, repeat), numbers in groups.items()
            ]
            spectra = [leaf.reflectance for leaf in leaves(surface) if isinstance(leaf, Diffuse)]
            table = np.stack([gain * np.interp(_FINE_NM, WAVELENGTH_NM, curve) for curve in spectra], axis=-1)
            self.spectra = texture(table, filter_mode=dr.FilterMode.Nearest)

        def eval(self, si: Any, active: Any = True) -> Any:
            weights: list[Any] = [None] * self.count
            for repeat, numbers, stack in self.groups:
                values = stack.eval(mi.Point2f(mirror(si.uv.x * repeat[0]), mirror(si.uv.y * repeat[1])), active)
                for number, value in zip(numbers, values, strict=True):
                    weights[number] = value
            shares = self.shares_of(mi.Float(1.0), weights)
            result = mi.Spectrum(0.0)
            for k in range(len(result)):
                position = (si.wavelengths[k] - float(_FINE_NM[0])) / FINE_STEP_NM + 0.5
                spectra = self.spectra.eval(mi.Point1f(position / len(_FINE_NM)), active)
                total = shares[0] * spectra[0]
                for share, value in zip(shares[1:], spectra[1:], strict=True):
                    total = dr.fma(share, value, total)
                result[k] = total
            return result

        def mean(self) -> Any:
            return mi.Float(self.average)

        def is_spatially_varying(self) -> bool:
            return True

        def to_string(self) -> str:
            return "MixtureTexture[]"

    mi.register_texture("dasim_mixture", lambda props: MixtureTexture(props))
