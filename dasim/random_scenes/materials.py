"""Materials of random scenes: library materials, blends, prints, photographs, clear coats, a few metals and glass.

Tested in tests/dasim/random_scenes/test_scene.py.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from dasim.materials.library import (
    MOST_REPEATS,
    Blend,
    Coating,
    GlassBody,
    Layer,
    MetalFinish,
    Mix,
    Photo,
    Print,
    Texture,
    diffuse_names,
)

Random = np.random.Generator

PHOTOGRAPHS = (
    *("skimage:astronaut", "skimage:camera", "skimage:chelsea", "skimage:coffee", "skimage:coins"),
    *("skimage:motorcycle_left", "skimage:motorcycle_right", "skimage:hubble_deep_field", "skimage:rocket"),
    "skimage:text",
)
STRUCTURES = ("skimage:brick", "skimage:grass", "skimage:gravel")
PATTERNS = ("noise", "dead-leaves", "weave", "wood-grain", "petal", "skin", "leaf-veins", "stripes", "checkerboard")
PATTERN_SEEDS = 8  # few, so that scenes share cached patterns, which take about a second each
PALETTE = (3, 3)  # photographs and structures per scene; few, so that each is read once and shown several times

FLOORS = (
    *("wood-light", "wood-dark", "cardboard", "concrete-light", "concrete-dark", "sand", "soil", "terracotta"),
    *("denim", "cotton-white", "cotton-undyed", "cotton-red", "cotton-green", "cotton-blue", "wool-undyed"),
    *("leather-brown", "ceramic-white", "polyester-black"),
)
WALLS = (
    *("paint-white", "brick", "mortar", "concrete-light", "concrete-dark", "newsprint", "wood-light", "wood-dark"),
    *("cotton-undyed", "cotton-blue", "cotton-green", "terracotta", "cardboard", "checker-neutral-6.5", "leaf-green"),
)
METALS = ("aluminium", "chromium", "copper", "gold", "silver", "tungsten")


class Shares(NamedTuple):
    """Probabilities 0..1 that an object's surface is textured, coated, metal or glass; the rest is plain and matt."""

    textured: float
    glossy: float
    metal: float
    glass: float


class Palette(NamedTuple):
    """The image names of a scene: photographs, and structures without an obvious subject."""

    photographs: tuple[str, ...]
    structures: tuple[str, ...]


class Surface(NamedTuple):
    """A material with its name in the scene; where ``texture`` is None, the name is that of a library material."""

    name: str
    texture: Texture | None

    @property
    def is_glass(self) -> bool:
        """Whether the material is solid glass, which is for closed bodies only."""
        return isinstance(self.texture, GlassBody)

    @property
    def needs_uv(self) -> bool:
        """Whether the material needs texture coordinates."""
        base = self.texture.base if isinstance(self.texture, Coating) else self.texture
        return isinstance(base, Blend | Print | Photo | Mix)


class Stock(NamedTuple):
    """The surfaces and pictures that the objects of a scene share.

    The first surface is plain and matt, so that every shape has a surface that suits it.
    """

    surfaces: tuple[Surface, ...]
    pictures: tuple[Surface, ...]

    def special(self) -> set[str]:
        """Names of metals and glass."""
        return {item.name for item in self.surfaces if isinstance(item.texture, MetalFinish | GlassBody)}


def stock(generators: list[Random], images: Palette, shares: Shares) -> Stock:
    """Draw one surface per generator, and make one picture per photograph of the palette.

    Objects share surfaces, since each surface costs the renderer about 0.3 s of preparation.
    """
    textures = [_object_surface(random, images, shares) for random in generators]
    textures[0] = str(generators[0].choice(diffuse_names()))
    surfaces = [
        Surface(texture, None) if isinstance(texture, str) else Surface(f"surface {number + 1}", texture)
        for number, texture in enumerate(textures)
    ]
    pictures = [
        Surface(f"picture {number + 1}", _picture(generators[0], image))
        for number, image in enumerate(images.photographs)
    ]
    return Stock(tuple(surfaces), tuple(pictures))


