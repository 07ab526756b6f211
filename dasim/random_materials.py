"""Materials that are drawn: library names, blends of two, prints, dyed cloth, glosses, now and then metal or glass."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from dasim.materials import Blend, Coating, GlassBody, Layer, MetalFinish, Mix, Photo, Print, Texture, diffuse_names

Random = np.random.Generator

PHOTOGRAPHS = (
    *("skimage:astronaut", "skimage:camera", "skimage:chelsea", "skimage:coffee", "skimage:coins", "skimage:page"),
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


def picture(random: Random, images: Palette) -> Texture | str:
    """A poster or card: a print, sometimes laminated; the lamination is matt enough to show no lamp."""
    printed = Print(
        kind="print", image=str(random.choice(images.photographs)), black_generation=_rounded(random.uniform(0.3, 0.9))
    )
    rough = _rounded(random.uniform(0.2, 0.4))
    return Coating(kind="coated", base=printed, roughness=rough) if random.random() < 0.15 else printed


def thing(random: Random, images: Palette, shares: Shares, *, has_uv: bool, closed: bool) -> Texture | str:
    """The surface of an object. Only closed bodies are of glass; without texture coordinates nothing is textured."""
    kind, second = random.random(2)
    first, other = (str(name) for name in random.choice(diffuse_names(), 2, replace=False))
    repeat = _rounded(float(np.exp(random.uniform(np.log(0.5), np.log(3.0)))))
    structure, photograph = (str(random.choice(kind)) for kind in (images.structures, images.photographs))
    rough, metal = _rounded(random.uniform(0.15, 0.4)), str(random.choice(METALS))
    rule = ("dyed", "achromatic")[int(random.integers(2))]
    if kind < shares.metal:
        return MetalFinish(kind="metal", metal=metal, roughness=rough)  # type: ignore[arg-type]
    kind -= shares.metal
    if kind < shares.glass:
        return GlassBody(kind="glass") if closed else first
    kind -= shares.glass
    base: Blend | Print | Photo | Mix | str = first
    textured = (kind - shares.glossy) / max(1 - shares.metal - shares.glass - shares.glossy, 1e-9)
    if kind < shares.glossy:
        textured = kind / shares.glossy
    if has_uv and textured < shares.textured:
        if second < 0.55:
            base = Blend(kind="blend", image=structure, repeat=(repeat, repeat), dark=first, bright=other)
        elif second < 0.75:
            base = Print(kind="print", image=photograph)
        elif second < 0.9:
            base = Photo(kind="photo", image=photograph, rule=rule)  # type: ignore[arg-type]
        else:
            layer = Layer(material=other, mask=structure, repeat=(repeat, repeat))
            base = Mix(kind="mix", base=first, layers=(layer,))
    return Coating(kind="coated", base=base, roughness=rough) if kind < shares.glossy else base


def _rounded(value: float) -> float:
    return round(float(value), 3)
