"""Poses of cameras relative to one another, and a scene seen from another pose.

A pose is a rigid transform [4, 4] of a camera's axes (x right, y down, z forward, as in OpenCV) into those of another
camera or into scene coordinates, in metres. Its inverse is OpenCV's extrinsic matrix.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from pydantic import Field, model_validator

from dasim.base.toml import Specification, parse
from dasim.scene.shapes import Angle, Vector, rotation
from dasim.scene.specification import Scene, View, axes, world_to_camera
from dasim.typing import FloatArray


class Pose(Specification):
    """Pose of a camera in the axes of a reference camera: x right, y down, z forward, centimetres and degrees."""

    position_cm: Vector = Field(default=(0.0, 0.0, 0.0), description="position of the lens")
    rotation_deg: tuple[Angle, Angle, Angle] = Field(
        default=(0.0, 0.0, 0.0), description="degrees about x, then y, then z"
    )
    look_at_cm: Vector | None = Field(
        default=None,
        description="instead of rotation_deg: a point on the optical axis, without roll",
    )

    @model_validator(mode="after")
    def _one_direction(self) -> Pose:
        if self.look_at_cm is None:
            return self
        if any(self.rotation_deg):
            raise ValueError("give one of rotation_deg and look_at_cm")
        View(position_cm=self.position_cm, look_at_cm=self.look_at_cm)  # refuses points that give no direction
        return self

    def matrix(self) -> FloatArray:
        """Rigid transform [4, 4] of the camera's axes into those of the reference camera, metres."""
        result = np.eye(4)
        result[:3, 3] = np.multiply(self.position_cm, 1e-2)
        result[:3, :3] = (
            rotation(self.rotation_deg)
            if self.look_at_cm is None
            else axes(View(position_cm=self.position_cm, look_at_cm=self.look_at_cm)).T
        )
        return result


def between(poses: Sequence[FloatArray], steps: int) -> list[FloatArray]:
    """Poses at ``steps`` equal time steps along a path through ``poses`` [4, 4]; all segments take the same time.

    Between two poses, positions are interpolated linearly and orientations by slerp, a rotation about one axis at a
    constant rate (Shoemake 1985).
    """
    from scipy.spatial.transform import Rotation, Slerp

    times = np.linspace(0, len(poses) - 1, steps)
    turns = Slerp(np.arange(len(poses)), Rotation.from_matrix([pose[:3, :3] for pose in poses]))(times).as_matrix()
    places = np.stack([pose[:3, 3] for pose in poses])
    result = np.tile(np.eye(4), (steps, 1, 1))
    result[:, :3, :3] = turns
    result[:, :3, 3] = np.stack([np.interp(times, np.arange(len(poses)), place) for place in places.T], axis=-1)
    return list(result)


def seen_from(scene: Scene, pose: FloatArray) -> Scene:
    """The scene seen from ``pose`` [4, 4], which is relative to its own view; the scene itself for no motion.

    Raises InputError for a camera that looks straight up or down.
    """
    if np.array_equal(pose, np.eye(4)):
        return scene
    to_scene = np.linalg.inv(world_to_camera(scene)) @ pose
    position_cm = 100 * to_scene[:3, 3]
    data = {"position_cm": position_cm.tolist(), "look_at_cm": (position_cm + 100 * to_scene[:3, 2]).tolist()}
    level = axes(parse(View, data, f"scene {scene.name}, pose"))
    roll_deg = float(np.degrees(np.arctan2(level[1] @ to_scene[:3, 0], level[0] @ to_scene[:3, 0])))
    return scene.model_copy(update={"view": parse(View, data | {"roll_deg": roll_deg}, f"scene {scene.name}, pose")})
