"""Materials that are drawn: library names, blends of two, prints, dyed cloth, glosses, now and then metal or glass.

Tested in tests/dasim/random_scenes/test_specification.py.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from dasim.materials.library import (
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
PATTERN_SEEDS = 8  # few, so that many scenes share what takes a second to make
PALETTE = (3, 3)  # photographs and structures that a scene uses: what it shows twice is read once

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
    """How often a surface is textured, coated, metal and glass; the rest is plain and matt."""

    textured: float
    glossy: float
    metal: float
    glass: float


class Palette(NamedTuple):
    """The images of a scene."""

    photographs: tuple[str, ...]
    structures: tuple[str, ...]


class Surface(NamedTuple):
    """A material by its name in the scene, or in the library where ``texture`` is None."""

    name: str
    texture: Texture | None

    @property
    def is_glass(self) -> bool:
        """Whether only closed bodies may be made of it."""
        return isinstance(self.texture, GlassBody)

    @property
    def textured(self) -> bool:
        """Whether it needs texture coordinates."""
        base = self.texture.base if isinstance(self.texture, Coating) else self.texture
        return isinstance(base, Blend | Print | Photo | Mix)


class Stock(NamedTuple):
    """The surfaces that a scene's objects have; the first is plain and matt, so that there is one for every shape."""

    surfaces: tuple[Surface, ...]
    pictures: tuple[Surface, ...]

    def special(self) -> set[str]:
        """Names of metals and glass."""
        return {item.name for item in self.surfaces if isinstance(item.texture, MetalFinish | GlassBody)}


def stock(generators: list[Random], images: Palette, shares: Shares) -> Stock:
    """As many surfaces as generators, and a picture of each of the scene's photographs.

    A scene has fewer surfaces than objects, as a room has: each one takes about 0.3 s of the renderer's preparation.
    """
    drawn = [_thing(random, images, shares) for random in generators]
    drawn[0] = str(generators[0].choice(diffuse_names()))
    surfaces = [
        Surface(found, None) if isinstance(found, str) else Surface(f"surface {number + 1}", found)
        for number, found in enumerate(drawn)
    ]
    pictures = [
        Surface(f"picture {number + 1}", _picture(generators[0], image))
        for number, image in enumerate(images.photographs)
    ]
    return Stock(tuple(surfaces), tuple(pictures))


def palette(random: Random, own: tuple[str, ...]) -> Palette:
    """Photographs (``own``, where there are some) and structures, drawn without putting back."""
    photographs = own or PHOTOGRAPHS
    numbers = random.permutation(len(photographs))[: PALETTE[0]]
    found = []
    for name in random.choice([*STRUCTURES, *PATTERNS, *PATTERNS], PALETTE[1], replace=False):
        plain = str(name).startswith("skimage:")
        number = {
            "stripes": int(random.integers(6, 40)),
            "checkerboard": int(random.integers(6, 24)),
            "weave": int(random.integers(24, 80)),
            "leaf-veins": int(random.integers(5, 14)),
        }.get(str(name), int(random.integers(PATTERN_SEEDS)))
        found.append(str(name) if plain else f"pattern:{name}:{number}")
    return Palette(tuple(photographs[number] for number in numbers), tuple(found))


def background(
    random: Random, names: tuple[str, ...], images: Palette, textured: float, copies: float
) -> Texture | str:
    """A floor or wall: two materials of ``names`` mixed by a structure, ``copies`` of it along a side, or one."""
    first, second = (str(name) for name in random.choice(names, 2, replace=False))
    image = str(random.choice(images.structures))
    stretch = float(np.exp(random.uniform(-0.3, 0.3)))
    if random.random() >= textured:
        return first
    repeat = (_rounded(copies * stretch), _rounded(copies / stretch))
    return Blend(kind="blend", image=image, repeat=repeat, dark=first, bright=second)


def _picture(random: Random, image: str) -> Texture:
    """A poster or card: a print, sometimes laminated; the lamination is matt enough to show no lamp."""
    printed = Print(kind="print", image=image, black_generation=_rounded(random.uniform(0.3, 0.9)))
    rough = _rounded(random.uniform(0.2, 0.4))
    return Coating(kind="coated", base=printed, roughness=rough) if random.random() < 0.15 else printed


def _thing(random: Random, images: Palette, shares: Shares) -> Texture | str:
    """The surface of an object."""
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
