"""Surfaces: materials as plain values for the renderer, free of names and files.

Tested in tests/dasim/materials/test_library.py.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dasim.typing import Float32Array, FloatArray

CLEAR_COAT_INDEX = 1.5  # refractive index of resins, varnishes and glazes
CROWN_GLASS_INDEX = 1.52  # refractive index


@dataclass(frozen=True)
class Diffuse:
    """A Lambertian surface with one reflectance spectrum 0..1, [wavelength] on ``WAVELENGTH_NM``."""

    reflectance: FloatArray


@dataclass(frozen=True)
class Mixture:
    """Two surfaces mixed by an image: ``weight``, [h, w] 0..1, top row first, is the share of ``second``."""

    weight: Float32Array
    first: Surface
    second: Surface
    repeat: tuple[float, float] = (1.0, 1.0)  # copies along u and v, every other one mirrored


@dataclass(frozen=True)
class Metal:
    """A bare metal with its measured complex refractive index; ``roughness`` is the GGX alpha, 0 for a mirror.

    Multiple reflection between microfacets is not modelled: rough metals lose some percent of light from alpha 0.3.
    """

    conductor: str  # Mitsuba's name of the measured constants
    roughness: float = 0.1


@dataclass(frozen=True)
class Glass:
    """Clear glass without absorption or dispersion; ``thin`` models a pane of two parallel faces as one sheet.

    A thin pane does not refract. Ground truth holds the first visible surface only, so that the true depth is that of
    the glass itself, not of objects behind it (likewise for mirrors); so is the depth for wave-optical blur.
    """

    refractive_index: float = CROWN_GLASS_INDEX
    thin: bool = False


@dataclass(frozen=True)
class Coated:
    """A diffuse base (paint, print, clay) under a clear coat whose GGX alpha is ``roughness``, 0 for a mirror gloss.

    The reflectance of the base is that measured through the coat (with an integrating sphere, specular excluded), so
    that it already contains multiple reflections inside the coat.
    """

    base: Diffuse | Mixture  # all leaves must be Diffuse
    roughness: float = 0.1
    refractive_index: float = CLEAR_COAT_INDEX


@dataclass(frozen=True)
class Finished:
    """Colours with glTF's finish: partly metal, of varying roughness, with a map of normals.

    Where ``metallic`` is 1, ``base`` is the reflectance of a metal at normal incidence, without diffuse light; where it
    is 0, a diffuse base under a gloss of index 1.5. All images have one size, their top row first.
    """

    base: Diffuse | Mixture  # all leaves must be Diffuse
    metallic: Float32Array  # [h, w] 0..1
    roughness: Float32Array  # [h, w] 0..1, the square root of the GGX alpha
    normal: Float32Array | None  # [h, w, xyz] encoded to 0..1, x along u, y along v; None: that of the surface


Surface = Diffuse | Mixture | Metal | Glass | Coated | Finished


def leaves(surface: Surface) -> list[Surface]:
    """Leaves of a tree of mixtures, those of ``first`` before those of ``second``."""
    return [*leaves(surface.first), *leaves(surface.second)] if isinstance(surface, Mixture) else [surface]


def is_diffuse(surface: Surface) -> bool:
    """Whether all leaves of a surface are Lambertian."""
    return all(isinstance(leaf, Diffuse) for leaf in leaves(surface))


def is_textured(surface: Surface) -> bool:
    """Whether a surface needs texture coordinates."""
    return isinstance(surface.base if isinstance(surface, Coated) else surface, Mixture | Finished)


def flip_images(surface: Surface) -> Surface:
    """A surface whose images are mirrored top to bottom; finishes, which are those of meshes, are not."""
    images: dict[int, Float32Array] = {}  # keeps images that the tree shares shared

    def turn(part: Surface) -> Surface:
        if not isinstance(part, Mixture):
            return part
        image = images.setdefault(id(part.weight), np.ascontiguousarray(part.weight[::-1]))
        return Mixture(image, turn(part.first), turn(part.second), part.repeat)

    if isinstance(surface, Coated):
        base = turn(surface.base)
        assert isinstance(base, Diffuse | Mixture)
        return Coated(base, surface.roughness, surface.refractive_index)
    return turn(surface)
