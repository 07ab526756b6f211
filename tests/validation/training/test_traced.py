"""Scenes of the path-traced captures of the training: what they show is shown nowhere else."""

from __future__ import annotations

import json
import re
from unittest import mock

import numpy as np
import pytest

import dasim
from dasim.random_scenes.materials import PATTERN_SEEDS
from dasim.scene.specification import object_to_camera
from validation.subjects import held_out
from validation.training import traced


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    """Four pictures in place of all."""
    with mock.patch.object(traced, "PICTURES", 4):
        return traced._pictures(tmp_path_factory.mktemp("pictures"))


def images(scene):
    """Names of textures and photographs, as the scene's file would have them."""
    return set(re.findall(r'"((?:pattern|skimage):[^"]+|[^"]+\.png)"', json.dumps(scene.model_dump(mode="json"))))


@pytest.mark.slow
def test_pictures_and_seeds_of_textures_are_those_of_no_other_scene(files):
    """Set-up: ten scenes; for comparison, the captures that depth is judged on."""
    shown = {name for number in range(10) for name in images(traced._scene(number, files)[0])}
    judged = {name for recipe in held_out.recipes("test") for name in images(recipe.scene)}
    seeded = re.compile(rf"pattern:({'|'.join(traced.SEEDED)}):(\d+)")
    assert any(name.endswith(".png") for name in shown) and any(seeded.match(name) for name in shown)
    assert any(seeded.match(name) for name in judged) and any(name.startswith("skimage:") for name in judged)
    assert not any(name.startswith("skimage:") for name in shown)
    numbers = [int(found.group(2)) for name in shown if (found := seeded.match(name))]
    assert min(numbers) >= traced.FIRST_TEXTURE > PATTERN_SEEDS
    assert not {name for name in shown & judged if seeded.match(name)}


def test_a_number_gives_the_same_scene_and_another_number_another(files):
    assert traced._scene(3, files) == traced._scene(3, files)
    assert traced._scene(3, files)[0] != traced._scene(4, files)[0]


def test_dim_captures_show_the_same_scene_with_less_light(files, tmp_path, monkeypatch):
    """Set-up: a board in place of the random scene, rendered once for both families."""
    camera = dasim.cropped(dasim.load_camera("da-mobile"), 32, 32)
    board = dasim.depth_steps(20, 5)
    shots = []
    monkeypatch.setattr(traced, "_pictures", lambda folder: files)

    def rendered(number, _files):
        shots.append(number)
        return dasim.simulate(board, camera, number, spp=4)

    monkeypatch.setattr(traced, "_rendered", rendered)
    (bright, truth), (dim, of_dim) = (traced.kept(family, 7, tmp_path) for family in ("traced", "dim"))
    assert shots == [7]
    assert dim.exposure_s == bright.exposure_s
    factor = of_dim.mean_e.mean() / truth.mean_e.mean()
    assert traced.DIM[0] <= factor <= traced.DIM[1]
    assert dim.raw_dn.mean() < bright.raw_dn.mean()


def test_rods_cross_the_frame_at_one_depth_whatever_the_view():
    """Set-up: a camera that looks down; rods in its own axes."""
    camera, random = dasim.load_camera("da-mobile"), np.random.default_rng(5)
    scene = dasim.depth_steps(20, 5)
    scene = scene.model_copy(update={"view": scene.view.model_copy(update={"look_at_cm": (10.0, 40.0, 80.0)})})
    with_rods = traced._with_rods(scene, camera, (30.0, 60.0), random)
    rods = with_rods.objects[len(scene.objects) :]
    poses = [object_to_camera(rod, with_rods) for rod in rods]
    assert len(rods) >= 1
    depth = poses[0][2, 3]
    assert 0.3 <= depth <= 0.6
    for rod, pose in zip(rods, poses, strict=True):
        assert pose[2, 3] == pytest.approx(depth, rel=1e-6)
        assert pose[2, 0] == pytest.approx(0, abs=1e-6)  # the long side stays at that depth
        px = depth * 100 * camera.sensor.pixel_pitch_um / camera.lens.focal_length_mm * 1e-3
        assert traced.ROD_PX[0] <= rod.size_cm[1] / px <= traced.ROD_PX[1]
        assert rod.size_cm[0] / px > np.hypot(*traced.SIZE_PX)
