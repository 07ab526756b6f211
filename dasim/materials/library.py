"""Materials from 400 to 830 nm, by name or specified in TOML, as surfaces for the renderer.

The near-infrared is never extrapolated from RGB. A scene names the rule by which a photograph becomes a material
(:mod:`~dasim.materials.photographs`); the rule states what the surface consists of, so that its near-infrared is
physical.
"""

from __future__ import annotations

from collections.abc import Collection
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Discriminator, Field, Tag, model_validator

from dasim.base.errors import InputError
from dasim.base.suggestions import did_you_mean
from dasim.base.toml import Specification
from dasim.materials import measured, photographs, reflectances
from dasim.materials.photographs import NEAR_INFRARED_RULES, photograph_surface
from dasim.materials.surfaces import (
    CLEAR_COAT_INDEX,
    CROWN_GLASS_INDEX,
    Coated,
    Diffuse,
    Glass,
    Metal,
    Mixture,
    Surface,
    flip_images,
    is_diffuse,
    is_textured,
)
from dasim.spectra import colour_checker, grid
from dasim.typing import FloatArray

__all__ = [
    "NEAR_INFRARED_RULES",
    "Coated",
    "Diffuse",
    "Glass",
    "Metal",
    "Mixture",
    "Surface",
    "Texture",
    "flip_images",
    "is_textured",
    "material_names",
    "photograph_surface",
    "reflectance",
    "surface",
]

# --- names ---------------------------------------------------------------------------------------

CONDUCTORS = {"aluminium": "Al", "chromium": "Cr", "copper": "Cu", "gold": "Au", "silver": "Ag", "tungsten": "W"}
_METAL_SOURCE = "complex index measured to 885 nm, from Mitsuba's tables; GGX alpha 0.1"
_GLASS_SOURCE = "clear crown glass, index 1.52 at all wavelengths"
_GLOSSY = {  # base material, roughness of its coat
    "porcelain": ("ceramic-white", 0.0),
    "varnished-wood": ("wood-light", 0.08),
    "glossy-plastic-black": ("plastic-black", 0.05),
    "glossy-plastic-blue": ("plastic-blue", 0.05),
    "glossy-plastic-green": ("plastic-green", 0.05),
    "glossy-plastic-red": ("plastic-red", 0.05),
    "glossy-plastic-white": ("plastic-white", 0.05),
    "glossy-plastic-yellow": ("plastic-yellow", 0.05),
}


def diffuse_names() -> list[str]:
    """Sorted names of the Lambertian materials, which are those with a reflectance."""
    return sorted([*reflectances.names(), *colour_checker.PATCHES])


def material_names() -> list[str]:
    """Sorted names of the bundled materials, by which the objects of a scene refer to them."""
    return sorted([*diffuse_names(), *CONDUCTORS, "glass", "glass-pane", *_GLOSSY])


def reflectance(name: str) -> FloatArray:
    """Reflectance 0..1 of a Lambertian material on ``WAVELENGTH_NM``, [wavelength].

    Raises InputError for an unknown name, and for metals, glass and coated materials.
    """
    if name in colour_checker.PATCHES:
        return colour_checker.curve(name)
    if name in reflectances.names():
        return reflectances.curve(name)
    if name in material_names():
        raise InputError(f"material '{name}' is not diffuse and has no reflectance of its own; use a diffuse material")
    raise InputError(unknown(name))


def unknown(name: str, others: Collection[str] = ()) -> str:
    """Error message for a material name that is neither in the library nor among ``others``, the scene's materials."""
    own = f", the scene's own are {', '.join(others)}" if others else ""
    hint = did_you_mean(name, [*others, *material_names()], 3)
    return f"material '{name}' is unknown; 'dasim list materials' prints all{own}{hint}"


