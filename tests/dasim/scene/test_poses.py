"""Poses of cameras: turns by right-handed angles, points looked at, roll, and paths between poses."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from dasim.base.errors import InputError
from dasim.render import translate, truth
from dasim.scene.poses import Pose, between, seen_from
from dasim.scene.specification import world_to_camera

RIGID = 1e-12  # double precision
BALL = {"name": "ball", "shape": "sphere", "radius_cm": 1, "position_cm": [4, 0, 30], "material": "brick"}
VIEW = {"position_cm": [3, -8, -5], "look_at_cm": [0, 2, 40]}


def rotation_of(matrix: np.ndarray) -> np.ndarray:
    return matrix[:3, :3]


@pytest.mark.parametrize("rotation_deg", [(0, 0, 0), (10, 0, 0), (0, -25, 0), (0, 0, 90), (12, 35, -50)])
def test_a_scene_from_a_pose_has_its_transform(make_scene, rotation_deg):
    """Expectation: the new extrinsic matrix is the old one followed by the inverse of the pose, roll included."""
    scene = make_scene(BALL, view=VIEW)
    pose = Pose(position_cm=(2, -1, 4), rotation_deg=rotation_deg)
    expected = np.linalg.inv(pose.matrix()) @ world_to_camera(scene)
    np.testing.assert_allclose(world_to_camera(seen_from(scene, pose.matrix())), expected, atol=RIGID)
    turned = Rotation.from_euler("xyz", rotation_deg, degrees=True).as_matrix()  # about fixed axes
    np.testing.assert_allclose(rotation_of(pose.matrix()), turned, atol=RIGID)


def test_no_motion_leaves_the_scene(make_scene):
    scene = make_scene(BALL, view=VIEW)
    assert seen_from(scene, Pose().matrix()) is scene


def test_a_pose_that_looks_at_a_point_has_it_on_its_axis():
    pose = Pose(position_cm=(5, 2, 0), look_at_cm=(-1, 3, 40))
    point = np.linalg.inv(pose.matrix()) @ [-0.01, 0.03, 0.40, 1.0]
    np.testing.assert_allclose(point[:2], 0, atol=RIGID)
    assert point[2] == pytest.approx(np.linalg.norm([-0.06, 0.01, 0.40]))
    assert rotation_of(pose.matrix())[1, 0] == pytest.approx(0)  # the picture's x axis is level


@pytest.mark.parametrize(("roll_deg", "place"), [(0, (1, 0)), (90, (0, -1)), (180, (-1, 0)), (-90, (0, 1))])
def test_a_camera_that_rolls_clockwise_sees_the_world_turn_the_other_way(renderer, make_scene, wide, roll_deg, place):
    """Set-up: a ball to the right of the axis. Expectation: by a quarter turn towards its y axis (clockwise as the
    photographer sees it), the ball moves to the top of the picture.
    """
    scene, camera = make_scene(BALL, view={"roll_deg": roll_deg}), wide(48, 48)
    seen = truth.geometry(translate.world(scene, camera).scene, camera).object_id > 0
    y, x = (np.nonzero(seen)[axis].mean() - 23.5 for axis in (0, 1))
    assert seen.any() and np.hypot(x, y) > 5
    np.testing.assert_allclose(np.array([x, y]) / np.hypot(x, y), place, atol=0.05)


def test_a_path_runs_evenly_through_its_poses():
    """Expectation: ends and the pose in the middle are met; steps of each stretch are equally long in position and
    angle.
    """
    way = [Pose(position_cm=p, rotation_deg=r).matrix() for p, r in (
        ((0, 0, 0), (0, 0, 0)), ((10, 0, 0), (0, -30, 0)), ((10, 4, 2), (20, -30, 5)),
    )]  # fmt: skip
    path = between(way, 9)
    for number, pose in ((0, way[0]), (4, way[1]), (8, way[2])):
        np.testing.assert_allclose(path[number], pose, atol=RIGID)
    for stretch in (path[:5], path[4:]):
        steps = [np.linalg.inv(a) @ b for a, b in itertools.pairwise(stretch)]
        angles = [Rotation.from_matrix(rotation_of(step)).magnitude() for step in steps]
        lengths = [np.linalg.norm(b[:3, 3] - a[:3, 3]) for a, b in itertools.pairwise(stretch)]
        assert np.ptp(angles) < 1e-9 and np.ptp(lengths) < RIGID and min(angles) > 0.05


def test_a_camera_straight_down_is_refused_in_one_line(make_scene):
    pose = Pose(rotation_deg=(-90, 0, 0)).matrix()
    with pytest.raises(InputError, match=r"scene test, pose: .*straight above or below"):
        seen_from(make_scene(BALL), pose)
