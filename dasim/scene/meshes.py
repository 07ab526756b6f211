"""Mesh files: their triangles, and their RGB colours as a single texture.

A file may hold several parts (GLB, OBJ with materials). Their geometry is merged and their colours are packed into one
texture atlas, so that an object remains one mesh with one surface. RGB does not determine the near-infrared: the scene
chooses the rule that extends it (``dasim.materials.library.photograph_surface``).

Tested in tests/dasim/scene/test_shapes.py.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dasim.base import untrusted
from dasim.base.errors import InputError
from dasim.typing import Float32Array, FloatArray

FORMATS = "OBJ, PLY, GLB, STL, OFF"
FARTHEST_M = 1e4  # of a vertex from the origin of its file
MOST_COPIES = 1e4  # of a texture along u or v
_INDEX_0 = re.compile(rb"^[ \t]*f[ \t](?:[^\n#]*[ \t])?0+(?:/[^\s]*)?(?=\s|$)[^\n]*", re.MULTILINE)
MOST_TEXELS = 1 << 24  # limit on the atlas of a mesh: 200 MB in linear light, and as much again for ink weights


@dataclass(frozen=True, eq=False)  # compared by identity, so that functions of parts can be cached
class Part:
    """One part of a mesh file.

    Attributes:
        vertices: [n, xyz], metres
        faces: indices of vertices, [m, 3]
        uv: texture coordinates [n, 2], or None
        normals: unit vertex normals [n, xyz] of the file, or None: then shading uses the flat faces
        paint: colours in linear light 0..1: a picture [h, w, rgb] mapped by ``uv`` (bottom row at v = 0), vertex
            colours [n, rgb], face colours [m, rgb], or one colour [rgb]
        paint_kind: which of these ``paint`` is ("texture image", "vertex colours", "face colours", "one colour");
            None where the file has no colours
    """

    vertices: FloatArray
    faces: NDArray[np.uint32]
    uv: FloatArray | None = None
    normals: FloatArray | None = None
    paint: Float32Array | None = None
    paint_kind: str | None = None


def read(path: Path, unit_m: float, where: str) -> tuple[Part, ...]:
    """Parts of a mesh file; raises InputError if it is missing, broken or without faces.

    ``unit_m`` is the length of the file's unit in metres, ``where`` the name of the mesh in error messages. Results are
    cached until the file changes.
    """
    if not path.exists():
        raise InputError(f"{where}: no such file")
    untrusted.check_file(path, where)
    stamp = path.stat()
    return _read(path, unit_m, where, (stamp.st_mtime_ns, stamp.st_size))


@lru_cache(maxsize=16)
def _read(path: Path, unit_m: float, where: str, stamp: tuple[int, int]) -> tuple[Part, ...]:
    import trimesh

    try:
        _check_indices(path, where)
        scene = _quick_off(path) or trimesh.load_scene(path, process=False, resolver=_beside(path, where))
        # trimesh's own transformed copies lose the normals of the file, so transforms are applied here.
        nodes = [scene.graph.get(node) for node in scene.graph.nodes_geometry]
        geometries = [(scene.geometry[name], matrix) for matrix, name in nodes]
        with np.errstate(invalid="ignore", over="ignore"):  # values that are not finite are refused below
            parts = [
                _part(mesh, matrix, unit_m, path) for mesh, matrix in geometries if isinstance(mesh, trimesh.Trimesh)
            ]
    except InputError:
        raise
    except Exception as error:  # trimesh passes on any exception of its parsers
        raise InputError(f"{where}: does not load ({error}); allowed are {FORMATS}") from None
    parts = [part for part in parts if len(part.faces)]
    if not parts:
        raise InputError(f"{where}: has no faces")
    for part in parts:
        if not np.isfinite(part.vertices).all() or part.faces.max() >= len(part.vertices):
            raise InputError(f"{where}: has vertices that are not finite, or faces that refer to missing vertices")
        if np.abs(part.vertices).max() > FARTHEST_M:
            raise InputError(f"{where}: has vertices beyond {FARTHEST_M:g} m; correct them, or unit_cm")
        if part.uv is not None and not (np.abs(part.uv) <= MOST_COPIES).all():
            raise InputError(f"{where}: has texture coordinates that are not finite, or beyond {MOST_COPIES:g}")
    return tuple(parts)


def _beside(path: Path, where: str) -> Any:
    """Resolver of trimesh for the files that a mesh names, such as pictures: those in its folder, and no pipes."""
    from trimesh.resolvers import FilePathResolver

    class Beside(FilePathResolver):
        def get(self, name: str) -> bytes:
            file = (path.parent / str(name).strip()).resolve()
            if not file.is_relative_to(path.parent.resolve()):
                raise InputError(f"{where}: names the file {name}, which lies outside its folder")
            return untrusted.content(file, f"{where}: {name}") if file.exists() else super().get(name)

    return Beside(str(path))


def _check_indices(path: Path, where: str) -> None:
    """Raise InputError for an OBJ file with an index 0: its indices begin at 1, and trimesh would take the last."""
    if path.suffix.lower() == ".obj" and (found := _INDEX_0.search(untrusted.content(path, where))):
        line = found.group(0).decode(errors="replace").strip()
        raise InputError(f"{where}: has a face '{line[:40]}' with the index 0; indices of OBJ begin at 1")


def _quick_off(path: Path) -> Any:
    """A trimesh scene of a plain triangle OFF file, five times faster than trimesh's reader; None for other files."""
    import trimesh

    if path.suffix.lower() != ".off":
        return None
    head, _, body = path.read_text(encoding="ascii", errors="replace").strip().partition("\n")
    if head.strip() != "OFF" or "#" in body:
        return None
    numbers = np.array(body.split(), dtype=np.float64)
    vertices, faces = int(numbers[0]), int(numbers[1])
    end = 3 + 3 * vertices
    table = numbers[end:].reshape(faces, -1) if faces and (len(numbers) - end) == 4 * faces else None
    if table is None or (table[:, 0] != 3).any():
        return None
    mesh = trimesh.Trimesh(numbers[3:end].reshape(-1, 3), table[:, 1:].astype(np.int64), process=False)
    return trimesh.Scene([mesh])


