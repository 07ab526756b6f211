"""Named materials from 400 to 830 nm, and textures that mix them.

Reflectances are parametric: smooth curves through published values, each with its source. Nothing is
extrapolated from RGB: a photograph becomes a material through what its surface would be made of
(two materials, or printing inks), so that its near-infrared is physical too.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import cv2
import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from dasim.errors import InputError
from dasim.specification import Specification
from dasim.spectra import WAVELENGTH_NM, FloatArray, long_pass, short_pass


def _line(*points: tuple[float, float]) -> FloatArray:
    """Straight lines through (wavelength, reflectance) points."""
    return np.interp(WAVELENGTH_NM, *np.transpose(points))


def _bell(centre_nm: float, sigma_nm: float) -> FloatArray:
    return np.exp(-0.5 * ((WAVELENGTH_NM - centre_nm) / sigma_nm) ** 2)


def _reflectances() -> dict[str, FloatArray]:
    """Reflectance curves by name.

    Green leaf: PROSPECT (Jacquemoud and Baret 1990): 0.15 at 550, 0.04 at 680, 0.31 at 720, 0.45 at 780 nm.
    Minerals, soils, woods, brick and dry vegetation: featureless rises as in the ECOSTRESS spectral library
    (Meerdink et al. 2019). Textile dyes open towards 700 nm while carbon black stays dark.
    """
    return {
        "white-paper": 0.86 - 0.10 * short_pass(425.0, 30.0),
        "grey-card": _line((400, 0.18), (830, 0.185)),
        "concrete-light": _line((400, 0.38), (600, 0.48), (830, 0.52)),
        "concrete-dark": _line((400, 0.10), (600, 0.13), (830, 0.15)),
        "brick": _line((400, 0.07), (530, 0.10), (600, 0.24), (700, 0.32), (830, 0.36)),
        "mortar": _line((400, 0.40), (600, 0.52), (830, 0.58)),
        "soil": _line((400, 0.05), (600, 0.12), (830, 0.22)),
        "sand": _line((400, 0.18), (600, 0.38), (830, 0.48)),
        "leaf-green": 0.03 + 0.11 * _bell(552.0, 28.0) + 0.42 * long_pass(714.0, 45.0),
        "leaf-dry": _line((400, 0.08), (550, 0.18), (650, 0.30), (720, 0.42), (830, 0.52)),
        "wood-light": _line((400, 0.20), (550, 0.42), (650, 0.56), (830, 0.68)),
        "wood-dark": _line((400, 0.05), (550, 0.09), (650, 0.15), (830, 0.34)),
        "cotton-white": 0.82 - 0.12 * short_pass(430.0, 40.0),
        "cotton-red": 0.05 + 0.60 * long_pass(605.0, 50.0),
        "cotton-blue": 0.05 + 0.28 * _bell(455.0, 38.0) + 0.55 * long_pass(710.0, 70.0),
        "polyester-black": 0.04 + 0.50 * long_pass(715.0, 70.0),
        "ceramic-white": _line((400, 0.74), (500, 0.82), (830, 0.84)),
        "carbon-black": _line((400, 0.035), (830, 0.04)),
    }


def _ink_transmittances() -> dict[str, FloatArray]:
    """Two-way transmittance of solid process inks on paper: transparent beyond 700 nm, except carbon black."""
    return {
        "cyan": 1.0 - 0.90 * _bell(630.0, 48.0),
        "magenta": 1.0 - 0.92 * _bell(540.0, 36.0),
        "yellow": 1.0 - 0.93 * short_pass(495.0, 45.0),
    }


BLACK_INK = "carbon-black"


def material_names() -> list[str]:
    """Names of the materials of the library."""
    return sorted(_reflectances())


def reflectance(name: str) -> FloatArray:
    """Reflectance 0..1 of a named material on ``WAVELENGTH_NM``; InputError where it is unknown."""
    curves = _reflectances()
    if name not in curves:
        raise InputError(f"material '{name}' is unknown; known are {', '.join(sorted(curves))}")
    return curves[name]


# --- how a scene describes a texture -------------------------------------------------------------


Repeat = Annotated[float, Field(gt=0, le=1000)]


class _Photograph(Specification):
    image: str = Field(description="a file beside the scene, or skimage:NAME")
    repeat: tuple[Repeat, Repeat] = Field(
        default=(1.0, 1.0), description="copies across and down, every other mirrored"
    )


class Blend(_Photograph):
    """Two materials mixed by the luminance of a photograph: the achromatic near-infrared rule."""

    kind: Literal["blend"]
    dark: str
    bright: str


class Print(_Photograph):
    """A photograph printed with process inks: its near-infrared is that of paper and black ink alone."""

    kind: Literal["print"]
    paper: str = "white-paper"
    black_generation: float = Field(default=0.6, ge=0, le=1, description="share of the grey printed with black ink")


Texture = Annotated[Blend | Print, Field(discriminator="kind")]


# --- what the renderer gets ----------------------------------------------------------------------


@dataclass(frozen=True)
class Diffuse:
    """A Lambertian surface of one reflectance spectrum."""

    reflectance: FloatArray


@dataclass(frozen=True)
class Mixture:
    """``first`` and ``second`` mixed by an image of the second's share, [h, w] 0..1, top row first."""

    weight: NDArray[np.float32]
    first: Surface
    second: Surface
    repeat: tuple[float, float] = (1.0, 1.0)  # copies along u and v, every other one mirrored


