"""Views of a capture: rigs and poses as samples, with matrices that hold for the stored depth."""

from __future__ import annotations

import json
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np
import pytest

import dasim
from dasim.base.errors import InputError
from dasim.cli import run
from dasim.dataset.draws import capture_number, draft, scene_number, split_of_scene, values
from dasim.dataset.specification import load_spec
from tests.support.datasets import make_dataset

BASELINE_CM = 2.0
DEPTH_ERROR = 2e-5  # of depths in single precision that were interpolated over a plane
SCENE = """
name = "corner"
focus_cm = 40
[[lights]]
kind = "dome"
illuminant = "D65"
lux = 500
[[objects]]
name = "back"
class = "wall"
shape = "plane"
size_cm = [160, 160]
position_cm = [0, 0, 60]
rotation_deg = [0, 25, 0]
material = "brick"
[[objects]]
name = "floor"
class = "floor"
shape = "plane"
size_cm = [160, 160]
position_cm = [0, 6, 40]
rotation_deg = [-90, 0, 0]
material = "sand"
[[objects]]
name = "front"
shape = "plane"
size_cm = [3, 30]
position_cm = [0.5, 0, 25]
material = "grey-card"
"""
# Large pixels: a wide view in a small frame.
CAMERA = """
name = "corner-views"
samples = {samples}
size_px = [96, 72]
spp = 1
diffraction = "off"
format = "folders"
[scenes]
family = "files"
files = ["corner.toml"]
[[cameras]]
name = "coarse.toml"
{more}
"""
RIG = f"""
[views]
poses = [{{}}, {{position_cm = [-4, -3, 2], look_at_cm = [0, 0, 30]}}]
[[views.rig]]
name = "left"
[[views.rig]]
name = "right"
position_cm = [{BASELINE_CM}, 0, 0]
"""


def spec_file(folder: Path, samples: int, more: str, scene: str = SCENE) -> Path:
    (folder / "corner.toml").write_text(scene)
    source = (Path(dasim.__file__).parent / "cameras" / "da-mobile.toml").read_text()
    pitch = next(line for line in source.splitlines() if line.startswith("pixel_pitch_um"))
    (folder / "coarse.toml").write_text(source.replace(pitch, "pixel_pitch_um = 24.0"))
    (folder / "spec.toml").write_text(CAMERA.format(samples=samples, more=more))
    return folder / "spec.toml"


