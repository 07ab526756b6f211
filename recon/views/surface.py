"""The surface of the scene as a textured mesh (Fig. 8(e, f)), cut at depth discontinuities and low confidence."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dasim.base import atomic
from dasim.base.errors import InputError
from dasim.camera.sensor import principal_point
from dasim.camera.specification import Camera
from dasim.typing import FloatArray

JUMP_SHARE = 0.01  # relative depth difference per pixel; a plane at 87 degrees to da-mobile has 0.9 %
LEAST_CONFIDENCE = 0.1  # a standard deviation of three blur levels; below, depths on the scene desk are off by factors
SMALLEST_PIECE = 5e-4  # of the frame; smaller pieces that are cut off all around are outliers
LARGEST_STRIDE_PX = 64
GLTF_AXES = np.array([1.0, -1.0, -1.0])  # y up, z towards the viewer, from the camera's y down, z forward


@dataclass(frozen=True)
class Surface:
    """A textured triangle mesh in camera coordinates."""

    vertex_m: FloatArray  # [n, 3] x right, y down, z forward from the lens
    uv: FloatArray  # [n, 2] position in the picture, 0..1, origin at the bottom left
    triangle: NDArray[np.int64]  # [m, 3] vertex indices, anticlockwise as seen by the camera
    picture: NDArray[np.uint8]  # [h, w, 3] texture

    @property
    def normal(self) -> FloatArray:
        """Unit normals [n, 3] at the vertices, towards the camera: the mean of the triangles', weighted by area."""
        a, b, c = (self.vertex_m[self.triangle[:, i]] for i in range(3))
        of_triangle = np.cross(b - a, c - a)
        total = np.zeros_like(self.vertex_m)
        for corner in range(3):
            np.add.at(total, self.triangle[:, corner], of_triangle)
        return np.asarray(total / np.linalg.norm(total, axis=1, keepdims=True))


def intrinsic_matrix(camera: Camera) -> FloatArray:
    """Pinhole intrinsics K in pixels, [3, 3]; pixel centres are at +0.5.

    The focal length in pixels is the image distance s' = f s / (s - f) of the focus distance s over the pixel pitch.
    """
    focal_m, focus_m = camera.lens.focal_length_mm * 1e-3, camera.lens.focus_distance_m
    focal_px = focal_m * focus_m / (focus_m - focal_m) / (camera.sensor.pixel_pitch_um * 1e-6)
    x, y = principal_point(camera.sensor)
    return np.array([[focal_px, 0, x], [0, focal_px, y], [0, 0, 1.0]])


def distortion_per_px(camera: Camera) -> tuple[float, ...]:
    """Coefficients a_k of the lens's distortion 1 + sum a_k r^(2k) with r in pixels, from those of the camera's mm."""
    pitch_mm = camera.sensor.pixel_pitch_um * 1e-3
    return tuple(value * pitch_mm ** (2 * k) for k, value in enumerate(camera.lens.distortion_per_mm, start=1))


def surface(
    image: NDArray[Any],
    depth_m: NDArray[Any],
    intrinsic: FloatArray,
    *,
    confidence: NDArray[Any] | None = None,
    distortion_per_px: Sequence[float] = (),
    stride_px: int = 1,
    jump_share: float = JUMP_SHARE,
    smallest_piece: float = 0.0,
) -> Surface:
    """Textured mesh of a picture at its depths.

    The vertices are X = z K^-1 (u, v, 1) at the centres of every ``stride_px``-th pixel, with two triangles between
    four neighbours. With distortion, (u, v) is where a pinhole shows what the pixel shows: at 1 + sum a_k r^(2k) times
    the pixel's distance r from the principal point. Triangles with an unknown depth, a confidence below
    ``LEAST_CONFIDENCE`` or a depth difference above ``jump_share`` of the depth per pixel are omitted, so that objects
    are separated from the background; so are connected pieces smaller than ``smallest_piece``.

    Args:
        image: display values 0..1, [h, w, 3].
        depth_m: depth, metres, [h, w]; NaN where unknown.
        intrinsic: the pinhole matrix K in pixels, [3, 3].
        confidence: of the depths, 0..1, [h, w]; by default all are trusted.
        distortion_per_px: a_k of the lens's distortion, r in pixels; none by default.
        stride_px: distance between vertices, pixels.
        jump_share: largest relative depth difference per pixel within a surface.
        smallest_piece: least area of a connected piece, as a share of the frame, such as SMALLEST_PIECE.
    """
    if not (isinstance(stride_px, int) and 1 <= stride_px <= LARGEST_STRIDE_PX):
        raise InputError(
            f"surface: a stride of {stride_px} px is not allowed; give 1 to {LARGEST_STRIDE_PX}, such as 2"
        )
    if not jump_share > 0:
        raise InputError(
            f"surface: a jump of {jump_share:g} of depth is not allowed; give more than 0, such as {JUMP_SHARE:g}"
        )
    height, width = depth_m.shape
    if image.shape[:2] != (height, width):
        raise InputError(
            f"surface: a picture of {image.shape[1]} x {image.shape[0]} pixels does not match depths of "
            f"{width} x {height}"
        )
    rows, columns = np.arange(0, height, stride_px), np.arange(0, width, stride_px)
    depth = depth_m[np.ix_(rows, columns)].astype(np.float64)
    known = np.isfinite(depth) & (depth > 0)
    if confidence is not None:
        known &= confidence[np.ix_(rows, columns)] >= LEAST_CONFIDENCE
    x, y = np.meshgrid(columns + 0.5, rows + 0.5)
    ray = np.stack([*_at_pinhole(x, y, intrinsic, distortion_per_px), np.ones_like(x)], axis=-1)
    ray = ray @ np.linalg.inv(intrinsic).T
    faces = _large_pieces(_faces(np.where(known, depth, np.nan), jump_share * stride_px), depth.size, smallest_piece)
    used, index = np.unique(faces, return_inverse=True)
    vertices = (np.where(known, depth, 0)[..., None] * ray).reshape(-1, 3)[used]
    uv = np.stack([x / width, 1 - y / height], axis=-1).reshape(-1, 2)[used]
    picture = np.rint(np.clip(np.nan_to_num(image), 0, 1) * 255).astype(np.uint8)
    return Surface(vertices, uv, index.reshape(-1, 3), picture)


