"""RGB photographs as surfaces: a rule states what a picture consists of, which determines its near-infrared.

No rule extends RGB upsampling beyond 650 nm. Each rule assigns a spectrum to the eight corners of the RGB cube and
mixes them trilinearly with the picture's linear values (Demichel's areas of three independent screens):

- ``print``: process inks on paper, and black ink of carbon. Beyond 740 nm only the black ink absorbs.
- ``dyed``: cloth of yarns in three dyes, all transparent there, so that even black cloth is bright.
- ``achromatic``: beyond 650 nm neutral pigments whose reflectance is the picture's luminance; below, the sRGB basis of
  Mallett and Yuksel (2019), so that the colour under D65 is that of the picture.

Tested in tests/dasim/scene/test_mesh_colours.py.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from pathlib import Path

import cv2
import numpy as np

from dasim.base import untrusted
from dasim.base.errors import InputError
from dasim.base.suggestions import did_you_mean
from dasim.materials import patterns, reflectances
from dasim.materials.surfaces import Diffuse, Mixture, Surface
from dasim.spectra import tables
from dasim.spectra.grid import LUMINANCE, WAVELENGTH_NM, long_pass
from dasim.typing import Float32Array, FloatArray

_BASIS_TABLE = Path(__file__).parents[1] / "data" / "srgb_basis.csv"

NEAR_INFRARED_RULES = ("print", "dyed", "achromatic")
BLACK_INK = "carbon-black"
PRINT_PAPER = "white-paper"
BLACK_GENERATION = 0.6  # default share of the grey component that is printed with black ink
DYED_FABRIC = "cotton-undyed"
CHANGE_OVER_NM = (650.0, 16.0)  # centre and 10-90 % width of the achromatic rule's transition from the RGB basis


def photograph_surface(image: Float32Array, rule: str, repeat: tuple[float, float] = (1.0, 1.0)) -> Surface:
    """Surface of a photograph by one of ``NEAR_INFRARED_RULES``.

    Args:
        image: linear sRGB, [h, w, rgb] 0..1, top row first
        rule: "print", "dyed" or "achromatic"
        repeat: copies across and down, every other one mirrored
    """
    if rule not in NEAR_INFRARED_RULES:
        rules = ", ".join(f"'{name}'" for name in NEAR_INFRARED_RULES)
        hint = did_you_mean(rule, NEAR_INFRARED_RULES)
        raise InputError(f"near-infrared rule '{rule}' is unknown; allowed are {rules}{hint}")
    image = np.asarray(image, np.float32)
    if image.ndim != 3 or image.shape[2] != 3 or not np.isfinite(image).all() or image.min() < 0 or image.max() > 1:
        raise InputError("a photograph must be an array of linear RGB [h, w, 3] with values from 0 to 1")
    if rule == "print":
        return halftone(image, reflectances.curve(PRINT_PAPER), BLACK_GENERATION, repeat)
    return _cube(image, _dyed_corner if rule == "dyed" else _achromatic_corner, repeat)


def halftone(image: Float32Array, paper: FloatArray, black_generation: float, repeat: tuple[float, float]) -> Surface:
    """Halftone print of an image by the Neugebauer model with Demichel's coverages.

    Ink coverages are 1 - R, 1 - G and 1 - B (Murray-Davies); black ink replaces the share ``black_generation`` of their
    common part (grey component replacement).

    Args:
        image: linear sRGB, [h, w, rgb] 0..1
        paper: reflectance of the paper, [wavelength]
        black_generation: 0 (no black ink) to 1
        repeat: copies across and down
    """
    coverage = 1.0 - image
    black = black_generation * coverage.min(axis=-1)
    coverage = (coverage - black[..., None]) / np.maximum(1.0 - black[..., None], 1e-6)
    inks = list(reflectances.ink_transmittances().values())

    def overprint(solids: tuple[int, int, int]) -> FloatArray:
        return paper * np.prod([ink for ink, solid in zip(inks, solids, strict=True) if solid], axis=0)

    colours = _cube(np.clip(coverage, 0.0, 1.0), overprint, repeat)
    return Mixture(np.ascontiguousarray(black), colours, Diffuse(reflectances.curve(BLACK_INK)), repeat)


def _cube(
    image: Float32Array, corner: Callable[[tuple[int, int, int]], FloatArray], repeat: tuple[float, float]
) -> Mixture:
    """Eight spectra, ``corner(rgb)`` for rgb in {0, 1}^3, mixed trilinearly by the planes of an image [h, w, 3].

    The result is a binary tree of mixtures with one level per plane.
    """
    planes = [np.ascontiguousarray(image[..., plane]) for plane in range(3)]

    def subtree(rgb: tuple[int, ...]) -> Surface:
        if len(rgb) == 3:
            return Diffuse(corner((rgb[0], rgb[1], rgb[2])))
        return Mixture(planes[len(rgb)], subtree((*rgb, 0)), subtree((*rgb, 1)), repeat)

    root = subtree(())
    assert isinstance(root, Mixture)
    return root


def _dyed_corner(rgb: tuple[int, int, int]) -> FloatArray:
    """Yarn at full dye strength: cyan removes red, magenta green, yellow blue; the K/S of the dyes add."""
    missing = [dye for dye, value in zip(reflectances.dye_absorptions().values(), rgb, strict=True) if not value]
    fabric = reflectances.curve(DYED_FABRIC)
    return reflectances.dyed_reflectance(fabric, np.sum([np.zeros_like(fabric), *missing], axis=0))


def _achromatic_corner(rgb: tuple[int, int, int]) -> FloatArray:
    """Reflectance of an RGB corner: the sRGB basis below ``CHANGE_OVER_NM``, the corner's luminance above."""
    visible = np.tensordot(rgb, _srgb_basis(), axes=1)
    colourless = long_pass(*CHANGE_OVER_NM)
    return np.clip((1.0 - colourless) * visible + colourless * np.dot(rgb, LUMINANCE), 0.0, 1.0)