def _part(mesh: Any, matrix: FloatArray, unit_m: float, path: Path) -> Part:
    """A part in the coordinates of its file's scene graph, in metres; ``matrix`` [4, 4] is its transform."""
    linear_map = matrix[:3, :3]
    vertices = (np.asarray(mesh.vertices, dtype=np.float64) @ linear_map.T + matrix[:3, 3]) * unit_m
    faces = np.asarray(mesh.faces, dtype=np.uint32)
    if np.linalg.det(linear_map) < 0:  # a reflection turns a mesh inside out
        faces = faces[:, ::-1]
    uv = getattr(mesh.visual, "uv", None)
    normals = None
    if "vertex_normals" in mesh._cache:  # normals of the file; trimesh would compute missing ones on access
        normals = np.array(mesh.vertex_normals) @ np.linalg.inv(linear_map)
        normals /= np.maximum(np.linalg.norm(normals, axis=-1, keepdims=True), 1e-12)
    paint_kind, paint = _paint(mesh.visual, uv is not None, linear=path.suffix.lower() in (".glb", ".gltf"))
    return Part(vertices, faces, None if uv is None else np.array(uv, dtype=np.float64), normals, paint, paint_kind)


# --- colours -------------------------------------------------------------------------------------


def decode_srgb(encoded: NDArray[Any]) -> Float32Array:
    """Linear light 0..1 of sRGB values, which are 8-bit integers or 0..1 (IEC 61966-2-1)."""
    values = np.asarray(encoded)
    if values.dtype == np.uint8:
        return _SRGB[values]
    values = values.astype(np.float32)
    return np.where(values <= 0.04045, values / 12.92, ((values + 0.055) / 1.055) ** 2.4).astype(np.float32)