def palette(random: Random, images: tuple[str, ...]) -> Palette:
    """Draw the photographs (from ``images``, unless it is empty) and structures of a scene, without replacement."""
    photographs = images or PHOTOGRAPHS
    numbers = random.permutation(len(photographs))[: PALETTE[0]]
    structures = []
    for name in random.choice([*STRUCTURES, *PATTERNS, *PATTERNS], PALETTE[1], replace=False):
        is_photograph = str(name).startswith("skimage:")
        number = {
            "stripes": int(random.integers(6, 40)),
            "checkerboard": int(random.integers(6, 24)),
            "weave": int(random.integers(24, 80)),
            "leaf-veins": int(random.integers(5, 14)),
        }.get(str(name), int(random.integers(PATTERN_SEEDS)))
        structures.append(str(name) if is_photograph else f"pattern:{name}:{number}")
    return Palette(tuple(photographs[number] for number in numbers), tuple(structures))


def background(
    random: Random, names: tuple[str, ...], images: Palette, textured: float, copies: float
) -> Texture | str:
    """Draw the material of a floor or wall.

    With the probability ``textured`` it is a blend of two materials of ``names`` by a structure that repeats ``copies``
    times along a side, or as often as a texture can, otherwise one of them alone.
    """
    first, second = (str(name) for name in random.choice(names, 2, replace=False))
    image = str(random.choice(images.structures))
    stretch = float(np.exp(random.uniform(-0.3, 0.3)))
    if random.random() >= textured:
        return first
    repeat = (_rounded(min(copies * stretch, MOST_REPEATS)), _rounded(min(copies / stretch, MOST_REPEATS)))
    return Blend(kind="blend", image=image, repeat=repeat, dark=first, bright=second)


def _picture(random: Random, image: str) -> Texture:
    """Draw a poster or card: a print, with a probability of 0.15 under a lamination too matt to mirror lamps."""
    base = Print(kind="print", image=image, black_generation=_rounded(random.uniform(0.3, 0.9)))
    rough = _rounded(random.uniform(0.2, 0.4))
    return Coating(kind="coated", base=base, roughness=rough) if random.random() < 0.15 else base


def _object_surface(random: Random, images: Palette, shares: Shares) -> Texture | str:
    """Draw the surface of an object by the probabilities ``shares``."""
    kind, texture, which = random.random(3)
    first, other = (str(name) for name in random.choice(diffuse_names(), 2, replace=False))
    repeat = _rounded(float(np.exp(random.uniform(np.log(0.5), np.log(3.0)))))
    structure, photograph = (str(random.choice(kind)) for kind in (images.structures, images.photographs))
    rough, metal = _rounded(random.uniform(0.15, 0.4)), str(random.choice(METALS))
    rule = ("dyed", "achromatic")[int(random.integers(2))]
    if kind < shares.metal:
        return MetalFinish(kind="metal", metal=metal, roughness=rough)  # type: ignore[arg-type]
    if kind < shares.metal + shares.glass:
        return GlassBody(kind="glass")
    base: Blend | Print | Photo | Mix | str = first
    if texture < shares.textured:
        if which < 0.55:
            base = Blend(kind="blend", image=structure, repeat=(repeat, repeat), dark=first, bright=other)
        elif which < 0.75:
            base = Print(kind="print", image=photograph)
        elif which < 0.9:
            base = Photo(kind="photo", image=photograph, rule=rule)  # type: ignore[arg-type]
        else:
            layer = Layer(material=other, mask=structure, repeat=(repeat, repeat))
            base = Mix(kind="mix", base=first, layers=(layer,))
    glossy = kind < shares.metal + shares.glass + shares.glossy
    return Coating(kind="coated", base=base, roughness=rough) if glossy else base


def _rounded(value: float) -> float:
    return round(float(value), 3)
