"""Merging of the parts of a mesh file into one mesh with one texture for all their colours.

A file may hold several parts (GLB, OBJ with materials). Their geometry is merged and their colours are packed into one
texture atlas, so that an object remains one mesh with one surface. RGB does not determine the near-infrared: the scene
chooses the rule that extends it (``dasim.materials.library.photograph_surface``).

Tested in tests/dasim/scene/test_mesh_colours.py.
"""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import numpy as np

from dasim.base.errors import InputError
from dasim.scene.mesh_paint import MATT, MOST_TEXELS, resized
from dasim.scene.meshes import Part
from dasim.typing import Float32Array, FloatArray


def colour_kinds(parts: tuple[Part, ...]) -> list[str]:
    """Kinds of colours (``Part.paint_kind``) that the parts have, sorted and without repetition."""
    return sorted({part.paint_kind for part in parts if part.paint_kind})


def merge(parts: tuple[Part, ...]) -> Part:
    """Merge parts into one without colours; ``uv`` and ``normals`` survive only where all parts have them."""
    if len(parts) == 1:
        return parts[0]
    first = np.cumsum([0, *(len(part.vertices) for part in parts)])
    uv = [part.uv for part in parts if part.uv is not None]
    normals = [part.normals for part in parts if part.normals is not None]
    return Part(
        np.concatenate([part.vertices for part in parts]),
        np.concatenate([part.faces + np.uint32(start) for part, start in zip(parts, first, strict=False)]),
        np.concatenate(uv) if len(uv) == len(parts) else None,
        np.concatenate(normals) if len(normals) == len(parts) else None,
    )


@lru_cache(maxsize=4)
def merge_with_colours(parts: tuple[Part, ...], where: str) -> Part:
    """Merge parts into one with a single picture of their colours, and of their finish where some have one.

    Raises InputError if a part has no colours, or if the picture would exceed ``MOST_TEXELS``.
    """
    if any(part.paint_kind is None for part in parts):
        raise InputError(f"{where}: some of its faces have no colours; give the object a material")
    finished = any(part.finish is not None for part in parts)
    textures = [_as_picture(part, where, finished=finished) for part in parts]
    pictures = [part.paint for part in textures if part.paint is not None]
    whole = merge(tuple(textures))
    picture, uv = pictures[0], whole.uv
    if len(parts) > 1:
        picture, uv = _atlas(pictures, [part.uv for part in textures if part.uv is not None], where)
    finish = np.ascontiguousarray(picture[..., 3:]) if finished else None
    colours = np.ascontiguousarray(picture[..., :3])
    return Part(whole.vertices, whole.faces, uv, whole.normals, colours, "texture image", finish)


def _as_picture(part: Part, where: str, *, finished: bool) -> Part:
    """The part with its colours converted to a picture, of whichever kind they are.

    If the mesh is ``finished``, the picture has eight channels: colours, and the finish as in ``Part.finish``.
    """
    assert part.paint is not None
    if part.finish is not None:
        return _repeat_picture(_finished(part, part.paint, part.finish), where)
    coloured = _colour_picture(part, part.paint, where)
    if not finished:
        return coloured
    assert coloured.paint is not None
    matt = np.broadcast_to(np.array(MATT, np.float32), (*coloured.paint.shape[:2], len(MATT)))
    return replace(coloured, paint=np.concatenate([coloured.paint, matt], axis=-1))


def _finished(part: Part, paint: Float32Array, finish: Float32Array) -> Part:
    """The part with its colours and its finish as one picture of eight channels, of the size of the finer of them."""
    picture = paint.reshape(1, 1, 3) if part.paint_kind == "one colour" else paint
    uv = np.full((len(part.vertices), 2), 0.5) if part.uv is None else part.uv
    size = tuple(np.maximum(picture.shape[:2], finish.shape[:2]).tolist())
    whole = np.concatenate([resized(picture, size), resized(finish, size)], axis=-1)
    return Part(part.vertices, part.faces, uv, part.normals, whole, "texture image")


def _colour_picture(part: Part, paint: Float32Array, where: str) -> Part:
    """The part with its colours as a picture."""
    if part.paint_kind == "texture image":
        return _repeat_picture(part, where)
    if part.paint_kind == "one colour":
        middle = np.full((len(part.vertices), 2), 0.5)
        return Part(part.vertices, part.faces, middle, part.normals, paint.reshape(1, 1, 3), "texture image")
    corners = paint[part.faces] if part.paint_kind == "vertex colours" else paint[:, None].repeat(3, axis=1)
    return _block_picture(part, corners, where)


