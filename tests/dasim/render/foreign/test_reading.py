"""Mitsuba scenes whose files lie in several folders and that have parameters, as those of Mitsuba's documentation."""

from __future__ import annotations

import json
import os
from pathlib import Path

import cv2
import numpy as np
import pytest
import trimesh

import dasim
from dasim.base.errors import InputError
from dasim.cli import run
from dasim.dataset.draws import draft
from dasim.dataset.specification import load_spec
from dasim.files.captures import load_truth

TINY = ("--size", "16x12", "--spp", "2")
SINGLE = 1e-4  # relative: rays and shapes are single precision

# As in Mitsuba's documentation: the scene names its material, a folder of meshes and pictures is common to all scenes,
# and an included stage has the sensor, the light and the shape that the material is for.
SCENE = """<scene version="3.0.0">
  <path value="../../common"/>
  <bsdf type="diffuse" id="object_bsdf">
    <texture type="bitmap" name="reflectance"><string name="filename" value="textures/grey.png"/></texture>
  </bsdf>
  <include filename="include/stage.xml"/>
</scene>"""
STAGE = """<scene version="3.0.0">
  <default name="integrator" value="path"/>
  <default name="spp" value="64"/>
  <integrator type="$integrator"/>
  <sensor type="perspective">
    <transform name="to_world"><lookat origin="0, 0, $distance" target="0, 0, 0" up="0, 1, 0"/></transform>
    <sampler type="independent"><integer name="sample_count" value="$spp"/></sampler>
  </sensor>
  <emitter type="constant"><spectrum name="radiance" filename="spectra/light.spd"/></emitter>
  <shape type="ply" id="card"><string name="filename" value="meshes/card.ply"/><ref id="object_bsdf"/></shape>
</scene>"""


@pytest.fixture
def gallery(tmp_path, monkeypatch):
    """Folder with a scene in docs/scenes, what it includes, and its files in common; the working folder is another."""
    common, scenes = tmp_path / "common", tmp_path / "docs" / "scenes"
    for folder in (common / "meshes", common / "textures", common / "spectra", scenes / "include", tmp_path / "away"):
        folder.mkdir(parents=True)
    trimesh.creation.box((2, 2, 0.2)).export(common / "meshes" / "card.ply")
    cv2.imwrite(str(common / "textures" / "grey.png"), np.full((4, 4, 3), 128, np.uint8))
    (common / "spectra" / "light.spd").write_text("400 1\n830 1\n")
    (scenes / "card.xml").write_text(SCENE)
    (scenes / "include" / "stage.xml").write_text(STAGE)
    monkeypatch.chdir(tmp_path / "away")
    return tmp_path


@pytest.fixture
def refused(capfd):
    """Run a command that must fail with status 2 and one line that has all of ``parts``."""

    def check(*arguments: str, parts: tuple[str, ...]) -> None:
        capfd.readouterr()
        assert run(["render", *arguments, *TINY, "--out", "photo"]) == 2
        *_, line = capfd.readouterr().err.splitlines()
        assert line.startswith("dasim: ")
        for part in parts:
            assert part in line, line

    return check


@pytest.mark.slow
def test_scene_of_several_folders_and_parameters_is_photographed(gallery, renderer):
    """Set-up: the command, in another folder. Expectation: mesh, picture and spectrum are found in the folder of the
    <path> element, the definition moves the camera, and ``meta.json`` records it.
    """
    scene = "../docs/scenes/card.xml"
    assert run(["render", scene, *TINY, "--define", "distance=2.1", "-D", "spp=4", "--out", "photo"]) == 0
    truth = load_truth("photo")
    np.testing.assert_allclose(truth.depth_m, 2.0, rtol=SINGLE)
    assert truth.objects == ("card",)
    described = json.loads(Path("photo/meta.json").read_text())["provenance"]["scene"]
    assert described["define"] == {"distance": "2.1", "spp": "4"}


@pytest.mark.parametrize(
    ("arguments", "parts"),
    [
        ((), ("card.xml", "parameter $distance has no value", "--define distance=VALUE")),
        (("--define", "distance"), ("'distance' is not of the form name=value",)),
        (("--define", "=3"), ("'=3' is not of the form name=value",)),
        (("--define", "distance=2", "-D", "distance=3"), ("--define distance: has two values, '2' and '3'",)),
        (("--define", "distance=2", "--define", "distnace=3"), ("--define distnace", "no such parameter")),
        (("--define", "distance=near"), ("card.xml", "does not load in Mitsuba", "near")),
        (("--define", "filename=x"), ("'filename' cannot be a parameter's name",)),
    ],
)
def test_wrong_parameters_are_one_line(gallery, refused, renderer, arguments, parts):
    refused("../docs/scenes/card.xml", *arguments, parts=parts)


