"""Procedural head and shoulders: signed distance fields of ellipsoids and capsules, joined by smooth unions.

The figure consists of six meshes, so that each can have its own material: ``figure-skin``, ``figure-hair``,
``figure-lips``, ``figure-eyes``, ``figure-irises`` and ``figure-shirt``. They share one origin: objects at the same
position form the figure, which faces the camera (-z). One unit is the height of the head, from the crown (y = -0.5) to
the chin (y = 0.5); the shoulders end at y = 1.2.

A field takes points [..., xyz] and returns approximate signed distances [...] from the surface, negative inside.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from dasim.scene.procedural.triangles import Triangles, ball, merge, sheet, smooth
from dasim.typing import FloatArray

Field = Callable[[FloatArray], FloatArray]
COARSE = 0.04  # step of the grid that locates the narrow band around a surface
EYE_AT, EYE_RADIUS = (0.128, -0.03, -0.268), 0.068


def _ellipsoid(points: FloatArray, at: tuple[float, float, float], radii: tuple[float, float, float]) -> FloatArray:
    """Approximate signed distance from an ellipsoid with centre ``at``, negative inside."""
    scaled = (points - at) / radii
    length = np.linalg.norm(scaled, axis=-1)
    steep = np.linalg.norm(scaled / radii, axis=-1)
    return length * (length - 1) / np.maximum(steep, 1e-9)


def _capsule(points: FloatArray, a: tuple[float, ...], b: tuple[float, ...], ra: float, rb: float) -> FloatArray:
    """Approximate signed distance from a capsule between ``a`` (radius ``ra``) and ``b`` (radius ``rb``)."""
    start, axis = np.array(a), np.subtract(b, a)
    share = np.clip((points - start) @ axis / (axis @ axis), 0.0, 1.0)
    return np.linalg.norm(points - start - share[..., None] * axis, axis=-1) - (ra + (rb - ra) * share)


def _smooth_union(first: FloatArray, second: FloatArray, width: float) -> FloatArray:
    """Union of two fields with a fillet of about ``width`` (polynomial smooth minimum, Quilez 2013)."""
    share = np.clip(0.5 + 0.5 * (second - first) / width, 0.0, 1.0)
    return second + (first - second) * share - width * share * (1 - share)


def _smooth_difference(first: FloatArray, second: FloatArray, width: float) -> FloatArray:
    """The first field minus the second, with a fillet of about ``width``."""
    return -_smooth_union(-first, second, width)


def _mirror(points: FloatArray) -> FloatArray:
    """Points reflected into the right half (x >= 0): a field of them is symmetric about x = 0."""
    return np.stack([np.abs(points[..., 0]), points[..., 1], points[..., 2]], axis=-1)


def _skull(p: FloatArray) -> FloatArray:
    s = _mirror(p)
    body = _ellipsoid(p, (0, -0.13, 0.06), (0.355, 0.37, 0.43))
    body = _smooth_union(body, _ellipsoid(p, (0, 0.14, -0.07), (0.27, 0.33, 0.29)), 0.12)  # face
    body = _smooth_union(body, _ellipsoid(p, (0, 0.395, -0.225), (0.10, 0.095, 0.10)), 0.12)  # chin
    body = _smooth_union(body, _ellipsoid(s, (0.19, 0.25, -0.03), (0.09, 0.13, 0.15)), 0.12)  # jaw
    return _smooth_union(body, _ellipsoid(s, (0.17, 0.095, -0.22), (0.09, 0.07, 0.09)), 0.10)  # cheeks


def _skin(p: FloatArray) -> FloatArray:
    s = _mirror(p)
    body = _skull(p)
    body = _smooth_union(body, _capsule(s, (0.05, -0.125, -0.335), (0.21, -0.125, -0.27), 0.035, 0.03), 0.07)  # brows
    body = _smooth_difference(body, _ellipsoid(s, (0.13, -0.035, -0.37), (0.085, 0.055, 0.085)), 0.06)  # eye sockets
    body = _smooth_union(body, _capsule(p, (0, -0.07, -0.325), (0, 0.10, -0.425), 0.032, 0.045), 0.05)  # bridge
    body = _smooth_union(body, _ellipsoid(p, (0, 0.12, -0.43), (0.055, 0.045, 0.055)), 0.03)  # tip
    body = _smooth_union(body, _ellipsoid(s, (0.052, 0.133, -0.385), (0.038, 0.032, 0.045)), 0.025)  # wings
    body = _smooth_difference(body, _ellipsoid(s, (0.026, 0.168, -0.425), (0.014, 0.014, 0.022)), 0.015)  # nostrils
    body = _smooth_union(body, _ellipsoid(p, (0, 0.255, -0.30), (0.11, 0.065, 0.055)), 0.05)  # mouth
    # Lids: shells around the eyes, open in front.
    lid = np.abs(_ellipsoid(s, EYE_AT, (EYE_RADIUS,) * 3) - 0.007) - 0.007
    slit = _ellipsoid(s, (EYE_AT[0], EYE_AT[1] + 0.004, EYE_AT[2] - 0.06), (0.066, 0.032, 0.09))
    body = _smooth_union(body, np.maximum(lid, -slit), 0.02)
    body = np.maximum(body, -_ellipsoid(s, EYE_AT, (EYE_RADIUS + 0.003,) * 3))
    ear = _ellipsoid(s, (0.355, 0.02, 0.07), (0.035, 0.125, 0.08))
    ear = _smooth_difference(ear, _ellipsoid(s, (0.40, 0.01, 0.045), (0.04, 0.075, 0.045)), 0.02)
    body = _smooth_union(body, ear, 0.03)
    neck = _capsule(p, (0, 0.25, 0.09), (0, 0.80, 0.13), 0.185, 0.20)
    return _smooth_union(body, neck, 0.08)


def _hair(p: FloatArray) -> FloatArray:
    """A cap of hair with locks over the skull; it leaves face and ears free."""
    angle = np.arctan2(p[..., 0], -p[..., 1] + 0.15)
    locks = 0.010 * np.sin(26 * angle + 5 * np.sin(9 * p[..., 2])) + 0.006 * np.sin(61 * angle - 23 * p[..., 2])
    cap = _ellipsoid(p, (0, -0.155, 0.075), (0.385, 0.40, 0.455)) + locks
    # Hair grows above the hairline, or behind a surface that runs from the temples down behind the ears.
    hairline = -0.29 + 0.05 * np.cos(7 * p[..., 0]) - 0.05 * np.exp(-(((p[..., 0] - 0.1) / 0.12) ** 2))
    behind = p[..., 2] - (0.02 + 0.10 * np.tanh(6 * (p[..., 1] + 0.12)))
    cap = np.maximum(cap, -np.maximum(hairline - p[..., 1], behind))
    cap = np.maximum(cap, p[..., 1] - 0.27)  # ends at the nape
    return cap


def _brows(p: FloatArray) -> FloatArray:
    s = _mirror(p)
    arch = (p[..., 1] + 0.150 - 0.4 * (s[..., 0] - 0.15) ** 2 / 0.15) / 0.022
    return _skin_relief(p, 0.012, 1 - arch**2 - ((s[..., 0] - 0.135) / 0.085) ** 4)


def _skin_relief(p: FloatArray, height: float, share: FloatArray) -> FloatArray:
    """A layer on the front of the skin: ``height * share`` thick, absent where ``share`` is 0 or less."""
    skin = _skin(p)
    layer = np.maximum(skin - height * np.clip(share, -3.0, 1.0), -2.5 * height - skin)
    return np.maximum(layer, p[..., 2] + 0.15)


def _lips(p: FloatArray) -> FloatArray:
    """Two lips that meet in a line; the upper one has a Cupid's bow."""
    x = p[..., 0] / 0.105
    middle = 0.258 + 0.005 * np.cos(2 * np.pi * np.clip(x, -1, 1))
    full = np.maximum(1 - x**2, 0.0)
    upper = (middle - p[..., 1]) / (0.026 * full**0.7 * (1 - 0.2 * np.exp(-((x / 0.12) ** 2))) + 1e-3)
    lower = (p[..., 1] - middle) / (0.034 * full**0.6 + 1e-3)
    away = np.where(p[..., 1] < middle, upper, lower)
    return _skin_relief(p, 0.016, 4 * np.minimum(np.minimum(away + 0.02, 1 - away), 1 - x**2))


