"""Pictures of the reports: photographs, depth maps on a common scale, and views of textured surfaces from all sides.

Tested in tests/validation/claims/test_pictures.py.
"""

from __future__ import annotations

import base64
from collections.abc import Sequence
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from dasim.typing import BoolArray, FloatArray
from recon.views.surface import Surface
from validation.reports.page import MAP, NO_ESTIMATE
from validation.reports.plots import svg_address

JPEG_QUALITY = 92  # a fifth of the size of PNG for a noisy photograph, without a visible difference
PANEL_INCH = 3.2  # width of a map
DPI = 130
TICKS = 5
LEVEL_PANEL_INCH = 2.4  # width of a map in a row with those of several methods
ERROR_MAP, ERROR_SHARE = "magma", 0.25  # colours of errors, and their top as a share of that of the levels
SCALE_PERCENTILE = 99.5  # of the true levels: the top of the colours
BEHIND_FOCUS = "///"
BACKGROUND = 255
SUPERSAMPLING = 2
PITCH_DEG = 4.0  # the viewer's elevation above the optical axis
BACK_OFF = 0.5  # distance that the viewer steps back, relative to that of the axis of rotation
LEAST_DEPTH = 0.05  # of the axis of rotation: nearer triangles are not drawn
POINTS = 6  # along each edge of a triangle: dense for triangles of up to 5 pixels of the supersampled picture


def photo_address(image: NDArray[Any]) -> str:
    """A photograph [h, w, 3] of display values 0..1 as a data URL (JPEG)."""
    encoded = np.rint(np.clip(np.nan_to_num(image), 0, 1) * 255).astype(np.uint8)[..., ::-1]
    sampling = [cv2.IMWRITE_JPEG_SAMPLING_FACTOR, cv2.IMWRITE_JPEG_SAMPLING_FACTOR_444]
    _, data = cv2.imencode(".jpg", np.ascontiguousarray(encoded), [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY, *sampling])
    return "data:image/jpeg;base64," + base64.b64encode(data.tobytes()).decode()


def depth_panels(maps: Sequence[tuple[str, NDArray[Any]]], nearest_m: float, farthest_m: float) -> str:
    """Depth maps [h, w] in metres side by side, each below its title, with a common colour bar in cm.

    Colours are linear in dioptres, as blur is, from ``farthest_m`` to ``nearest_m``; NaN is grey.
    """
    import matplotlib
    from matplotlib.backends.backend_svg import FigureCanvasSVG
    from matplotlib.figure import Figure

    height, width = maps[0][1].shape
    colours = matplotlib.colormaps[MAP].with_extremes(bad=NO_ESTIMATE)
    size = (PANEL_INCH * len(maps) + 0.9, PANEL_INCH * height / width + 0.35)
    with matplotlib.rc_context({"font.size": 9}):
        figure = Figure(figsize=size, dpi=DPI, layout="constrained")
        FigureCanvasSVG(figure)
        axes = np.atleast_1d(figure.subplots(1, len(maps)))
        for one, (title, depth_m) in zip(axes, maps, strict=True):
            vergence = 1 / np.asarray(depth_m, np.float64)
            image = one.imshow(
                np.ma.masked_invalid(vergence), cmap=colours, vmin=1 / farthest_m, vmax=1 / nearest_m,
                interpolation="nearest",
            )  # fmt: skip
            one.set_title(title)
            one.set_axis_off()
        bar = figure.colorbar(image, ax=list(axes), label="depth z (cm)", pad=0.01)
        ticks = np.linspace(1 / farthest_m, 1 / nearest_m, TICKS)
        bar.set_ticks(list(ticks), labels=[f"{100 / tick:.3g}" for tick in ticks])
        return svg_address(figure, DPI)


def level_panels(photo: NDArray[Any], maps: Sequence[tuple[str, NDArray[Any]]], near: BoolArray) -> str:
    """A photograph, maps of levels with one colour bar, and the error of the second map against the first.

    Args:
        photo: display values 0..1, [h, w, 3].
        maps: titles and levels [h, w], the true levels first. NaN is grey.
        near: pixels [h, w] on the near side of the focal plane; the others are grey and hatched.
    """
    import matplotlib
    from matplotlib.backends.backend_svg import FigureCanvasSVG
    from matplotlib.figure import Figure

    (_, true), (title, first) = maps[:2]
    top = max(float(np.percentile(true[near], SCALE_PERCENTILE)), 1.0) if near.any() else 1.0
    error = f"|error|, {title}", np.abs(first - true)
    size = (LEVEL_PANEL_INCH * (len(maps) + 2) + 1.6, LEVEL_PANEL_INCH * near.shape[0] / near.shape[1] + 0.35)
    with matplotlib.rc_context({"font.size": 8, "hatch.linewidth": 0.5}):
        figure = Figure(figsize=size, dpi=DPI, layout="constrained")
        FigureCanvasSVG(figure)
        axes = figure.subplots(1, len(maps) + 2)
        axes[0].imshow(np.clip(np.nan_to_num(photo), 0, 1), interpolation="nearest")
        axes[0].set_title("all in focus, truth")
        for one, title_and_map in zip(axes[1:-1], maps, strict=True):
            image = _level_map(one, *title_and_map, near, top, MAP)
        figure.colorbar(image, ax=axes[-2], label="level", pad=0.02, extend="max")
        image = _level_map(axes[-1], *error, near, max(ERROR_SHARE * top, 1.0), ERROR_MAP)
        figure.colorbar(image, ax=axes[-1], label="|error|, levels", pad=0.02, extend="max")
        for one in axes:
            one.set_axis_off()
        return svg_address(figure, DPI)


