"""Classes of objects: the same number means the same in every scene, in labels, meta.json and files."""

from __future__ import annotations

import json

import numpy as np
import OpenEXR
import pytest

import dasim
from dasim.base.errors import InputError
from dasim.base.toml import parse
from dasim.files.truth import NAMES, read_truth_parts
from dasim.random_scenes.specification import RandomScenes
from dasim.scene import object_materials
from dasim.scene.classes import CLASSES

PRINT = {"kind": "print", "image": "skimage:coffee"}
FRONT = {"position_cm": [0, 0, 30], "material": "brick"}


@pytest.mark.parametrize(
    ("item", "expected"),
    [
        ({"shape": "plane", "size_cm": [4, 4]}, "sheet"),
        ({"shape": "plane", "size_cm": [4, 4], "material": "poster"}, "print"),
        ({"shape": "plane", "size_cm": [4, 4], "material": "glossy"}, "print"),
        ({"shape": "plane", "size_cm": [4, 4], "material": "poster", "class": "wall"}, "wall"),
        ({"shape": "disc", "radius_cm": 2}, "sheet"),
        ({"shape": "box", "size_cm": [2, 2, 2], "material": "poster"}, "box"),
        ({"shape": "sphere", "radius_cm": 2}, "sphere"),
        ({"shape": "cylinder", "radius_cm": 2, "height_cm": 2}, "cylinder"),
        ({"shape": "heightfield", "image": "skimage:camera", "size_cm": [4, 4], "height_cm": 1}, "relief"),
        ({"shape": "mesh", "file": "procedural:leaf:3"}, "plant"),
        ({"shape": "mesh", "file": "procedural:figure-hair"}, "figure"),
        ({"shape": "mesh", "file": "procedural:vase"}, "vessel"),
        ({"shape": "mesh", "file": "procedural:chain-link"}, "fence"),
        ({"shape": "mesh", "file": "procedural:rock:1"}, "solid"),
        ({"shape": "mesh", "file": "own.obj"}, "solid"),
        ({"shape": "mesh", "file": "own.obj", "class": "furniture"}, "furniture"),
    ],
)
def test_class_is_that_of_the_key_else_of_the_shape(make_scene, item, expected):
    materials = {"poster": PRINT, "glossy": {"kind": "coated", "base": PRINT}}
    scene = make_scene({"name": "thing", **FRONT, **item}, materials=materials)
    assert object_materials.class_names_of(scene) == [expected]


def test_unknown_class_is_refused_in_one_line_that_lists_all(make_scene):
    with pytest.raises(InputError) as caught:
        make_scene({"name": "thing", "shape": "sphere", "radius_cm": 2, "class": "dragon", **FRONT})
    message = str(caught.value)
    assert "\n" not in message and "class" in message and all(name in message for name in CLASSES)


def test_names_in_bundled_scenes_agree_with_their_classes():
    """Expectation: what a scene names wall, floor or table has that class or is furniture, and prints are prints."""
    found: dict[str, set[str]] = {}
    for name in dasim.scene_names():
        scene = dasim.load_scene(name)
        for item, kind in zip(scene.objects, object_materials.class_names_of(scene), strict=True):
            found.setdefault(item.name, set()).add(kind)
    assert found["wall"] == {"wall"} and found["table"] == {"furniture"} and found["poster"] == {"print"}
    assert {kind for name, kinds in found.items() for kind in kinds if name.endswith(("-stem", "poppy"))} == {"plant"}


def test_random_scenes_have_the_class_that_their_objects_are_drawn_as():
    expected = {"floor": "floor", "wall": "wall", "poster": "print", "card": "print", "box": "box", "sphere": "sphere"}
    for index in range(12):
        scene = dasim.random_scene(5, index)
        for item, kind in zip(scene.objects, object_materials.class_names_of(scene), strict=True):
            assert kind == expected.get(item.name.split()[0], kind), item.name


def test_a_scene_keeps_its_classes_as_plain_data(make_scene):
    """``meta.json`` and scenes with other light go through plain data."""
    scene = make_scene({"name": "thing", "shape": "sphere", "radius_cm": 2, "class": "figure", **FRONT})
    again = parse(dasim.Scene, scene.model_dump(mode="json"), "again")
    assert again == scene and again.objects[0].class_name == "figure"


@pytest.fixture(scope="module")
def shot(renderer, wide):
    spec = RandomScenes(objects=(6, 6), surfaces=2, textured_share=0.0, background_textured_share=0.0)
    scene = dasim.random_scene(3, 4, spec, wide())
    return dasim.simulate(scene, dasim.focused(wide(), scene), spp=1, diffraction="off")


def test_labels_are_the_classes_of_the_objects_that_are_seen(shot):
    """Expectation: where an object is seen, the map has the class that ``meta.json`` states for it."""
    table = {entry["object_id"]: entry for entry in shot.capture.provenance["objects"]}
    assert [entry["name"] for entry in table.values()] == list(shot.truth.objects)
    seen = np.unique(shot.truth.object_id)
    assert len(seen) >= 4
    for number in seen[seen > 0]:
        (kind,) = np.unique(shot.truth.class_id[shot.truth.object_id == number])
        assert CLASSES[kind - 1] == table[int(number)]["class"]
    assert (shot.truth.class_id[shot.truth.object_id == 0] == 0).all()


def test_other_readers_find_numbers_and_names_in_the_file(shot, tmp_path):
    """OpenEXR reads the map from ``labels``, and the header names its numbers."""
    dasim.save_capture(tmp_path / "capture", shot.capture, shot.truth)
    with OpenEXR.File(str(tmp_path / "capture" / "truth.exr"), separate_channels=True) as file:
        labels = next(part for part in file.parts if part.name() == "labels")
        names = json.loads(file.parts[0].header[NAMES])["classes"]
        seen = {names[number - 1] for number in np.unique(labels.channels["class_id"].pixels) if number}
    assert {"floor", "wall"} <= seen
    np.testing.assert_array_equal(read_truth_parts(tmp_path / "capture" / "truth.exr")["class_id"], shot.truth.class_id)
    meta = json.loads((tmp_path / "capture" / "meta.json").read_text())
    assert meta["provenance"]["objects"][0] == {"object_id": 1, "name": "floor", "class": "floor"}