def _shirt(p: FloatArray) -> FloatArray:
    s = _mirror(p)
    body = _capsule(s, (0.0, 0.90, 0.12), (0.52, 0.99, 0.14), 0.27, 0.17)
    body = _smooth_union(body, _ellipsoid(p, (0, 1.27, 0.10), (0.62, 0.55, 0.30)), 0.15)
    collar = np.abs(_capsule(p, (0, 0.60, 0.12), (0, 0.87, 0.12), 0.235, 0.30)) - 0.02
    collar = np.maximum(collar, 0.60 + 0.25 * (-(p[..., 2] - 0.12)) - p[..., 1])
    body = _smooth_union(body, collar, 0.03)
    folds = 0.008 * np.sin(14 * p[..., 0] + 6 * p[..., 1]) + 0.006 * np.sin(23 * p[..., 0] - 11 * p[..., 1])
    return np.maximum(body + folds, p[..., 1] - 1.2)


def _isosurface(field: Field, low: tuple[float, ...], high: tuple[float, ...], step: float) -> Triangles:
    """The zero level set of a field in the box from ``low`` to ``high``, by marching cubes on a grid of ``step``.

    Texture coordinate u runs once around the upright axis; v is 0 at y = 1.2 and 1 at y = -0.6.
    """
    from skimage.measure import marching_cubes

    axes = [np.arange(a, b + step, step) for a, b in zip(low, high, strict=True)]
    values = (
        field(np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)) if step < COARSE / 8 else _narrow_band(field, axes)
    )
    # With values that grow inwards, "ascent" orders corners counter-clockwise as seen from outside.
    corners, faces, _, _ = marching_cubes(-values, 0.0, gradient_direction="ascent", allow_degenerate=False)
    vertices = corners.astype(np.float64) * step + [axis[0] for axis in axes]
    return _cylindrical_mapping(vertices, faces.astype(np.uint32))