def test_parameters_are_for_mitsuba_scenes_only(refused, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    refused("desk", "--define", "spp=3", parts=("scene 'desk': define is for Mitsuba scenes (.xml) only",))


@pytest.mark.parametrize(
    ("change", "parts"),
    [
        (("../../common", "../../commons"), ("<path>: folder", "commons", "not found")),
        (('<path value="../../common"/>', ""), ("light.spd",)),
        (("include/stage", "include/stag"), ("included file", "stag.xml")),
    ],
)
def test_missing_folders_and_files_are_one_line(gallery, refused, renderer, change, parts):
    file = gallery / "docs" / "scenes" / "card.xml"
    file.write_text(file.read_text().replace(*change))
    refused(str(file), "--define", "distance=2", parts=parts)


@pytest.mark.parametrize("name", ["meshes/card.ply", "textures/grey.png"])
def test_pipes_and_huge_pictures_are_refused_before_mitsuba_opens_them(gallery, refused, renderer, monkeypatch, name):
    """Rationale: Mitsuba's plugins wait for ever on a pipe, and make room for all pixels that a header promises."""
    file, scene = gallery / "common" / name, str(gallery / "docs" / "scenes" / "card.xml")
    if name.endswith("png"):
        monkeypatch.setenv("DASIM_MOST_MPX", "1e-5")
        refused(scene, "--define", "distance=2", parts=(name, "has 4 x 4 pixels"))
    file.unlink()
    os.mkfifo(file)
    refused(scene, "--define", "distance=2", parts=(name, "not a regular file"))


def test_files_are_those_that_mitsuba_finds(tmp_path, wide, renderer):
    """Rationale: files of one name may lie beside the scene and in several folders of <path> elements.

    Set-up: four meshes of different size with one name, in the working folder, beside the scene and in two folders.
    Expectation: with each element left out in turn, the mesh has the size that Mitsuba's own loader gives it.
    """
    import mitsuba as mi

    from dasim.render import translate

    sizes = {"beside": 1.0, "beside/one": 2.0, "two": 3.0, "away": 4.0}
    for folder, size in sizes.items():
        (tmp_path / folder).mkdir(exist_ok=True)
        trimesh.creation.box((size, size, size)).export(tmp_path / folder / "cube.ply")
    file = tmp_path / "beside" / "scene.xml"
    found = []
    before = os.getcwd()
    for paths in ((), ("one",), ("../two",), ("one", "../two"), ("../two", "one"), (str(tmp_path / "two"),)):
        file.write_text(
            '<scene version="3.0.0">'
            + "".join(f'<path value="{path}"/>' for path in paths)
            + '<sensor type="perspective">'
            '<transform name="to_world"><lookat origin="0,0,9" target="0,0,0" up="0,1,0"/></transform></sensor>'
            '<emitter type="constant"/><shape type="ply"><string name="filename" value="cube.ply"/></shape></scene>'
        )
        try:
            os.chdir(tmp_path / "away")
            ours = translate.world(dasim.load_scene(file), wide()).scene.bbox().extents().x
            theirs = mi.load_file(str(file)).bbox().extents().x
        finally:
            os.chdir(before)
        assert ours == pytest.approx(theirs, rel=SINGLE), paths
        found.append(round(float(ours)))
    assert set(found) == {1, 2, 3}
    assert mi.file_resolver().resolve("cube.ply") == mi.filesystem.path("cube.ply"), "folders are forgotten afterwards"


@pytest.mark.parametrize(
    ("define", "expected"),
    [
        ({"distance": 2.5}, {"distance": "2.5"}),
        ({"distance": "2", "near": True}, {"distance": "2", "near": "true"}),
    ],
)
def test_definitions_in_python_may_be_numbers(gallery, define, expected):
    scene = dasim.load_scene(gallery / "docs" / "scenes" / "card.xml", define=define)
    assert isinstance(scene, dasim.MitsubaScene) and scene.define == expected


@pytest.mark.parametrize(
    ("define", "message_part"),
    [
        ({"a b": 1}, "'a b' cannot be a parameter's name"),
        ({"a": None}, "the value of 'a' is None"),
        ("a=1", "define"),
    ],
)
def test_definitions_in_python_are_checked(gallery, define, message_part):
    with pytest.raises(InputError, match=message_part):
        dasim.load_scene(gallery / "docs" / "scenes" / "card.xml", define=define)


def test_datasets_take_the_choices_of_mitsuba_scenes(gallery):
    """Expectation: the scene of a draft has the unit and the definitions of the table; a wrong table is one line."""
    text = """name = "cards"
samples = 1
size_px = [16, 12]
[scenes]
family = "files"
files = ["docs/scenes/card.xml"]
[scenes.mitsuba]
unit_cm = 10
define = { distance = 2.1 }
"""
    file = gallery / "cards.toml"
    file.write_text(text)
    scene = draft(load_spec(file), 0).scene
    assert isinstance(scene, dasim.MitsubaScene) and (scene.unit_cm, scene.define) == (10, {"distance": "2.1"})
    for change, message_part in (
        (("unit_cm = 10", 'illuminant = "D66"'), "scenes.mitsuba.illuminant: illuminant 'D66'"),
        (("distance =", "filename ="), "scenes.mitsuba.define: 'filename' cannot be a parameter's name"),
        (('"files"\nfiles = ["docs/scenes/card.xml"]', '"bundled"'), "files lists none"),
    ):
        file.write_text(text.replace(*change))
        with pytest.raises(InputError, match=message_part):
            load_spec(file)