def kind_and_source(name: str) -> tuple[str, str]:
    """Kind of a bundled material (diffuse, metal, glass, coated) and the source of its numbers, in one line."""
    if name in CONDUCTORS:
        return "metal", _METAL_SOURCE
    if name in ("glass", "glass-pane"):
        return "glass", _GLASS_SOURCE + ("; a thin pane" if name == "glass-pane" else "; for closed shapes")
    if name in _GLOSSY:
        base, roughness = _GLOSSY[name]
        return "coated", f"{base} under a clear coat of index {CLEAR_COAT_INDEX}, GGX alpha {roughness}"
    return "diffuse", colour_checker.SOURCE if name in colour_checker.PATCHES else reflectances.source(name)


def _bundled(name: str) -> Surface:
    if name in CONDUCTORS:
        return Metal(CONDUCTORS[name])
    if name in ("glass", "glass-pane"):
        return Glass(thin=name == "glass-pane")
    if name in _GLOSSY:
        base, roughness = _GLOSSY[name]
        return Coated(Diffuse(reflectance(base)), roughness)
    return Diffuse(reflectance(name))


# --- specifications in scenes --------------------------------------------------------------------


MOST_REPEATS = 1000
Repeat = Annotated[float, Field(gt=0, le=MOST_REPEATS)]
Stated = Annotated[float, Field(ge=-1, le=1000)]  # reflectance, also by mistake in percent, which has its own message
Roughness = Annotated[float, Field(ge=0, le=1, description="GGX alpha; 0 is perfectly smooth")]


class _Textured(Specification):
    image: str = Field(description="a file beside the scene, skimage:NAME or pattern:NAME")
    repeat: tuple[Repeat, Repeat] = Field(
        default=(1.0, 1.0), description="copies across and down, every other one mirrored"
    )


class Blend(_Textured):
    """Two materials mixed by the luminance of a picture, whose colours are ignored."""

    kind: Literal["blend"]
    dark: str
    bright: str


class Print(_Textured):
    """A photograph printed with process inks; paper and black ink alone determine its near-infrared."""

    kind: Literal["print"]
    paper: str = photographs.PRINT_PAPER
    black_generation: float = Field(
        default=photographs.BLACK_GENERATION, ge=0, le=1, description="share of the grey printed with black ink"
    )


class Photo(_Textured):
    """A photograph whose near-infrared follows one of ``NEAR_INFRARED_RULES``."""

    kind: Literal["photo"]
    rule: Literal["print", "dyed", "achromatic"]

    @model_validator(mode="before")
    @classmethod
    def _has_a_rule(cls, data: Any) -> Any:
        if isinstance(data, dict) and "rule" not in data:
            rules = ", ".join(f"'{name}'" for name in NEAR_INFRARED_RULES)
            raise ValueError(f"a 'photo' does not determine the near-infrared: add rule = one of {rules}")
        return data


class Spectrum(Specification):
    """A Lambertian material with the user's own spectrum: a CSV file (wavelength_nm, reflectance) or points.

    The spectrum must cover 400 to 830 nm.
    """

    kind: Literal["spectrum"]
    file: str | None = Field(default=None, min_length=1)
    points: tuple[tuple[grid.AnyNm, Stated], ...] | None = Field(
        default=None, description="[wavelength_nm, reflectance]"
    )

    @model_validator(mode="after")
    def _one_of_both(self) -> Spectrum:
        if (self.file is None) == (self.points is None):
            raise ValueError("give either file (a CSV of wavelength_nm, reflectance) or points")
        return self


class MetalFinish(Specification):
    """A bare metal with a rough or smooth surface."""

    kind: Literal["metal"]
    metal: Literal["aluminium", "chromium", "copper", "gold", "silver", "tungsten"]
    roughness: Roughness = 0.1


class GlassBody(Specification):
    """Clear glass: a closed body, or a thin pane (a plane or disc) that transmits without refraction."""

    kind: Literal["glass"]
    refractive_index: float = Field(default=CROWN_GLASS_INDEX, ge=1.01, le=2.5)
    thin: bool = False


class Coating(Specification):
    """A clear coat over a diffuse material or texture, as on plastic, glazed ceramics, varnish or laminated prints."""

    kind: Literal["coated"]
    base: Part
    roughness: float = Field(default=0.1, ge=0, le=0.5, description="GGX alpha; a rougher coat would look matt")
    refractive_index: float = Field(default=CLEAR_COAT_INDEX, ge=1.01, le=2.5)


