"""Specifications of datasets: what is refused, and in which words."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from dasim.base.errors import InputError
from dasim.base.toml import parse
from dasim.dataset.specification import DatasetSpec, bundled_names, load_spec
from dasim.files.truth import TRUTH_PARTS

CAMERA = '[[cameras]]\nname = "da-mobile"\n[cameras.vary]\n'


@pytest.mark.parametrize(
    ("text", "parts"),
    [
        ("colour = 3", ["colour: unknown key"]),
        ("samples = 0", ["samples", "greater than or equal to 1"]),
        ("spp = 0", ["spp is 0", "auto"]),
        ("noise_at = 100", ["noise_at", "99.9"]),
        ("size_px = [32]", ["size_px"]),
        ("truth = {keep = ['z']}", ["'z' is unknown", *TRUTH_PARTS]),
        ("truth = {margin_px = 192}", ["margin_px is 192", "nothing"]),
        ("focus = {distance_m = {uniform = [2, 1]}}", ["focus.distance_m", "smaller number comes first"]),
        ("focus = {distance_m = {log_uniform = [0, 1]}}", ["above 0"]),
        ("focus = {distance_m = {uniform = [1, 2], choice = [1]}}", ["give one of"]),
        ("focus = {distance_m = {choice = []}}", ["focus.distance_m.choice"]),
        ("focus = {distance_m = 0.002}", ["focus_distance_m is 0.002 m, must be at least"]),
        ("focus = {distance_m = 'near'}", ["focus.distance_m is 'near'"]),
        ("exposure = {time_s = {uniform = [0.01, 1e9]}}", ["exposure.time_s is 1000000000.0", "1e-09"]),
        ("exposure = {gain = nan}", ["exposure.gain"]),
        ("frames = {bracket = []}", ["frames.bracket"]),
        ("frames = {bracket = [1, -2]}", ["frames", "bracket.1: must be greater than or equal to 0.000001"]),
        ("frames = {burst = 0}", ["frames.burst", "greater than or equal to 1"]),
        ("frames = {bracket = [1, 4], burst = 501}", ["frames", "1002 frames per sample; at most 1000 are allowed"]),
        ("light = {illuminant = {choice = ['D65', 'D56']}}", ["light.illuminant", "D56", "D55"]),
        ("light = {scale = -1}", ["light.scale is -1"]),
        ("splits = {train = 0.5, test = 0.4}", ["splits sum to 0.9"]),
        ("splits = {train = 1.5, test = -0.5}", ["splits.test: must be greater than 0"]),
        ("splits = {'a/b' = 1.0}", ["'a/b'"]),
        ("samples = 1\nsplits = {train = 0.5, test = 0.5}", ["2 splits need 2 scenes at least, there are 1"]),
        ("scenes = {family = 'meshes', folder = 'nowhere'}", ["nowhere"]),
        ("scenes = {family = 'files', files = ['a.toml', 'b.toml']}", ["a.toml: no such file", "b.toml: no such file"]),
        ("scenes = {family = 'files', files = ['a', 'a']}", ["'a' is twice"]),
        ("scenes = {family = 'files'}", ["files is missing"]),
        ("scenes = {family = 'bundled', names = ['dessk']}", ["'dessk' is unknown", "desk"]),
        (
            "scenes = {kinds = {a = {}}, random = {room_share = 1}}",
            ["kinds is for family = 'random'", "leave that out"],
        ),
        ("scenes = {family = 'meshes', folder = '.', kinds = {a = {}}}", ["kinds is for family = 'random'"]),
        ("scenes = {kinds = {'a b' = {}}}", ["kinds: 'a b' is not a name"]),
        ("scenes = {kinds = {a = {room_share = 2}}}", ["scenes.kinds.a.room_share"]),
        ("scenes = {family = 'bundled', captures_per_scene = 4}", ["captures_per_scene", "number of samples decides"]),
        ("scenes = {family = 'bundled', random = {room_share = 1}}", ["random is for family = 'random' or 'meshes'"]),
        ("scenes = {family = 'meshes', folder = '.', random = {meshes = ['a']}}", ["takes all of its folder"]),
        ("exposure = {time_s = 0.01, auto_level = 0.5}", ["time_s and auto_level", "leave one out"]),
        ("spp = 16\nnoise_share = 0.5", ["noise_share and noise_at are for spp = 'auto'"]),
        (
            "sensor_per_sample = true\ncameras = [{name = 'bando', vary = {'sensor.sensor_seed' = 2}}]",
            ["sensor_per_sample and sensor.sensor_seed", "leave one out"],
        ),
        ("first = 7", ["first is 7: the dataset has 4 samples"]),
        ("noise = 'own.py:model'", ["noise: noise model", "own.py cannot be read"]),
        ("noise = 'own'", ["must be package.module:function or file.py:function"]),
        ("scenes = {files = ['a.toml']}", ["files is for family = 'files'"]),
        ("cameras = [{name = 'da-mobil'}]", ["cameras.0", "da-mobil", "da-mobile"]),
        ("size_px = [100000, 384]", ["size_px.0", "100000"]),
        (
            "focus = {distance_m = {each = [0.2, 0.4, 0.8]}}",
            ["each", "grid of 3 captures", "a scene has 1 of 4 captures"],
        ),
        ("focus = {distance_m = {each = [1, 2]}}\ncameras = [{name = 'bando'}, {name = 'da-8mm'}]", ["one camera"]),
        ("views = {poses = [{}, {position_cm = [1, 0, 0]}], steps = 3}", ["samples is 4", "3 views"]),
        ("views = {steps = 3}", ["views", "two poses or more"]),
        ("views = {rig = [{name = 'a'}, {name = 'a'}]}", ["views", "names of cameras must be unique"]),
        ("views = {rig = [{name = 'a', camera = 'bajer'}]}", ["views.rig.0", "'bajer'", "bayer-mobile"]),
        (
            "views = {poses = [{rotation_deg = [0, 9, 0], look_at_cm = [0, 0, 9]}]}",
            ["one of rotation_deg and look_at_cm"],
        ),
        ("views = {poses = [{look_at_cm = [0, 9, 0]}]}", ["views.poses.0", "straight above or below"]),
        ("raw_scale = 'half'", ["raw_scale", "'dn' or 'full'"]),
        (CAMERA + "'lens.f_numbr' = 2", ["'lens.f_numbr' does not exist", "f_number"]),
        (CAMERA + "'sensor.adc_bits' = {uniform = [10, 12]}", ["sensor.adc_bits = 10.6", "integer"]),
        (CAMERA + "'lens.f_number' = {uniform = [-1, 2]}", ["lens.f_number = -1"]),
        (CAMERA + "'lens.focus_distance_m' = 1", ["set by [focus] distance_m"]),
        (CAMERA + "'sensor.width_px' = 64", ["set by size_px"]),
    ],
)
def test_impossible_specification_is_refused(text, parts, tmp_path):
    """Expectation: one line with the key and what is allowed."""
    data = 'name = "test"\n' + ("" if "samples =" in text else "samples = 4\n") + text
    (tmp_path / "spec.toml").write_text(data)
    with pytest.raises(InputError) as refused:
        load_spec(tmp_path / "spec.toml")
    message = str(refused.value)
    assert "\n" not in message and "spec.toml" in message
    for words in parts:
        assert words in message


def test_all_problems_are_reported_at_once(tmp_path):
    (tmp_path / "spec.toml").write_text(
        'name = "test"\nsamples = 4\nlight = {illuminant = "D56"}\nfocus = {distance_m = 1e9}\n'
        'scenes = {family = "files", files = ["a.toml"]}\nsplits = {a = 0.5, b = 0.5}\n'
        + CAMERA
        + "'lens.f_numbr' = 2\n'sensor.read_noise' = 1\n"
    )
    with pytest.raises(InputError) as refused:
        load_spec(tmp_path / "spec.toml")
    for words in ("D56", "focus.distance_m", "a.toml", "splits", "f_numbr", "read_noise_e"):
        assert words in str(refused.value)
    (tmp_path / "spec.toml").write_text("samples = 0\ncolour = 1\n[focus]\ndistance_m = {uniform = [2, 1]}\n")
    with pytest.raises(InputError) as refused:
        load_spec(tmp_path / "spec.toml")
    for words in ("name: is missing", "samples", "colour", "focus.distance_m"):
        assert words in str(refused.value)


@pytest.mark.parametrize("content", [None, "samples =", "\xff"])
def test_unreadable_specification_is_refused(content, tmp_path):
    path = tmp_path / "spec.toml"
    if content is not None:
        path.write_bytes(content.encode("latin-1"))
    with pytest.raises(InputError, match="neither a bundled name" if content is None else "valid TOML|cannot be read"):
        load_spec(path)


@pytest.mark.parametrize("name", bundled_names())
def test_the_specification_of_a_manifest_is_read_back(name):
    """Rationale: a manifest states all keys, also those that a file has to leave out. Expectation: the same values."""
    spec = load_spec(name)
    assert parse(DatasetSpec, json.loads(spec.model_dump_json()), name) == spec.model_copy(update={"folder": Path(".")})


def test_bundled_specifications_have_names():
    assert bundled_names() == ["dasim-bench"] and load_spec("dasim-bench").name == "dasim-bench"
    with pytest.raises(InputError, match=r"neither a bundled name \(dasim-bench\) nor a file"):
        load_spec("dasim-bensch")
