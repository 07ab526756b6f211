"""Mesh files: their triangles, and their own RGB colours as one texture.

A file may hold several parts (GLB, OBJ with materials). Each keeps its geometry; their colours are put side by side in
one picture, so that an object stays one mesh with one surface. RGB says nothing of the near-infrared: what the
picture becomes there is the scene's choice (``dasim.materials.library.photograph_surface``).

Tested in tests/dasim/scene/test_shapes.py.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dasim.base.errors import InputError
from dasim.typing import Float32Array, FloatArray

FORMATS = "OBJ, PLY, GLB, STL, OFF"
MOST_TEXELS = 1 << 24  # of all pictures of a mesh together: 200 MB in linear light, as much again as ink weights


@dataclass(frozen=True, eq=False)  # compared as what it is, so that results can be kept
class Part:
    """A part of a mesh file: ``vertices`` [n, 3] metres, ``faces`` [m, 3], ``uv`` and ``normals`` [n, ...] or None.

    ``normals`` are those of the file; without, faces are flat, as the geometry is. ``paint`` is its colours in linear
    light: a picture [h, w, 3] laid out by ``uv`` (bottom row at v = 0), or colours [n, 3] of the vertices, [m, 3] of
    the faces, or one [3]; ``painted`` says which, and is None where the file has no colours.
    """

    vertices: FloatArray
    faces: NDArray[np.uint32]
    uv: FloatArray | None = None
    normals: FloatArray | None = None
    paint: Float32Array | None = None
    painted: str | None = None


def read(path: Path, unit_m: float, where: str) -> tuple[Part, ...]:
    """The parts of a mesh file, ``unit_m`` the length of its unit; InputError where it is missing or broken."""
    if not path.is_file():
        raise InputError(f"{where}: no such file")
    stamp = path.stat()
    return _read(path, unit_m, where, (stamp.st_mtime_ns, stamp.st_size))


@lru_cache(maxsize=16)
def _read(path: Path, unit_m: float, where: str, stamp: tuple[int, int]) -> tuple[Part, ...]:
    import trimesh

    try:
        scene = _quick_off(path) or trimesh.load_scene(path, process=False)
        # Not through trimesh's own transformed copies, which forget the file's normals.
        placed = [scene.graph.get(node) for node in scene.graph.nodes_geometry]
        found = [(scene.geometry[name], matrix) for matrix, name in placed]
        parts = [_part(mesh, matrix, unit_m, path) for mesh, matrix in found if isinstance(mesh, trimesh.Trimesh)]
    except Exception as error:  # trimesh raises whatever its parsers stumble over
        raise InputError(f"{where}: does not load ({error}); allowed are {FORMATS}") from None
    parts = [part for part in parts if len(part.faces)]
    if not parts:
        raise InputError(f"{where}: has no faces")
    for part in parts:
        if not np.isfinite(part.vertices).all() or part.faces.max() >= len(part.vertices):
            raise InputError(f"{where}: has vertices that are not finite, or faces without their vertices")
    return tuple(parts)


def _quick_off(path: Path) -> Any:
    """Trimesh's scene of a plain OFF file of triangles, five times faster than its reader; None for all others."""
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
    """A part as it stands in its file's scene, by a transform [4, 4] of its own unit."""
    turn = matrix[:3, :3]
    vertices = (np.asarray(mesh.vertices, dtype=np.float64) @ turn.T + matrix[:3, 3]) * unit_m
    faces = np.asarray(mesh.faces, dtype=np.uint32)
    if np.linalg.det(turn) < 0:  # a mirrored part would be inside out
        faces = faces[:, ::-1]
    uv = getattr(mesh.visual, "uv", None)
    normals = None
    if "vertex_normals" in mesh._cache:  # those of the file; trimesh makes some up when asked for where it has none
        normals = np.array(mesh.vertex_normals) @ np.linalg.inv(turn)
        normals /= np.maximum(np.linalg.norm(normals, axis=-1, keepdims=True), 1e-12)
    painted, paint = _paint(mesh.visual, uv is not None, linear=path.suffix.lower() in (".glb", ".gltf"))
    return Part(vertices, faces, None if uv is None else np.array(uv, dtype=np.float64), normals, paint, painted)