def _level_map(axes: Any, title: str, level: NDArray[Any], near: BoolArray, top: float, colours: str) -> Any:
    """Draw a map of levels from 0 to ``top``, hatched where it is not ``near``; the image, for a colour bar."""
    import matplotlib

    shown = np.ma.masked_invalid(np.where(near, level, np.nan))
    colour_map = matplotlib.colormaps[colours].with_extremes(bad=NO_ESTIMATE)
    image = axes.imshow(shown, cmap=colour_map, vmin=0, vmax=top, interpolation="nearest")
    if not near.all():
        axes.contourf(~near, levels=[0.5, 1.5], colors="none", hatches=[BEHIND_FOCUS])
    axes.set_title(title)
    return image


def in_perspective(
    mesh: Surface, intrinsic: FloatArray, shape: tuple[int, int], pivot_m: float, yaw_deg: float
) -> FloatArray:
    """A textured surface seen by a pinhole that has moved around it; display values 0..1, [h, w, 3].

    The pinhole with the camera matrix ``intrinsic`` K and a frame of ``shape`` [h, w] turns about a vertical axis
    at the depth ``pivot_m`` by ``yaw_deg``, positive to the right, PITCH_DEG upwards, and backs off by BACK_OFF of the
    axis's depth, so that what was at the frame's edge stays visible. A yaw of 0 shows what the camera sees. Each
    triangle is drawn as points in the colour of its centre, nearer ones over farther ones, on white.
    """
    height, width = SUPERSAMPLING * shape[0], SUPERSAMPLING * shape[1]
    canvas = np.full((height, width, 3), BACKGROUND, np.uint8)
    if len(mesh.triangle):
        pivot = np.array([0, 0, pivot_m])
        turn = _rotation(yaw_deg, PITCH_DEG if yaw_deg else 0.0)
        seen = (mesh.vertex_m - pivot) @ turn.T + pivot * (1 + (BACK_OFF if yaw_deg else 0.0))
        faces = mesh.triangle[(seen[mesh.triangle, 2] > LEAST_DEPTH * pivot_m).all(axis=1)]
        faces = faces[np.argsort(-seen[faces, 2].mean(axis=1))]
        points = np.einsum("pc,fcx->fpx", _barycentric(POINTS), seen[faces])
        flat = SUPERSAMPLING * (points @ intrinsic[:2].T / points[..., 2:])
        inside = ((flat >= 0) & (flat < (width, height))).all(axis=-1)
        x, y = flat[inside].astype(int).T
        canvas[y, x] = np.broadcast_to(_colours(mesh, faces)[:, None], points.shape)[inside]
    return cv2.resize(canvas, (shape[1], shape[0]), interpolation=cv2.INTER_AREA).astype(np.float64) / 255


def _barycentric(count: int) -> FloatArray:
    """Weights [point, corner] of a triangular grid with ``count`` points along each edge of a triangle."""
    i, j = (index.ravel() for index in np.indices((count, count)))
    inside = i + j < count
    a, b = i[inside] / (count - 1), j[inside] / (count - 1)
    return np.stack([a, b, 1 - a - b], axis=1)


def _rotation(yaw_deg: float, pitch_deg: float) -> FloatArray:
    """Rotation matrix that shows a scene from the right (yaw) and from above (pitch); x right, y down, z forward."""
    yaw, pitch = np.radians(yaw_deg), np.radians(pitch_deg)
    about_y = np.array([[np.cos(yaw), 0, np.sin(yaw)], [0, 1, 0], [-np.sin(yaw), 0, np.cos(yaw)]])
    about_x = np.array([[1, 0, 0], [0, np.cos(pitch), -np.sin(pitch)], [0, np.sin(pitch), np.cos(pitch)]])
    return np.asarray(about_x @ about_y)


def _colours(mesh: Surface, faces: NDArray[np.int64]) -> NDArray[np.uint8]:
    """Colour of the texture at each triangle's centre, [n, 3]."""
    height, width = mesh.picture.shape[:2]
    u, v = mesh.uv[faces].mean(axis=1).T
    rows = np.clip(((1 - v) * height).astype(int), 0, height - 1)
    columns = np.clip((u * width).astype(int), 0, width - 1)
    return mesh.picture[rows, columns]
