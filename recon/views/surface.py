"""The photographed surface in three dimensions (Fig. 8(e, f)): a textured mesh, cut where depth jumps."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dasim.base.errors import InputError
from dasim.camera.specification import Camera
from dasim.typing import FloatArray

JUMP_SHARE = 0.02  # of depth per pixel: a face seen at 88 degrees through da-mobile rises by 1.3 %
LARGEST_STRIDE_PX = 64
GLTF_AXES = np.array([1.0, -1.0, -1.0])  # y up, z towards the viewer, from the camera's y down, z forward


@dataclass(frozen=True)
class Surface:
    """Triangles before the camera."""

    vertex_m: FloatArray  # [n, 3] x right, y down, z forward from the lens
    uv: FloatArray  # [n, 2] place in the picture, 0..1, origin at the bottom left
    triangle: NDArray[np.int64]  # [m, 3] anticlockwise as the camera sees them
    picture: NDArray[np.uint8]  # [h, w, 3] texture


def intrinsic_matrix(camera: Camera) -> FloatArray:
    """Pinhole intrinsics K in pixels, [3, 3]; pixel centres at +0.5, the principal point in the frame's centre.

    The focal length in pixels is the image distance s' = f s / (s - f) of the focus distance s over the pixel pitch.
    """
    focal_m, focus_m = camera.lens.focal_length_mm * 1e-3, camera.lens.focus_distance_m
    focal_px = focal_m * focus_m / (focus_m - focal_m) / (camera.sensor.pixel_pitch_um * 1e-6)
    return np.array(
        [[focal_px, 0, camera.sensor.width_px / 2], [0, focal_px, camera.sensor.height_px / 2], [0, 0, 1.0]]
    )


def surface(
    image: NDArray[Any],
    depth_m: NDArray[Any],
    intrinsic: FloatArray,
    *,
    stride_px: int = 1,
    jump_share: float = JUMP_SHARE,
) -> Surface:
    """Mesh of display values [h, w, 3], 0..1, at their depths [h, w], by the pinhole ``intrinsic`` [3, 3] in pixels.

    A vertex for each ``stride_px``-th pixel's centre, X = z K^-1 (u, v, 1); two triangles between four of them, left
    out where a depth is unknown or where depth differs by more than ``jump_share`` of itself per pixel: the edge
    between an object and what lies behind it is cut, not bridged.
    """
    if not (isinstance(stride_px, int) and 1 <= stride_px <= LARGEST_STRIDE_PX):
        raise InputError(f"surface: a stride of {stride_px} px; 1 to {LARGEST_STRIDE_PX} is allowed, such as 2")
    if not jump_share > 0:
        raise InputError(f"surface: a jump of {jump_share:g} of depth; more than 0 is allowed, such as {JUMP_SHARE:g}")
    height, width = depth_m.shape
    if image.shape[:2] != (height, width):
        raise InputError(
            f"surface: a picture of {image.shape[1]} x {image.shape[0]} pixels does not fit depths of "
            f"{width} x {height}"
        )
    rows, columns = np.arange(0, height, stride_px), np.arange(0, width, stride_px)
    depth = depth_m[np.ix_(rows, columns)].astype(np.float64)
    known = np.isfinite(depth) & (depth > 0)
    x, y = np.meshgrid(columns + 0.5, rows + 0.5)
    ray = np.stack([x, y, np.ones_like(x)], axis=-1) @ np.linalg.inv(intrinsic).T
    faces = _faces(np.where(known, depth, np.nan), jump_share * stride_px)
    used, index = np.unique(faces, return_inverse=True)
    vertices = (np.where(known, depth, 0)[..., None] * ray).reshape(-1, 3)[used]
    uv = np.stack([x / width, 1 - y / height], axis=-1).reshape(-1, 2)[used]
    picture = np.rint(np.clip(np.nan_to_num(image), 0, 1) * 255).astype(np.uint8)
    return Surface(vertices, uv, index.reshape(-1, 3), picture)


def _faces(depth: FloatArray, jump: float) -> NDArray[np.int64]:
    """Triangles [m, 3] of a grid of depths [h, w], without those that a NaN or a jump touches."""
    index = np.arange(depth.size).reshape(depth.shape)
    a, b, c, d = index[:-1, :-1], index[1:, :-1], index[:-1, 1:], index[1:, 1:]
    triangles = np.concatenate([np.stack([a, b, c], -1).reshape(-1, 3), np.stack([c, b, d], -1).reshape(-1, 3)])
    corner = depth.ravel()[triangles]
    whole = np.isfinite(corner).all(axis=1)
    near = np.min(corner, axis=1, where=np.isfinite(corner), initial=np.inf)
    far = np.max(corner, axis=1, where=np.isfinite(corner), initial=0)
    return triangles[whole & (far - near <= jump * near)]


def save_surface(path: Path, mesh: Surface) -> None:
    """Write a ``.ply`` with colours at its vertices, in the camera's axes, or a ``.glb`` with its texture.

    GLB has its own axes (y up, z towards the viewer). Both are in metres.
    """
    import trimesh
    from PIL import Image

    path = Path(path)
    if path.suffix.lower() not in (".ply", ".glb"):
        raise InputError(f"surface {path}: '{path.suffix}' cannot be written; '.ply' or '.glb' is allowed")
    if not len(mesh.triangle):
        raise InputError(f"surface {path}: no two neighbouring pixels have a depth; nothing to write")
    if path.suffix.lower() == ".glb":
        material = trimesh.visual.material.PBRMaterial(
            baseColorTexture=Image.fromarray(mesh.picture), metallicFactor=0.0, roughnessFactor=1.0, doubleSided=True
        )
        look: Any = trimesh.visual.TextureVisuals(uv=mesh.uv, material=material)
        body = trimesh.Trimesh(mesh.vertex_m * GLTF_AXES, mesh.triangle, visual=look, process=False)
    else:
        height, width = mesh.picture.shape[:2]
        place = np.floor([(1 - mesh.uv[:, 1]) * height, mesh.uv[:, 0] * width]).astype(int)
        colours = mesh.picture[place[0], place[1]]
        body = trimesh.Trimesh(mesh.vertex_m, mesh.triangle, vertex_colors=colours, process=False)
    data = body.export(file_type=path.suffix.lower()[1:])
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(data)