# --- colours -------------------------------------------------------------------------------------


def decoded(encoded: NDArray[Any]) -> Float32Array:
    """Linear light 0..1 of sRGB values, 8 bits or 0..1 (IEC 61966-2-1)."""
    values = np.asarray(encoded)
    if values.dtype == np.uint8:
        return _SRGB[values]
    values = values.astype(np.float32)
    return np.where(values <= 0.04045, values / 12.92, ((values + 0.055) / 1.055) ** 2.4).astype(np.float32)


def _paint(visual: Any, has_uv: bool, *, linear: bool) -> tuple[str | None, Float32Array | None]:
    """What the file says of colours. glTF's vertex colours and factors are linear light, all else is sRGB."""
    if visual.kind in ("vertex", "face"):
        colours = np.asarray(visual.vertex_colors if visual.kind == "vertex" else visual.face_colors)[:, :3]
        paint = np.asarray(colours / 255, np.float32) if linear else decoded(colours)
        if (colours == colours[0]).all():
            return "one colour", np.asarray(paint[0])
        return f"{visual.kind} colours", paint
    material = getattr(visual, "material", None)
    if material is None:
        return None, None
    image = getattr(material, "baseColorTexture", None) if linear else getattr(material, "image", None)
    factor = getattr(material, "baseColorFactor", None)
    share = np.ones(3, np.float32) if factor is None else np.asarray(np.divide(factor[:3], 255), np.float32)
    made_up = not linear and not getattr(material, "kwargs", None)  # no line of a material library stands behind it
    if made_up and image is not None and image.size == (2, 2):
        return None, None  # trimesh's grey stand-in where a file has texture coordinates and no picture
    if image is not None and has_uv:
        return "texture image", decoded(np.asarray(image.convert("RGB"))) * (share if linear else np.float32(1.0))
    if linear:
        return "one colour", share
    diffuse = getattr(material, "diffuse", None)
    # trimesh gives an OBJ without a material library its default grey, which is not a colour of the file.
    if diffuse is None or made_up:
        return None, None
    return "one colour", decoded(np.asarray(diffuse, np.uint8)[:3])


_SRGB = decoded(np.arange(256) / 255)


def colour_kinds(parts: tuple[Part, ...]) -> list[str]:
    """How the parts are coloured, each kind once; empty where none is."""
    return sorted({part.painted for part in parts if part.painted})


# --- one mesh ------------------------------------------------------------------------------------


def joined(parts: tuple[Part, ...]) -> Part:
    """All parts as one without colours; ``uv`` and ``normals`` stay where all parts have them."""
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
def joined_with_colours(parts: tuple[Part, ...], where: str) -> Part:
    """All parts as one with a picture of their colours; InputError where a part has none or they are too many."""
    if any(part.painted is None for part in parts):
        raise InputError(f"{where}: has no colours of its own for some of its faces; give the object a material")
    shown = [_with_picture(part, where) for part in parts]
    pictures = [part.paint for part in shown if part.paint is not None]
    whole = joined(tuple(shown))
    if len(parts) == 1:
        return whole
    atlas, placed = _stacked(pictures, [part.uv for part in shown if part.uv is not None], where)
    return Part(whole.vertices, whole.faces, placed, whole.normals, atlas, "texture image")


def _with_picture(part: Part, where: str) -> Part:
    """The part with its colours as a picture, whatever they were."""
    assert part.paint is not None
    if part.painted == "texture image":
        return _within_picture(part, where)
    if part.painted == "one colour":
        middle = np.full((len(part.vertices), 2), 0.5)
        return Part(part.vertices, part.faces, middle, part.normals, part.paint.reshape(1, 1, 3), "texture image")
    corners = part.paint[part.faces] if part.painted == "vertex colours" else part.paint[:, None].repeat(3, axis=1)
    return _with_blocks(part, corners, where)


