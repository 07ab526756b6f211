"""Colours and finish of a part of a mesh file, from what trimesh has read.

The finish is that of glTF 2.0 (appendix B): a metallic share, a roughness whose square is the GGX alpha, and a map of
normals in the axes of the texture. Scale factors of normal maps, occlusion, emission and extensions are not read.

Tested in tests/dasim/scene/test_mesh_colours.py and tests/dasim/render/test_finish.py.
"""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from dasim.typing import Float32Array

MOST_TEXELS = 1 << 24  # limit on the atlas of a mesh: 200 MB in linear light, and as much again for ink weights
MATT = (0.0, 1.0, 0.5, 0.5, 1.0)  # default finish: not metallic, rough, unperturbed surface normal


def decode_srgb(encoded: NDArray[Any]) -> Float32Array:
    """Linear light 0..1 of sRGB values, which are 8-bit integers or 0..1 (IEC 61966-2-1)."""
    values = np.asarray(encoded)
    if values.dtype == np.uint8:
        return _SRGB[values]
    values = values.astype(np.float32)
    return np.where(values <= 0.04045, values / 12.92, ((values + 0.055) / 1.055) ** 2.4).astype(np.float32)


def paint(visual: Any, has_uv: bool, *, linear: bool) -> tuple[str | None, Float32Array | None]:
    """Kind and linear values of a part's colours, as ``Part.paint_kind`` and ``Part.paint``, from trimesh's visual.

    ``linear`` means glTF, whose vertex colours and factors are linear light; all other colours are sRGB.
    """
    if visual.kind in ("vertex", "face"):
        colours = np.asarray(visual.vertex_colors if visual.kind == "vertex" else visual.face_colors)[:, :3]
        paint = np.asarray(colours / 255, np.float32) if linear else decode_srgb(colours)
        if (colours == colours[0]).all():
            return "one colour", np.asarray(paint[0])
        return f"{visual.kind} colours", paint
    material = getattr(visual, "material", None)
    if material is None:
        return None, None
    image = getattr(material, "baseColorTexture", None) if linear else getattr(material, "image", None)
    factor = getattr(material, "baseColorFactor", None)
    share = np.ones(3, np.float32) if factor is None else np.asarray(np.divide(factor[:3], 255), np.float32)
    placeholder = not linear and not getattr(material, "kwargs", None)  # trimesh's default, not from the file
    if placeholder and image is not None and image.size == (2, 2):
        return None, None  # trimesh's grey picture for a file with texture coordinates and no picture
    _check_size(image)
    if image is not None and has_uv:
        return "texture image", decode_srgb(np.asarray(image.convert("RGB"))) * (share if linear else np.float32(1.0))
    if linear:
        return "one colour", share
    diffuse = getattr(material, "diffuse", None)
    # The default grey that trimesh gives an OBJ without a material library is not a colour of the file.
    if diffuse is None or placeholder:
        return None, None
    return "one colour", decode_srgb(np.asarray(diffuse, np.uint8)[:3])


_SRGB = decode_srgb(np.arange(256) / 255)


def finish(visual: Any, has_uv: bool) -> Float32Array | None:
    """Finish [h, w, 5] of a part of a glTF file, as ``Part.finish``; None where it is matt or has no material.

    Missing factors default to 1, as in glTF: a material without them is a rough metal.
    """
    material = getattr(visual, "material", None)
    if material is None or not hasattr(material, "metallicFactor"):
        return None
    factors = [_factor(material, name) for name in ("metallicFactor", "roughnessFactor")]
    images = [material.metallicRoughnessTexture, material.normalTexture] if has_uv else [None, None]
    if images == [None, None]:
        one = np.array([*factors, *MATT[2:]], np.float32)
        return None if np.array_equal(one, np.array(MATT, np.float32)) else one.reshape(1, 1, 5)
    for image in images:
        _check_size(image)
    decoded = [None if image is None else _decoded(image) for image in images]
    size = np.max([picture.shape[:2] for picture in decoded if picture is not None], axis=0)
    share, normal = (None if picture is None else resized(picture, tuple(size.tolist())) for picture in decoded)
    result = np.empty((*size, 5), np.float32)
    result[..., :2] = factors
    result[..., 2:] = MATT[2:] if normal is None else normal
    if share is not None:
        result[..., :2] *= share[..., [2, 1]]  # glTF: metallic is blue, roughness green
    return result


def _factor(material: Any, name: str) -> float:
    """A factor of a material, 1 where the file leaves it out; raises ValueError outside 0..1."""
    value = getattr(material, name)
    if value is not None and not 0 <= float(value) <= 1:
        raise ValueError(f"its {name} is {value}, 0 to 1 is allowed")
    return 1.0 if value is None else float(value)


def _decoded(image: Any) -> Float32Array:
    """Values 0..1 of a picture of 8 bits, [h, w, rgb], which are linear."""
    return np.asarray(image.convert("RGB"), np.float32) / np.float32(255)


def resized(image: Float32Array, size: tuple[int, ...]) -> Float32Array:
    """A picture [h, w, channel] interpolated to ``size`` (rows, columns); itself where it has that size."""
    if image.shape[:2] == size:
        return image
    larger = cv2.resize(np.ascontiguousarray(image), size[::-1], interpolation=cv2.INTER_LINEAR)
    return np.asarray(larger, np.float32).reshape(*size, -1)


def _check_size(image: Any) -> None:
    """Raise ValueError for a picture of too many pixels, before it is decoded."""
    if image is not None and image.size[0] * image.size[1] > MOST_TEXELS:
        raise ValueError(f"its picture has {image.size[0]} x {image.size[1]} pixels, at most {MOST_TEXELS} are allowed")