def _at_pinhole(
    x: FloatArray, y: FloatArray, intrinsic: FloatArray, distortion_per_px: Sequence[float]
) -> tuple[FloatArray, FloatArray]:
    """Where a pinhole shows what the lens shows at places of the picture, both in pixels."""
    right, down = x - intrinsic[0, 2], y - intrinsic[1, 2]
    factor = np.polynomial.polynomial.polyval(right**2 + down**2, [1.0, *distortion_per_px])
    return intrinsic[0, 2] + factor * right, intrinsic[1, 2] + factor * down


def _faces(depth: FloatArray, jump: float) -> NDArray[np.int64]:
    """Triangles [m, 3] of a grid of depths [h, w], without those at a NaN or a depth discontinuity."""
    index = np.arange(depth.size).reshape(depth.shape)
    a, b, c, d = index[:-1, :-1], index[1:, :-1], index[:-1, 1:], index[1:, 1:]
    triangles = np.concatenate([np.stack([a, b, c], -1).reshape(-1, 3), np.stack([c, b, d], -1).reshape(-1, 3)])
    corner = depth.ravel()[triangles]
    whole = np.isfinite(corner).all(axis=1)
    near = np.min(corner, axis=1, where=np.isfinite(corner), initial=np.inf)
    far = np.max(corner, axis=1, where=np.isfinite(corner), initial=0)
    return triangles[whole & (far - near <= jump * near)]


def _large_pieces(faces: NDArray[np.int64], vertices: int, smallest_piece: float) -> NDArray[np.int64]:
    """The triangles [m, 3] of pieces, connected by shared vertices, that have at least a share of all vertices."""
    from scipy import sparse

    if not smallest_piece or not len(faces):
        return faces
    edges = np.concatenate([faces[:, :2], faces[:, 1:]])
    ones = np.ones(len(edges), np.uint8)
    _, piece = sparse.csgraph.connected_components(
        sparse.coo_array((ones, (edges[:, 0], edges[:, 1])), (vertices, vertices)), directed=False
    )
    return faces[np.bincount(piece)[piece[faces[:, 0]]] >= smallest_piece * vertices]


def save_surface(path: Path, mesh: Surface) -> None:
    """Write a ``.ply`` file with vertex colours in the camera's axes, or a ``.glb`` file with a texture, in metres.

    Both have normals at their vertices. The axes of GLB are y up and z towards the viewer.
    """
    import trimesh
    from PIL import Image

    path = Path(path)
    if path.suffix.lower() not in (".ply", ".glb"):
        raise InputError(f"surface {path}: '{path.suffix}' files are not supported; give '.ply' or '.glb'")
    if not len(mesh.triangle):
        raise InputError(f"surface {path}: no neighbouring pixels have a depth; nothing to write")
    if path.suffix.lower() == ".glb":
        material = trimesh.visual.material.PBRMaterial(
            baseColorTexture=Image.fromarray(mesh.picture), metallicFactor=0.0, roughnessFactor=1.0, doubleSided=True
        )
        look: Any = trimesh.visual.TextureVisuals(uv=mesh.uv, material=material)
        body = trimesh.Trimesh(
            mesh.vertex_m * GLTF_AXES, mesh.triangle, vertex_normals=mesh.normal * GLTF_AXES, visual=look, process=False
        )
        data = body.export(file_type="glb", include_normals=True)
    else:
        height, width = mesh.picture.shape[:2]
        index = np.floor([(1 - mesh.uv[:, 1]) * height, mesh.uv[:, 0] * width]).astype(int)
        colours = mesh.picture[index[0], index[1]]
        body = trimesh.Trimesh(
            mesh.vertex_m, mesh.triangle, vertex_normals=mesh.normal, vertex_colors=colours, process=False
        )
        data = body.export(file_type="ply", vertex_normal=True)
    atomic.write(path, data)