def _with_blocks(part: Part, corners: Float32Array, where: str) -> Part:
    """A picture with a block of 2 x 2 texels a face, whose corner colours are ``corners`` [m, 3, rgb].

    The face's corners lie at the centres of three texels; the fourth is c10 + c01 - c00, with which the bilinear
    interpolation is linear over the triangle (but where it had to be clipped to 0..1).
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
    return _unshared(part, place, picture.reshape(2 * rows, 2 * columns, 3))


def _within_picture(part: Part, where: str) -> Part:
    """A part whose texture coordinates lie within its picture, which is repeated where a face spans several copies.

    Mesh files repeat a picture beyond 0..1; the renderer's mixtures mirror it, and pictures side by side cannot.
    """
    assert part.uv is not None and part.paint is not None
    if part.uv.min() >= 0 and part.uv.max() <= 1:
        return part
    corners = part.uv[part.faces]
    corners = corners - np.floor(corners.min(axis=1, keepdims=True) + 1e-9)
    copies = np.maximum(np.ceil(corners.max(axis=(0, 1)) - 1e-6), 1).astype(int)
    height, width = part.paint.shape[:2]
    _check_size(int(height * copies[1]) * int(width * copies[0]), where)
    # v counts from the bottom, and so do the copies: all are whole, so that order does not matter.
    return _unshared(part, corners.reshape(-1, 2) / copies, np.tile(part.paint, (copies[1], copies[0], 1)))


def _unshared(part: Part, uv: FloatArray, picture: Float32Array) -> Part:
    """The part with vertices of its own for every face."""
    order = part.faces.ravel()
    faces = np.arange(len(order), dtype=np.uint32).reshape(-1, 3)
    normals = None if part.normals is None else part.normals[order]
    return Part(part.vertices[order], faces, uv, normals, picture, "texture image")


def _stacked(pictures: list[Float32Array], uv: list[FloatArray], where: str) -> tuple[Float32Array, FloatArray]:
    """Pictures above each other, each with a rim of its own border, and where their coordinates went."""
    width = max(picture.shape[1] for picture in pictures) + 2
    heights = [picture.shape[0] + 2 for picture in pictures]
    _check_size(width * sum(heights), where)
    atlas = np.zeros((sum(heights), width, 3), np.float32)
    placed, top = [], 0
    for picture, place, height in zip(pictures, uv, heights, strict=True):
        rows, columns = picture.shape[:2]
        atlas[top : top + height, : columns + 2] = np.pad(picture, ((1, 1), (1, 1), (0, 0)), mode="edge")
        down = top + 1 + (1 - place[:, 1]) * rows
        placed.append(np.stack([(1 + place[:, 0] * columns) / width, 1 - down / len(atlas)], axis=-1))
        top += height
    return atlas, np.concatenate(placed)


def _check_size(texels: int, where: str) -> None:
    if texels > MOST_TEXELS:
        raise InputError(
            f"{where}: its colours take {texels / 1e6:.0f} million texels, {MOST_TEXELS / 1e6:.0f} are allowed; "
            "reduce its pictures or faces, or give the object a material"
        )


# --- inside or outside ---------------------------------------------------------------------------


def turns_around_origin(corners: FloatArray) -> float:
    """Winding number of triangles [m, 3, xyz] around the origin: 1 inside a closed mesh, -1 where it is inside out.

    The triangles' solid angles over 4 pi, each by van Oosterom and Strackee (1983), eq. 8; a mesh with holes gives
    a fraction.
    """
    a, b, c = corners[:, 0], corners[:, 1], corners[:, 2]
    la, lb, lc = (np.linalg.norm(side, axis=-1) for side in (a, b, c))
    volume = np.einsum("ij,ij->i", a, np.cross(b, c))
    denominator = la * lb * lc
    for x, y, length in ((a, b, lc), (b, c, la), (c, a, lb)):
        denominator = denominator + np.einsum("ij,ij->i", x, y) * length
    return float(np.sum(2 * np.arctan2(volume, denominator)) / (4 * np.pi))


def distance_from_origin(corners: FloatArray) -> float:
    """Distance of the nearest point of any of the triangles [m, 3, xyz]."""
    from trimesh.triangles import closest_point

    reach = float(np.linalg.norm(corners, axis=-1).min())
    low, high = corners.min(axis=1), corners.max(axis=1)
    gap = np.linalg.norm(np.maximum(np.maximum(low, -high), 0.0), axis=-1)  # to each triangle's box
    close = corners[gap <= reach]
    return float(np.linalg.norm(closest_point(close, np.zeros((len(close), 3))), axis=-1).min())