class Layer(Specification):
    """A material that covers the layers below it where its mask is white."""

    material: Part
    mask: str = Field(description="an image whose values are shares 0..1 without decoding, or pattern:NAME")
    repeat: tuple[Repeat, Repeat] = (1.0, 1.0)


class Mix(Specification):
    """A base material under layers, the last of them on top."""

    kind: Literal["mix"]
    base: Part
    layers: tuple[Layer, ...] = Field(min_length=1, max_length=16)


def _name_or_kind(value: Any) -> str | None:
    if isinstance(value, str):
        return "name"
    return value.get("kind") if isinstance(value, dict) else getattr(value, "kind", None)


Texture = Annotated[
    Blend | Print | Photo | Spectrum | MetalFinish | GlassBody | Coating | Mix, Field(discriminator="kind")
]
Part = Annotated[
    Annotated[str, Tag("name")]
    | Annotated[Blend, Tag("blend")]
    | Annotated[Print, Tag("print")]
    | Annotated[Photo, Tag("photo")]
    | Annotated[Spectrum, Tag("spectrum")]
    | Annotated[MetalFinish, Tag("metal")]
    | Annotated[Coating, Tag("coated")]
    | Annotated[Mix, Tag("mix")],
    Discriminator(
        _name_or_kind,
        custom_error_type="part",
        custom_error_message="must be a material's name or a table with kind = 'blend', 'print', 'photo', 'spectrum', "
        "'metal', 'coated' or 'mix'",
    ),
]
Coating.model_rebuild()
Layer.model_rebuild()
Mix.model_rebuild()


# --- surfaces for the renderer -------------------------------------------------------------------


def surface(texture: Any, folder: Path) -> Surface:
    """Resolve the name of a material or a ``Texture`` to a surface; its files are looked up in ``folder``.

    Raises InputError for unknown names, unusable files, and combinations that the renderer does not support.
    """
    match texture:
        case str():
            return _bundled(texture)
        case Blend():
            share = photographs.luminance(photographs.linear_rgb(texture.image, folder))
            dark, bright = (_opaque(name, folder) for name in (texture.dark, texture.bright))
            return Mixture(np.clip(share, 0.0, 1.0), dark, bright, texture.repeat)
        case Print():
            image = photographs.linear_rgb(texture.image, folder)
            return photographs.halftone(image, reflectance(texture.paper), texture.black_generation, texture.repeat)
        case Photo():
            return photograph_surface(photographs.linear_rgb(texture.image, folder), texture.rule, texture.repeat)
        case Spectrum():
            where = "points" if texture.file is None else f"file '{texture.file}'"
            points = measured.read(folder / texture.file, where) if texture.file else np.array(texture.points, float)
            return Diffuse(measured.resample(points, where))
        case MetalFinish():
            return Metal(CONDUCTORS[texture.metal], texture.roughness)
        case GlassBody():
            return Glass(texture.refractive_index, texture.thin)
        case Coating():
            return _coated(texture, folder)
        case Mix():
            result = _opaque(texture.base, folder)
            for layer in texture.layers:
                share = photographs.mask(layer.mask, folder)
                result = Mixture(share, result, _opaque(layer.material, folder), layer.repeat)
            return result
    raise TypeError(f"no material: {texture!r}")


def _opaque(part: Any, folder: Path) -> Surface:
    """The surface of a part of a mixture; raises InputError for glass."""
    opaque = surface(part, folder)
    if isinstance(opaque, Glass):
        raise InputError(f"material '{part}' is clear and cannot be mixed; mix opaque materials only")
    return opaque


def _coated(texture: Coating, folder: Path) -> Coated:
    base = surface(texture.base, folder)
    if not isinstance(base, Diffuse | Mixture) or not is_diffuse(base):
        raise InputError(
            "base: a clear coat needs diffuse materials or mixtures of them, not metal, glass or another coat"
        )
    return Coated(base, texture.roughness, texture.refractive_index)
