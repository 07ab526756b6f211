"""What the renderer gets of a material: a surface as a value, without names or files.

Tested in tests/dasim/materials/test_library.py.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dasim.typing import Float32Array, FloatArray

CLEAR_COAT_INDEX = 1.5  # of resins, varnishes and glazes
CROWN_GLASS_INDEX = 1.52


@dataclass(frozen=True)
class Diffuse:
    """A Lambertian surface of one reflectance spectrum."""

    reflectance: FloatArray


@dataclass(frozen=True)
class Mixture:
    """``first`` and ``second`` mixed by an image of the second's share, [h, w] 0..1, top row first."""

    weight: Float32Array
    first: Surface
    second: Surface
    repeat: tuple[float, float] = (1.0, 1.0)  # copies along u and v, every other one mirrored


@dataclass(frozen=True)
class Metal:
    """A bare metal by its measured complex index of refraction; ``roughness`` is the GGX alpha, 0 is a mirror.

    Rough metals lose what would be reflected twice within the microfacets (some percent from alpha 0.3).
    """

    conductor: str  # Mitsuba's name of the measured constants
    roughness: float = 0.1


@dataclass(frozen=True)
class Glass:
    """Clear glass without absorption; ``thin`` is a pane of two parallel sides as one sheet, without refraction.

    Its true depth is that of the glass: ground truth knows the first surface only, here as for mirrors. Blur that is
    wave-true is that of the glass' own depth too. The index is the same at all wavelengths.
    """

    refractive_index: float = CROWN_GLASS_INDEX
    thin: bool = False


@dataclass(frozen=True)
class Coated:
    """Diffuse paint, print or clay under a clear coat that adds a gloss; ``roughness`` 0 is a mirror gloss.

    The base's reflectance is the one seen through the coat (as a sphere measures it without its gloss), so what is
    reflected twice inside the coat is in it already.
    """

    base: Diffuse | Mixture  # of diffuse parts only
    roughness: float = 0.1
    refractive_index: float = CLEAR_COAT_INDEX


Surface = Diffuse | Mixture | Metal | Glass | Coated


def leaves(surface: Surface) -> list[Surface]:
    """The parts that a tree of mixtures ends in, first before second."""
    return [*leaves(surface.first), *leaves(surface.second)] if isinstance(surface, Mixture) else [surface]


def is_diffuse(surface: Surface) -> bool:
    """Whether all parts of a surface are Lambertian."""
    return all(isinstance(leaf, Diffuse) for leaf in leaves(surface))


def is_textured(surface: Surface) -> bool:
    """Whether a surface needs texture coordinates."""
    return isinstance(surface.base if isinstance(surface, Coated) else surface, Mixture)


def flipped(surface: Surface) -> Surface:
    """The surface with its images upside down."""
    images: dict[int, Float32Array] = {}  # an image that a tree shares stays shared

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