def _paint(visual: Any, has_uv: bool, *, linear: bool) -> tuple[str | None, Float32Array | None]:
    """Kind and linear values of a part's colours, as ``Part.paint_kind`` and ``Part.paint``.

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
    if image is not None and image.size[0] * image.size[1] > MOST_TEXELS:  # before it is decoded
        raise ValueError(f"its picture has {image.size[0]} x {image.size[1]} pixels, {MOST_TEXELS} are allowed")
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


def colour_kinds(parts: tuple[Part, ...]) -> list[str]:
    """Kinds of colours (``Part.paint_kind``) that the parts have, sorted and without repetition."""
    return sorted({part.paint_kind for part in parts if part.paint_kind})


# --- one mesh ------------------------------------------------------------------------------------


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
    """Merge parts into one with a single picture of their colours.

    Raises InputError if a part has no colours, or if the picture would exceed ``MOST_TEXELS``.
    """
    if any(part.paint_kind is None for part in parts):
        raise InputError(f"{where}: some of its faces have no colours; give the object a material")
    textures = [_as_picture(part, where) for part in parts]
    pictures = [part.paint for part in textures if part.paint is not None]
    whole = merge(tuple(textures))
    if len(parts) == 1:
        return whole
    atlas, uv = _atlas(pictures, [part.uv for part in textures if part.uv is not None], where)
    return Part(whole.vertices, whole.faces, uv, whole.normals, atlas, "texture image")


def _as_picture(part: Part, where: str) -> Part:
    """The part with its colours converted to a picture, of whichever kind they are."""
    assert part.paint is not None
    if part.paint_kind == "texture image":
        return _repeat_picture(part, where)
    if part.paint_kind == "one colour":
        middle = np.full((len(part.vertices), 2), 0.5)
        return Part(part.vertices, part.faces, middle, part.normals, part.paint.reshape(1, 1, 3), "texture image")
    corners = part.paint[part.faces] if part.paint_kind == "vertex colours" else part.paint[:, None].repeat(3, axis=1)
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
    """Stack pictures vertically into an atlas [h, w, rgb] and map their ``uv`` into it, [sum n, 2].

    Each picture is padded by one texel of its own border, so that interpolation does not mix neighbours.
    """
    width = max(picture.shape[1] for picture in pictures) + 2
    heights = [picture.shape[0] + 2 for picture in pictures]
    _check_size(width * sum(heights), where)
    atlas = np.zeros((sum(heights), width, 3), np.float32)
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


# --- inside or outside ---------------------------------------------------------------------------


def winding_number(corners: FloatArray) -> float:
    """Winding number of triangles [m, 3, xyz] around the origin.

    It is the sum of the triangles' signed solid angles (van Oosterom and Strackee 1983, eq. 8) over 4 pi: 1 inside a
    closed mesh, 0 outside, -1 inside a mesh that is inside out, and a fraction for a mesh with holes.
    """
    a, b, c = corners[:, 0], corners[:, 1], corners[:, 2]
    la, lb, lc = (np.linalg.norm(side, axis=-1) for side in (a, b, c))
    volume = np.einsum("ij,ij->i", a, np.cross(b, c))
    denominator = la * lb * lc
    for x, y, length in ((a, b, lc), (b, c, la), (c, a, lb)):
        denominator = denominator + np.einsum("ij,ij->i", x, y) * length
    return float(np.sum(2 * np.arctan2(volume, denominator)) / (4 * np.pi))


def distance_from_origin(corners: FloatArray) -> float:
    """Distance between the origin and the nearest point of the triangles [m, 3, xyz]."""
    from trimesh.triangles import closest_point

    reach = float(np.linalg.norm(corners, axis=-1).min())
    low, high = corners.min(axis=1), corners.max(axis=1)
    gap = np.linalg.norm(np.maximum(np.maximum(low, -high), 0.0), axis=-1)  # distance of each triangle's bounding box
    close = corners[gap <= reach]
    return float(np.linalg.norm(closest_point(close, np.zeros((len(close), 3))), axis=-1).min())
