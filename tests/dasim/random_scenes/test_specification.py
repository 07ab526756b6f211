"""Random scenes: what a specification may say, files of one's own, and frames of any size."""

from __future__ import annotations

import re
from pathlib import Path

import cv2
import numpy as np
import pytest
import trimesh

import dasim
from dasim import cli
from dasim.base.errors import InputError
from dasim.camera import geometry
from dasim.random_scenes.scene import by_name
from dasim.random_scenes.specification import RandomScenes
from dasim.scene import checks, shapes
from tests.support import frames
from tests.support.drawn_scenes import SEED, points_m, small_camera, things

ROUNDING_M = 3e-6  # positions and sizes are rounded to 1e-4 cm each, angles to 1e-4 degrees


def test_drawn_scenes_pass_the_checks_of_scenes_that_are_read():
    for scene in (dasim.random_scene(SEED, index) for index in range(3)):
        checks.check(scene, scene.name)
        checks.check_clear(scene, geometry.aperture_m(small_camera()) / 2)


@pytest.fixture
def mesh_folder(tmp_path: Path) -> Path:
    folder = tmp_path / "meshes"
    folder.mkdir()
    cone = trimesh.creation.cone(radius=3.0, height=7.0)
    cone.export(folder / "cone.ply")
    coloured = trimesh.creation.box((20, 10, 5))
    coloured.apply_translation((100, 40, 3))
    coloured.visual.vertex_colors = np.random.default_rng(0).integers(0, 255, (8, 4)).astype(np.uint8)
    coloured.export(folder / "painted.ply")
    return folder


def test_meshes_of_a_folder_are_used_and_stand_in_range(mesh_folder):
    """Both files appear, whatever their unit and origin; one has colours and gets the rule that was asked for."""
    spec = RandomScenes(meshes=(str(mesh_folder),), mesh_share=1.0, mesh_up="z", mesh_near_infrared="dyed")
    names = set()
    for index in range(4):
        scene = dasim.random_scene(SEED, index, spec)
        checks.check(scene, scene.name)
        for item in things(scene):
            if isinstance(item, shapes.Mesh) and "procedural" not in item.file:
                names.add((Path(item.file).name, item.near_infrared))
                depth = points_m(item, scene)[:, 2]
                assert 0.2 - ROUNDING_M <= depth.min() and depth.max() <= 0.8 + ROUNDING_M
    assert names == {("cone.ply", None), ("painted.ply", "dyed")}


def test_files_and_patterns_name_meshes_and_textures(mesh_folder, tmp_path):
    """Expectation: of a folder with two meshes, the one that a pattern or path names is drawn, and only it; the
    pictures of a scene are those of the pattern, in folders below as well, and a scene that is drawn can be loaded.
    """
    (tmp_path / "pictures" / "deep").mkdir(parents=True)
    for name in ("a.png", "deep/b.png", "deep/c.jpg"):
        cv2.imwrite(str(tmp_path / "pictures" / name), np.full((4, 4, 3), 90, np.uint8))
    for meshes, textures, files, images in (
        (["meshes/c*.ply"], ["pictures/**/*.png"], {"meshes/cone.ply"}, {"pictures/a.png", "pictures/deep/b.png"}),
        (["meshes/painted.ply"], ["pictures/a.png"], {"meshes/painted.ply"}, {"pictures/a.png"}),
    ):
        spec = RandomScenes(meshes=meshes, mesh_share=0.3, textures=textures, folder=tmp_path, objects=(30, 30))
        drawn = [dasim.random_scene(SEED, index, spec) for index in range(4)]
        assert {item.file for scene in drawn for item in things(scene) if item.name.startswith("mesh")} == files
        assert set(re.findall(r'"(pictures/[^"]+)"', "".join(scene.model_dump_json() for scene in drawn))) == images
        checks.check(drawn[0], drawn[0].name)


def test_all_broken_files_of_a_folder_are_named_at_once(mesh_folder):
    (mesh_folder / "broken.obj").write_text("v 1 2\nf 1 2 9\n")
    (mesh_folder / "empty.stl").write_bytes(b"")
    with pytest.raises(InputError, match=r"broken\.obj(.|\n)*empty\.stl"):
        dasim.random_scene(0, 0, RandomScenes(meshes=(str(mesh_folder),)))


def test_folders_without_files_and_broken_pictures_are_errors(tmp_path):
    for places, message in (
        ([str(tmp_path / "none")], "no such file or folder"),
        ([str(tmp_path)], "holds none of"),
        ([f"{tmp_path}/*.ply"], "holds none of"),
    ):
        with pytest.raises(InputError, match=f"meshes .*{message}"):
            dasim.random_scene(0, 0, RandomScenes(meshes=places))
    (tmp_path / "bad.png").write_bytes(b"no picture")
    with pytest.raises(InputError, match=r"bad\.png"):
        dasim.random_scene(0, 0, RandomScenes(textures=(str(tmp_path),)))


def test_a_specification_is_read_from_toml(tmp_path, mesh_folder):
    """Folders are looked up beside the file, and the scene says where they are as the file did."""
    path = tmp_path / "set.toml"
    path.write_text('depth_cm = [5, 40]\nobjects = [5, 6]\nmeshes = ["meshes"]\nmesh_share = 1\n[gains]\n"2" = 1\n')
    scene, exposure = by_name(f"random:{path}:3:4")
    assert exposure.gain == 2.0 and scene.focus_cm == 40.0 and len(things(scene)) in (5, 6)
    files = {item.file for item in things(scene) if isinstance(item, shapes.Mesh)}
    assert files <= {"meshes/cone.ply", "meshes/painted.ply"} and files
    checks.check(scene, scene.name)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("depth_cm = [40, 50]", "1.5 times its nearer end"),
        ("objects = [40, 5]", "the smaller number comes first"),
        ("[illuminants]\nD66 = 1", "illuminant 'D66' is unknown"),
        ("colour = 1", "colour: unknown key"),
        ("objects = [0, 5]", "objects.0: must be greater than or equal to 3"),
    ],
)
def test_bad_specifications_are_named(tmp_path, text, message):
    path = tmp_path / "bad.toml"
    path.write_text(text)
    with pytest.raises(InputError, match=message):
        dasim.load_random_scenes(path)


def test_bad_names_and_numbers_are_named():
    for name in ("random:1", "random:a:2", "random:1:-2", "random:"):
        with pytest.raises(InputError, match="random:SEED:INDEX"):
            by_name(name)
    with pytest.raises(InputError, match="seed is -1"):
        dasim.random_scene(-1, 0)


def test_the_command_line_names_what_is_wrong(tmp_path, capsys):
    assert cli.run(["render", "random:7", "--out", str(tmp_path / "a")]) == 2
    assert "random:SEED:INDEX" in capsys.readouterr().err
    assert cli.run(["render", "random:none.toml:0:1", "--out", str(tmp_path / "a")]) == 2
    assert "'none.toml': no such file" in capsys.readouterr().err


@pytest.mark.parametrize("count", [2, pytest.param(60, marks=pytest.mark.slow)])
@pytest.mark.parametrize("camera", frames.CAMERAS)
@pytest.mark.parametrize("size", frames.SIZES)
def test_frames_of_any_size_have_valid_scenes(size, camera, count):
    """A share of ``python -m tests.support.frames``, which draws 1,000 seeds for each size and camera."""
    assert list(frames.problems(camera, size, range(count))) == []
