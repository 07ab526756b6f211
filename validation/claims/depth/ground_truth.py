"""Claim on the ground truth: depth, normals, labels and blur compared with closed-form geometry."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

import dasim
from dasim.camera.specification import Camera
from dasim.typing import FloatArray, ShareDone
from validation.gates.claim import Evidence
from validation.references.paper import HOLE_RATIO
from validation.scores.figures import Figure
from validation.subjects import rendering

SIZE_PX = (256, 192)
PITCH_UM = 12.0  # of wide pixels: the frame's corner is 27 degrees off the axis, z and range differ by 12 %
FOCUS_M = 0.6
TILT_DEG = 35.0
WALL_M = 0.8
BALL_M = (-0.08, 0.05, 0.5, 0.12)  # x, y, z, radius
RIM = 1e-4  # of the ball's radius: nearer to its outline, single precision decides what a ray hits


def ground_truth(progress: ShareDone) -> Evidence:
    """Depth is z from the lens, and depth, normals, labels and blur are exact at every pixel, outlines included.

    Rationale: all scores depend on the truth, and its usual errors (range instead of z, a flipped axis, an offset of
    half a pixel, blur for another focus) give pictures that look right.

    Set-up: a ball in front of a wall that is rotated by 35 degrees about the vertical; da-mobile with pixels of 12 um,
    256 x 192 px, whose corner is 27 degrees off the axis, focused at 60 cm. No light transport is involved.

    Expectation: rays from a pinhole at the lens through the pixel centres, intersected with plane and sphere in closed
    form. Signed blur c = A s' (1/z - 1/z_f) / p and level (1 - alpha) c follow from the data sheet, with s' of the thin
    lens.

    Limit: at the worst pixel 1e-4 of the depth, 1e-3 for normals, 0.01 px for blur and 0.01 for levels; labels of all
    pixels.

    Source: central projection; the thin lens; sec. 5.1 (levels).
    """
    rendering.activate()
    whole = dasim.refocused(dasim.load_camera("da-mobile"), FOCUS_M)
    sizes = {"width_px": SIZE_PX[0], "height_px": SIZE_PX[1], "pixel_pitch_um": PITCH_UM}
    camera = rendering.changed(whole, sensor=sizes)
    x, y, z, radius = BALL_M
    objects: list[dict[str, Any]] = [
        {"name": "ball", "shape": "sphere", "radius_cm": 100 * radius, "position_cm": (100 * x, 100 * y, 100 * z)},
        {"name": "wall", "shape": "plane", "size_cm": (600, 600), "position_cm": (0, 0, 100 * WALL_M),
         "rotation_deg": (0, TILT_DEG, 0)},
    ]  # fmt: skip
    scene = rendering.make_scene([entry | {"material": "white-paper"} for entry in objects])
    truth = dasim.simulate(scene, camera, 0, spp=1, diffraction="off").truth
    depth, normal, label, sure = _by_hand(camera)
    step = 1 - HOLE_RATIO
    blur = rendering.blur_px(camera, depth)  # type: ignore[arg-type]
    worst = {
        "depth": np.abs(truth.depth_m / depth - 1),
        "normal": np.abs(truth.normal - normal).max(axis=-1),
        "labels": truth.object_id != label,
        "blur": np.abs(truth.blur_px - blur),
        "level": np.abs(truth.level - step * blur),
    }
    units = {"blur": "px", "level": "level"}
    text = {
        "depth": "largest relative error of z",
        "normal": "largest error of a component of the normal",
        "labels": "whether any pixel has another object's label",
        "blur": "largest error of the signed visible blur",
        "level": "largest error of the level",
    }
    figures = [Figure(key, float(worst[key][sure].max()), units.get(key, "1"), text[key]) for key in worst]
    missing = float(np.mean(~truth.valid))
    figures.append(Figure("missing", missing, "1", "share of pixels without truth, of a view that is full"))
    progress(1.0)
    return Evidence(figures)


def _by_hand(camera: Camera) -> tuple[FloatArray, FloatArray, NDArray[np.int64], NDArray[np.bool_]]:
    """Z [h, w] in metres, normals [h, w, 3], labels [h, w] (1: ball, 2: wall), and a mask of pixels
    away from outlines.
    """
    lens, body = camera.lens, camera.sensor
    image_m = 1 / (1e3 / lens.focal_length_mm - 1 / lens.focus_distance_m)
    width, height = body.width_px, body.height_px
    across, down = np.meshgrid(np.arange(width) + 0.5 - width / 2, np.arange(height) + 0.5 - height / 2)
    ray = np.stack([across, down, np.full_like(across, image_m / (body.pixel_pitch_um * 1e-6))], -1) / (
        image_m / (body.pixel_pitch_um * 1e-6)
    )
    facing = np.array([-np.sin(np.radians(TILT_DEG)), 0.0, -np.cos(np.radians(TILT_DEG))])
    wall = WALL_M * facing[2] / (ray @ facing)
    centre, radius = np.array(BALL_M[:3]), BALL_M[3]
    a, b = (ray**2).sum(-1), ray @ centre
    inside = b**2 - a * (centre @ centre - radius**2)
    ball = (b - np.sqrt(np.maximum(inside, 0))) / a
    on_ball = (inside > 0) & (ball < wall)
    distance = np.sqrt(np.maximum(centre @ centre - b**2 / a, 0))  # of the ray from the centre
    sure = np.abs(distance - radius) > RIM * radius
    depth = np.where(on_ball, ball, wall)
    normal = np.where(on_ball[..., None], (ray * ball[..., None] - centre) / radius, facing)
    return depth, normal, np.where(on_ball, 1, 2), sure