def _block_picture(part: Part, corners: Float32Array, where: str) -> Part:
    """The part with a picture that has one block of 2 x 2 texels per face, from corner colours [m, 3, rgb].

    The corners of a face lie at the centres of three texels. The fourth texel is c10 + c01 - c00, so that bilinear
    interpolation is linear over the triangle, except where that value is clipped to 0..1.
    """
    count = len(part.faces)
    columns = int(np.ceil(np.sqrt(count)))
    rows = -(-count // columns)
    _check_size(4 * rows * columns, where)
    row, column = np.divmod(np.arange(count), columns)
    picture = np.zeros((rows, 2, columns, 2, 3), np.float32)
    picture[row, 0, column, 0] = corners[:, 0]
    picture[row, 0, column, 1] = corners[:, 1]
    picture[row, 1, column, 0] = corners[:, 2]
    picture[row, 1, column, 1] = np.clip(corners[:, 1] + corners[:, 2] - corners[:, 0], 0.0, 1.0)
    origin = np.stack([2 * column, 2 * row], axis=-1)[:, None] + 0.5  # texels from the left and the top
    place = (origin + np.array([[0, 0], [1, 0], [0, 1]])).reshape(-1, 2) / (2 * columns, 2 * rows)
    place[:, 1] = 1 - place[:, 1]
    return _split_vertices(part, place, picture.reshape(2 * rows, 2 * columns, 3))


def _repeat_picture(part: Part, where: str) -> Part:
    """The part with texture coordinates within 0..1; its picture is tiled where a face spans several copies.

    Mesh files repeat a picture beyond 0..1. The renderer's mixtures mirror it there, and an atlas cannot repeat it.
    """
    assert part.uv is not None and part.paint is not None
    if part.uv.min() >= 0 and part.uv.max() <= 1:
        return part
    corners = part.uv[part.faces]
    corners = corners - np.floor(corners.min(axis=1, keepdims=True) + 1e-9)
    copies = np.maximum(np.ceil(corners.max(axis=(0, 1)) - 1e-6), 1).astype(int)
    height, width = part.paint.shape[:2]
    _check_size(int(height * copies[1]) * int(width * copies[0]), where)
    # All copies are whole, so it does not matter that v counts from the bottom and rows from the top.
    return _split_vertices(part, corners.reshape(-1, 2) / copies, np.tile(part.paint, (copies[1], copies[0], 1)))


def _split_vertices(part: Part, uv: FloatArray, picture: Float32Array) -> Part:
    """The part with separate vertices for every face; ``uv`` [3 m, 2] and the picture are new."""
    order = part.faces.ravel()
    faces = np.arange(len(order), dtype=np.uint32).reshape(-1, 3)
    normals = None if part.normals is None else part.normals[order]
    return Part(part.vertices[order], faces, uv, normals, picture, "texture image")


def _atlas(pictures: list[Float32Array], uv: list[FloatArray], where: str) -> tuple[Float32Array, FloatArray]:
    """Stack pictures vertically into an atlas [h, w, channel] and map their ``uv`` into it, [sum n, 2].

    Each picture is padded by one texel of its own border, so that interpolation does not mix neighbours.
    """
    width = max(picture.shape[1] for picture in pictures) + 2
    heights = [picture.shape[0] + 2 for picture in pictures]
    _check_size(width * sum(heights), where)
    atlas = np.zeros((sum(heights), width, pictures[0].shape[-1]), np.float32)
    coordinates, top = [], 0
    for picture, place, height in zip(pictures, uv, heights, strict=True):
        rows, columns = picture.shape[:2]
        atlas[top : top + height, : columns + 2] = np.pad(picture, ((1, 1), (1, 1), (0, 0)), mode="edge")
        down = top + 1 + (1 - place[:, 1]) * rows
        coordinates.append(np.stack([(1 + place[:, 0] * columns) / width, 1 - down / len(atlas)], axis=-1))
        top += height
    return atlas, np.concatenate(coordinates)


def _check_size(texels: int, where: str) -> None:
    if texels > MOST_TEXELS:
        raise InputError(
            f"{where}: its colours need {texels / 1e6:.0f} million texels, "
            f"{MOST_TEXELS / 1e6:.0f} million are allowed; use smaller pictures or fewer faces, "
            "or give the object a material"
        )