def _narrow_band(field: Field, axes: list[FloatArray]) -> FloatArray:
    """A field on a grid: evaluated within 2 ``COARSE`` of its surface, interpolated from a coarse grid elsewhere.

    Since fields are approximate distances, a cell of the coarse grid that the surface crosses lies within that band.
    """
    from scipy.interpolate import RegularGridInterpolator

    coarse = [np.arange(axis[0], axis[-1] + 2 * COARSE, COARSE) for axis in axes]
    values = field(np.stack(np.meshgrid(*coarse, indexing="ij"), axis=-1))
    points = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)
    result = RegularGridInterpolator(coarse, values)(points)
    close = np.abs(result) < 2 * COARSE
    result[close] = field(points[close])
    return np.asarray(result)


def _cylindrical_mapping(vertices: FloatArray, faces: np.ndarray) -> Triangles:
    """A smooth mesh with cylindrical texture coordinates; vertices on the seam, at the back, are duplicated."""
    u = np.arctan2(vertices[:, 0], -vertices[:, 2]) / (2 * np.pi) + 0.5
    whole = smooth(vertices, faces, np.stack([u, (1.2 - vertices[:, 1]) / 1.8], axis=-1))
    around = u[faces]
    beyond = (around.max(axis=1, keepdims=True) - around > 0.5).ravel()  # corners on the far side of the seam
    old, new = np.unique(faces.ravel()[beyond], return_inverse=True)
    corners = faces.ravel().copy()
    corners[beyond] = len(vertices) + new
    return Triangles(
        np.concatenate([whole.vertices, whole.vertices[old]]),
        corners.reshape(-1, 3).astype(np.uint32),
        np.concatenate([whole.uv, whole.uv[old] + [1.0, 0.0]]),
        np.concatenate([whole.normals, whole.normals[old]]),
    )


def _hair_and_brows(_: int) -> Triangles:
    brows = _isosurface(_brows, (-0.26, -0.22, -0.45), (0.26, -0.08, -0.12), 0.0048)
    return merge([_isosurface(_hair, (-0.44, -0.60, -0.44), (0.44, 0.32, 0.58), 0.0105), brows])


def _eyes(_: int) -> Triangles:
    return merge([_eye(side, EYE_RADIUS, np.pi) for side in (-1, 1)])


def _irises(_: int) -> Triangles:
    """The irises: spherical caps on the eyes, with the texture centred on each."""
    return merge([_eye(side, EYE_RADIUS * 1.012, 0.46) for side in (-1, 1)])


def _eye(side: int, radius: float, opening: float) -> Triangles:
    """A spherical cap around the viewing direction; ``opening`` is its half angle in radians, pi for a full ball."""
    directions = ball(32, 48)
    down = np.arccos(np.clip(-directions[..., 1], -1, 1)) * opening / np.pi
    turn = np.linspace(-np.pi, np.pi, directions.shape[1])
    points = np.stack([np.sin(down) * np.sin(turn), np.sin(down) * np.cos(turn), -np.cos(down)], axis=-1)
    cap = sheet(points, periodic=True)
    uv = 0.5 + 0.5 * cap.vertices[:, :2] * (1, -1) / np.sin(min(opening, np.pi / 2))
    return cap._replace(vertices=cap.vertices * radius + np.array(EYE_AT) * (side, 1, 1), uv=uv)


MESHES: dict[str, Callable[[int], Triangles]] = {
    "figure-skin": lambda _: _isosurface(_skin, (-0.42, -0.56, -0.54), (0.42, 0.86, 0.54), 0.0125),
    "figure-hair": _hair_and_brows,
    "figure-lips": lambda _: _isosurface(_lips, (-0.12, 0.21, -0.42), (0.12, 0.31, -0.22), 0.003),
    "figure-eyes": _eyes,
    "figure-irises": _irises,
    "figure-shirt": lambda _: _isosurface(_shirt, (-0.74, 0.5, -0.28), (0.74, 1.22, 0.52), 0.016),
}