Surface = Diffuse | Mixture


def surface(texture: Blend | Print | str, folder: Path) -> Surface:
    """Resolve a material's name or texture; images are looked up in ``folder`` or scikit-image's package."""
    if isinstance(texture, str):
        return Diffuse(reflectance(texture))
    image = _linear_rgb(texture.image, folder)
    if isinstance(texture, Blend):
        luminance = image @ np.array([0.2126, 0.7152, 0.0722], np.float32)
        dark, bright = Diffuse(reflectance(texture.dark)), Diffuse(reflectance(texture.bright))
        return Mixture(luminance, dark, bright, texture.repeat)
    return _printed(image, reflectance(texture.paper), texture.black_generation, texture.repeat)


def flipped(surface: Surface) -> Surface:
    """The surface with its images upside down."""
    images: dict[int, NDArray[np.float32]] = {}  # an image that a tree shares stays shared

    def turn(part: Surface) -> Surface:
        if isinstance(part, Diffuse):
            return part
        image = images.setdefault(id(part.weight), np.ascontiguousarray(part.weight[::-1]))
        return Mixture(image, turn(part.first), turn(part.second), part.repeat)

    return turn(surface)


def _printed(
    image: NDArray[np.float32], paper: FloatArray, black_generation: float, repeat: tuple[float, float]
) -> Surface:
    """Halftone print by the Neugebauer model with Demichel's coverages.

    Ink coverages are 1 - R, 1 - G, 1 - B (Murray-Davies), their common part partly replaced by black.
    The eight overprints of cyan, magenta and yellow are a tree of mixtures, one level an ink.
    """
    coverage = 1.0 - image
    black = black_generation * coverage.min(axis=-1)
    coverage = (coverage - black[..., None]) / np.maximum(1.0 - black[..., None], 1e-6)
    coverages = [np.ascontiguousarray(coverage[..., ink]) for ink in range(3)]
    inks = list(_ink_transmittances().values())

    def overprint(base: FloatArray, ink: int) -> Surface:
        if ink == len(inks):
            return Diffuse(base)
        return Mixture(coverages[ink], overprint(base, ink + 1), overprint(base * inks[ink], ink + 1), repeat)

    return Mixture(black, overprint(paper, 0), Diffuse(reflectance(BLACK_INK)), repeat)


def _linear_rgb(image: str, folder: Path) -> NDArray[np.float32]:
    """A photograph in linear light, [h, w, 3] 0..1; ``skimage:NAME`` is one that ships with scikit-image."""
    path = photograph_path(image, folder)
    data = cv2.imread(str(path), cv2.IMREAD_COLOR)
    if data is None:
        raise InputError(f"image '{image}': {path} cannot be read as a picture")
    encoded = data[..., ::-1].astype(np.float32) / 255.0
    return np.where(encoded <= 0.04045, encoded / 12.92, ((encoded + 0.055) / 1.055) ** 2.4).astype(np.float32)


def photograph_path(image: str, folder: Path) -> Path:
    """Where a photograph lies: a file in ``folder``, or ``skimage:NAME``; InputError where it is missing."""
    if image.startswith("skimage:"):
        import skimage

        return _bundled_photograph(Path(skimage.__file__).parent / "data", image.removeprefix("skimage:"))
    path = folder / image
    if not path.is_file():
        raise InputError(f"image '{image}': no such file in {folder} (or 'skimage:NAME')")
    return path


def _bundled_photograph(folder: Path, name: str) -> Path:
    for suffix in (".png", ".jpg"):
        if (folder / f"{name}{suffix}").is_file():
            return folder / f"{name}{suffix}"
    known = sorted(p.stem for p in folder.iterdir() if p.suffix in (".png", ".jpg"))
    raise InputError(f"image 'skimage:{name}': does not ship with scikit-image; there are {', '.join(known)}")