class Seen(NamedTuple):
    """What a view sees, from the files of a sample alone."""

    depth_m: np.ndarray
    object_id: np.ndarray
    matrix: np.ndarray  # intrinsic [3, 3] for pixel centres at whole numbers, as OpenCV has them
    to_camera: np.ndarray  # extrinsic [4, 4]

    def points(self) -> np.ndarray:
        """Points of the scene [h, w, 3], metres, at the pixel centres."""
        y, x = np.indices(self.depth_m.shape)
        rays = np.stack([x, y, np.ones_like(x)], axis=-1) @ np.linalg.inv(self.matrix).T
        in_camera = rays * self.depth_m[..., None]
        back = np.linalg.inv(self.to_camera)
        return in_camera @ back[:3, :3].T + back[:3, 3]

    def projected(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Pixels [h, w, 2] of points of the scene by OpenCV, and their depth [h, w]."""
        turn, _ = cv2.Rodrigues(self.to_camera[:3, :3])
        flat = points.reshape(-1, 3)
        pixels, _ = cv2.projectPoints(flat, turn, self.to_camera[:3, 3], self.matrix, None)
        depth = flat @ self.to_camera[2, :3] + self.to_camera[2, 3]
        return pixels.reshape(*points.shape[:2], 2), depth.reshape(points.shape[:2])


def seen(sample: dasim.Sample) -> Seen:
    about = sample.meta["sample"]
    matrix = np.array(about["intrinsic_matrix_px"]) - [[0, 0, 0.5], [0, 0, 0.5], [0, 0, 0]]
    return Seen(sample.truth["depth_m"], sample.truth["object_id"], matrix, np.array(about["world_to_camera"]))


@pytest.fixture(scope="module")
def dataset(renderer, tmp_path_factory) -> dasim.Dataset:
    folder = tmp_path_factory.mktemp("views")
    make_dataset(spec_file(folder, 4, RIG), folder / "ds")
    return dasim.open_dataset(folder / "ds")


@pytest.mark.parametrize(("first", "second"), [(0, 1), (0, 2), (1, 3), (2, 0)])
def test_points_of_one_view_lie_at_the_depth_of_another(dataset, first, second):
    """Rationale: matrices are right if and only if the truths of all views describe one scene.

    Set-up: the true points of a view, from its depth and its matrices, are projected into another by OpenCV. On planes
    the inverse depth is linear in the picture, so that bilinear interpolation of it between four pixels of one object
    is exact.

    Expectation: every point lies at the depth that the other view sees there, or behind it (hidden), never before it;
    and most are visible.
    """
    one, other = seen(dataset[first]), seen(dataset[second])
    pixels, depth_m = other.projected(one.points())
    height, width = depth_m.shape
    corner = np.floor(pixels).astype(int)
    inside = ((corner >= 0) & (corner < (width - 1, height - 1))).all(axis=-1)
    x, y = corner[inside].T
    numbers = np.stack([other.object_id[y + dy, x + dx] for dy in (0, 1) for dx in (0, 1)])
    pure = (numbers == one.object_id[inside]).all(axis=0)
    u, v = (pixels[inside] - corner[inside]).T
    q = 1 / other.depth_m.astype(np.float64)
    interpolated = (q[y, x] * (1 - u) + q[y, x + 1] * u) * (1 - v) + (q[y + 1, x] * (1 - u) + q[y + 1, x + 1] * u) * v
    error = depth_m[inside] * interpolated - 1
    assert pure.mean() > 0.7 and inside.mean() > 0.5
    assert np.abs(error[pure]).max() < DEPTH_ERROR
    nearest = np.min([other.depth_m[y + dy, x + dx] for dy in (0, 1) for dx in (0, 1)], axis=0)
    assert (depth_m[inside] / nearest).min() > 1 - DEPTH_ERROR


def test_a_stereo_pair_has_the_disparity_of_its_baseline(dataset):
    """Expectation: both edges of a card at 25 cm are f B / z pixels further left in the right view, to half a pixel at
    either side, with the focal length in pixels, the baseline of the rig and the card's depth.
    """
    left, right = seen(dataset[0]), seen(dataset[1])
    focal_px = dataset[0].meta["intrinsic_matrix_px"][0][0]
    expected = focal_px * BASELINE_CM * 1e-2 / 0.25
    edges = []
    for view in (left, right):
        columns = np.flatnonzero((view.object_id == 3)[20])
        edges.append((columns[0], columns[-1]))
        assert view.depth_m[20, columns] == pytest.approx(0.25, rel=1e-6)
    assert expected > 5
    np.testing.assert_allclose(np.subtract(*edges), expected, atol=1.0)


def test_views_are_named_in_the_index_and_share_their_capture(dataset):
    assert [(row["capture"], row["pose"], row["rig_camera"]) for row in dataset.rows] == [
        (0, 0, "left"), (0, 0, "right"), (0, 1, "left"), (0, 1, "right"),
    ]  # fmt: skip
    for row, sample in zip(dataset.rows, dataset, strict=True):
        assert row["world_to_camera"] == sample.meta["sample"]["world_to_camera"]
        assert row["world_to_camera"] == sample.meta["provenance"]["world_to_camera"]
        assert row["class_share"]["floor"] > 0.05
        flat = dataset.arrays()[row["index"]]
        assert (flat["view"], flat["rig_camera"]) == (row["view"], row["rig_camera"])
        np.testing.assert_array_equal(flat["world_to_camera"], row["world_to_camera"])
    assert len({row["seed"] for row in dataset.rows}) == 4
    seeds = [sample.meta["camera"]["sensor"]["sensor_seed"] for sample in dataset]
    assert seeds[0] == seeds[2] != seeds[1] == seeds[3]  # the two cameras of the rig are two sensors


def test_stacks_of_views_are_folders_of_their_own(renderer, tmp_path):
    """Set-up: a stereo pair at two focus distances. Expectation: a folder per view, with the pictures, the depth, the
    matrix and the pose of that view alone; the poses are a baseline apart.
    """
    focus = '[[views.rig]]\nname = "left"\n[[views.rig]]\nname = "right"\nposition_cm = [2, 0, 0]\n'
    focus += "[focus]\ndistance_m = {each = [0.5, 0.2]}\n"
    spec = spec_file(tmp_path, 4, focus)
    make_dataset(spec, tmp_path / "ds")
    samples = list(dasim.open_dataset(tmp_path / "ds"))
    out = tmp_path / "stacks"
    assert (
        run(["dataset", "export", str(tmp_path / "ds"), "--as", "stack", "--picture", "sharp", "--out", str(out)]) == 0
    )
    folders = sorted(path.parent for path in out.rglob("stack.json"))
    assert len(folders) == 2 and folders[1].name == f"{folders[0].name}-view-1"
    centres = []
    for view, folder in enumerate(folders):
        own = [sample for sample in samples if sample.meta["sample"]["view"] == view]
        about = json.loads((folder / "stack.json").read_text())
        assert [(item["focus_m"], int(item["sample"])) for item in about["pictures"]] == [
            (sample.meta["camera"]["lens"]["focus_distance_m"], sample.index) for sample in own
        ]
        (near,) = (sample for sample in own if sample.meta["camera"]["lens"]["focus_distance_m"] == 0.2)
        np.testing.assert_array_equal(np.load(folder / "depth.npy"), near.truth["depth_m"])
        np.testing.assert_allclose(about["intrinsics"], seen(near).matrix)
        np.testing.assert_allclose(about["world_to_camera"], seen(near).to_camera)
        back = np.linalg.inv(about["world_to_camera"])
        centres.append(back[:3, 3])
        sharp = np.rint(255 * np.clip(near.truth["sharp_srgb"], 0, 1))[..., ::-1]
        (file,) = (item["file"] for item in about["pictures"] if item["focus_m"] == 0.2)
        np.testing.assert_array_equal(cv2.imread(str(folder / file)), sharp)
    np.testing.assert_allclose(centres[1] - centres[0], [BASELINE_CM * 1e-2, 0, 0], atol=1e-9)


def test_a_rig_has_other_cameras_and_shares_what_is_drawn(tmp_path):
    """A dual-aperture camera beside its Bayer twin, at six captures of a trajectory of three poses, focused apart."""
    more = """
[views]
poses = [{}, {position_cm = [6, 0, 0], rotation_deg = [0, -20, 0]}]
steps = 3
[[views.rig]]
name = "dual"
[[views.rig]]
name = "twin"
camera = "bayer-mobile"
position_cm = [1, 0, 0]
[focus]
distance_m = {each = [0.2, 0.5]}
[exposure]
auto_level = {uniform = [0.1, 0.9]}
"""
    spec = load_spec(spec_file(tmp_path, 24, more))
    drafts = [draft(spec, index) for index in range(12)]
    assert [item.camera.name for item in drafts[:2]] == [
        dasim.load_camera(tmp_path / "coarse.toml").name,
        "bayer-mobile",
    ]
    assert {item.camera.lens.focus_distance_m for item in drafts[:6]} == {0.2}
    assert {item.camera.lens.focus_distance_m for item in drafts[6:]} == {0.5}
    assert len({item.exposure.auto_level for item in drafts[:6]}) == 1
    assert drafts[0].exposure.auto_level != drafts[6].exposure.auto_level
    assert len({item.seed for item in drafts}) == 12
    for index, item in enumerate(drafts):
        assert item.drawn["camera"] == ("bayer-mobile" if index % 2 else spec.cameras[0].name)
    x_cm = [item.scene.view.position_cm[0] for item in drafts[:6:2]]
    assert x_cm == pytest.approx([0, 3, 6])
    for twin, dual in zip(drafts[1:6:2], drafts[:6:2], strict=True):
        apart = np.subtract(twin.scene.view.position_cm, dual.scene.view.position_cm)
        assert np.linalg.norm(apart) == pytest.approx(1)


def test_views_of_a_random_scene_are_in_one_split(tmp_path):
    path = spec_file(tmp_path, 24, "[views]\nposes = [{}, {position_cm = [1, 0, 0]}]\n[splits]\na = 0.5\nb = 0.5\n")
    path.write_text(path.read_text().replace('family = "files"\nfiles = ["corner.toml"]', "captures_per_scene = 3"))
    spec = load_spec(path)
    assert [scene_number(spec, index) for index in range(24)] == [index // 6 for index in range(24)]
    assert [capture_number(spec, index) for index in range(6)] == [0, 0, 1, 1, 2, 2]
    assert {split_of_scene(spec, scene_number(spec, index)) for index in range(24)} == {"a", "b"}
    assert values(spec, 0) == values(spec, 1)


def test_one_view_is_as_it_was(tmp_path):
    """Expectation: a specification without ``views`` draws what it drew before there were any: all by its index."""
    spec = load_spec(spec_file(tmp_path, 4, "[exposure]\nauto_level = {uniform = [0.1, 0.9]}"))
    random = np.random.default_rng(np.random.SeedSequence((0, 3, 4, 0)))
    assert draft(spec, 3).exposure.auto_level == random.uniform(0.1, 0.9)
    assert draft(spec, 3).scene.view == dasim.load_scene(tmp_path / "corner.toml").view


def test_a_mitsuba_scene_keeps_its_pose(tmp_path):
    path = spec_file(tmp_path, 4, RIG)
    (tmp_path / "scene.xml").write_text("<scene version='3.0.0'></scene>")
    path.write_text(path.read_text().replace("corner.toml", "scene.xml"))
    with pytest.raises(InputError, match=r"scene\.xml is a Mitsuba scene, whose camera cannot be moved"):
        load_spec(path)