@cache
def _srgb_basis() -> FloatArray:
    """Reflectances of the sRGB primaries, [3, wavelength], which sum to 1 (Mallett and Yuksel 2019)."""
    wavelength_nm, *primaries = tables.columns(_BASIS_TABLE).values()
    return np.stack([np.interp(WAVELENGTH_NM, wavelength_nm, values) for values in primaries])


# --- files ---------------------------------------------------------------------------------------


def linear_rgb(image: str, folder: Path) -> Float32Array:
    """A photograph in linear light, [h, w, rgb] 0..1; raises InputError if it is missing or unreadable.

    ``image`` is a file in ``folder`` (sRGB of 8 or 16 bits), ``skimage:NAME`` for a photograph that ships with
    scikit-image, or ``pattern:NAME`` or ``pattern:NAME:NUMBER`` for a pattern, which is grey and already linear.
    """
    if image.startswith("pattern:"):
        return np.repeat(patterns.pattern(image.removeprefix("pattern:"))[..., None], 3, axis=-1)
    encoded = _read(image, folder, cv2.IMREAD_COLOR)[..., ::-1]
    return np.where(encoded <= 0.04045, encoded / 12.92, ((encoded + 0.055) / 1.055) ** 2.4).astype(np.float32)


def mask(image: str, folder: Path) -> Float32Array:
    """A mask, [h, w] 0..1: a pattern, or a grey picture whose values are shares without sRGB decoding."""
    if image.startswith("pattern:"):
        return patterns.pattern(image.removeprefix("pattern:"))
    return np.ascontiguousarray(_read(image, folder, cv2.IMREAD_GRAYSCALE))


def luminance(rgb: Float32Array) -> Float32Array:
    """Luminance 0..1, [h, w], of linear sRGB [h, w, rgb]."""
    return np.asarray(rgb @ np.array(LUMINANCE, np.float32))


def _read(image: str, folder: Path, how: int) -> Float32Array:
    """Values 0..1 of a picture file of 8 or 16 bits, in OpenCV's order of channels (BGR)."""
    if image.startswith("skimage:"):
        import skimage

        path = _bundled_photograph(Path(skimage.__file__).parent / "data", image.removeprefix("skimage:"))
    else:
        path = folder / image
        if not path.is_file():
            raise InputError(f"image '{image}': no such file in {folder} (or 'skimage:NAME', or 'pattern:NAME')")
    data = untrusted.picture(path, f"image '{image}': {path}", how | cv2.IMREAD_ANYDEPTH)
    if data.dtype not in (np.uint8, np.uint16):
        raise InputError(f"image '{image}': {path} has values of type {data.dtype}; allowed are 8 or 16 bits")
    return data.astype(np.float32) / np.float32(np.iinfo(data.dtype).max)


def _bundled_photograph(folder: Path, name: str) -> Path:
    for suffix in (".png", ".jpg"):
        if (folder / f"{name}{suffix}").is_file():
            return folder / f"{name}{suffix}"
    known = sorted(path.stem for path in folder.iterdir() if path.suffix in (".png", ".jpg"))
    raise InputError(f"image 'skimage:{name}': does not ship with scikit-image; there are {', '.join(known)}")
