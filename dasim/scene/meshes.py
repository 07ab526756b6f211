"""Mesh files: their parts, each with its triangles and colours, and where a mesh lies from a point.

:mod:`dasim.scene.mesh_paint` reads the colours, :mod:`dasim.scene.mesh_merging` makes one mesh of the parts.

Tested in tests/dasim/scene/test_mesh_colours.py.
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
from dasim.scene import mesh_paint
from dasim.typing import Float32Array, FloatArray

FORMATS = "OBJ, PLY, GLB, STL, OFF"
FARTHEST_M = 1e4  # of a vertex from the origin of its file
MOST_COPIES = 1e4  # of a texture along u or v
_INDEX_0 = re.compile(rb"^[ \t]*f[ \t](?:[^\n#]*[ \t])?0+(?:/[^\s]*)?(?=\s|$)[^\n]*", re.MULTILINE)


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
        finish: picture [h, w, 5] mapped by ``uv``: metallic, roughness (both 0..1), and the normal map's x, y, z
            encoded to 0..1; None for matt colours. Only parts with a texture image or one colour have one
    """

    vertices: FloatArray
    faces: NDArray[np.uint32]
    uv: FloatArray | None = None
    normals: FloatArray | None = None
    paint: Float32Array | None = None
    paint_kind: str | None = None
    finish: Float32Array | None = None


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
    """Resolver of trimesh for files that a mesh refers to, such as textures: regular files in its folder only."""
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
    gltf = path.suffix.lower() in (".glb", ".gltf")
    paint_kind, paint = mesh_paint.paint(mesh.visual, uv is not None, linear=gltf)
    finish = mesh_paint.finish(mesh.visual, uv is not None) if gltf else None
    uv = None if uv is None else np.array(uv, dtype=np.float64)
    return Part(vertices, faces, uv, normals, paint, paint_kind, finish)


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
