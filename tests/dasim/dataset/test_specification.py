"""Datasets: allowed specifications, distributions of the samples, and the files on disk."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import tarfile
from collections import Counter
from pathlib import Path

import cv2
import numpy as np
import pytest

import dasim
from dasim.base import executors
from dasim.base.errors import InputError
from dasim.base.toml import parse
from dasim.camera import noise
from dasim.cli import run
from dasim.dataset import draws, plan, storage, verify
from dasim.dataset.specification import DatasetSpec, bundled_names, load_spec
from dasim.files.truth import TRUTH_PARTS
from tests.support.datasets import WALL, backwards, inline, make_dataset, spec_file, sums

HALF_STEP = 2**-11  # relative: half of the last of 11 bits
COUNT = 400
SIGMAS = 5


def spec_of(**changes) -> DatasetSpec:
    return parse(DatasetSpec, {"name": "test", "samples": COUNT, **changes}, "test")


# --- specification -------------------------------------------------------------------------------

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
        ("frames = {bracket = [1, 4], burst = 501}", ["frames", "1002 frames per sample; 1000 are allowed"]),
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
        ("scenes = {kinds = {a = {}}, random = {}}", ["kinds is for family = 'random'", "leave that out"]),
        ("scenes = {family = 'meshes', folder = '.', kinds = {a = {}}}", ["kinds is for family = 'random'"]),
        ("scenes = {kinds = {'a b' = {}}}", ["kinds: 'a b' is not a name"]),
        ("scenes = {kinds = {a = {room_share = 2}}}", ["scenes.kinds.a.room_share"]),
        ("first = 7", ["first is 7: the dataset has 4 samples"]),
        ("noise = 'own.py:model'", ["noise: noise model", "own.py cannot be read"]),
        ("noise = 'own'", ["package.module:function or file.py:function is needed"]),
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


# --- draws ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("count", [3, 10, 101])
@pytest.mark.parametrize("captures", [1, 3])
def test_no_scene_is_in_two_splits(count, captures):
    """Each split gets its share of the scenes, rounded, and at least one scene."""
    shares = {"train": 0.8, "val": 0.19, "test": 0.01}
    spec = spec_of(samples=count * captures, splits=shares, scenes={"captures_per_scene": captures})
    split_of: dict[int, set[str]] = {}
    for index in range(spec.samples):
        number = draws.scene_number(spec, index)
        split_of.setdefault(number, set()).add(draws.split_of_scene(spec, number))
    assert len(split_of) == count and all(len(splits) == 1 for splits in split_of.values())
    scenes = Counter(next(iter(splits)) for splits in split_of.values())
    assert set(scenes) == set(shares)
    for name, share in shares.items():
        assert abs(scenes[name] - share * count) <= 1 + (count < 1 / min(shares.values()))
    indices = [index for group in plan.shards(spec) for index in group.indices]
    assert sorted(indices) == list(range(spec.samples))


def test_distributions_are_what_they_are_called():
    """Limit: five standard deviations, for means and shares of many samples."""
    spec = spec_of(
        focus={"distance_m": {"log_uniform": [0.1, 10]}},
        exposure={"gain": {"uniform": [1, 3]}},
        light={"illuminant": {"choice": ["A", "D65"]}},
        cameras=[{"name": "da-mobile", "weight": 3}, {"name": "da-focus-pair"}],
    )
    samples = [draws.values(spec, index) for index in range(COUNT)]
    decades = np.log10([item["focus.distance_m"] for item in samples])
    gains = np.array([item["exposure.gain"] for item in samples])
    for values, low, high in ((decades, -1.0, 1.0), (gains, 1.0, 3.0)):
        assert low <= values.min() and values.max() <= high
        spread = (high - low) / np.sqrt(12)
        assert abs(values.mean() - (low + high) / 2) < SIGMAS * spread / np.sqrt(COUNT)
        assert abs(values.std() - spread) < SIGMAS * spread * np.sqrt(0.8 / 4 / COUNT)  # kurtosis 1.8
    for key, value, share in (("light.illuminant", "A", 0.5), ("camera", "da-mobile", 0.75)):
        measured_share = np.mean([item[key] == value for item in samples])
        assert abs(measured_share - share) < SIGMAS * np.sqrt(share * (1 - share) / COUNT)


def test_sample_depends_on_its_index_alone():
    """More samples, another shard size, or other distributions of one part leave the other parts unchanged."""
    base = {"focus": {"distance_m": {"uniform": [1, 2]}}, "exposure": {"gain": {"uniform": [1, 2]}}}
    first = spec_of(**base)
    more = spec_of(**base, samples_per_shard=7, light={"scale": {"uniform": [1, 2]}}).model_copy(
        update={"samples": 10 * COUNT}
    )
    for index in (0, 7, COUNT - 1):
        values = draws.values(first, index)
        assert values.items() <= draws.values(more, index).items()
        assert draws.capture_seed(first, index) == draws.capture_seed(more, index)
    assert len({draws.capture_seed(first, index) for index in range(COUNT)}) == COUNT


def test_varied_parameters_reach_camera_light_and_exposure(tmp_path):
    more = "time_s = 0.01\n[light]\nilluminant = 'A'\nscale = 3\n[focus]\ndistance_m = 0.7\n" + CAMERA
    more += "'lens.f_number' = {uniform = [2.2, 2.8]}\n'stops.1.name' = 'other'\n"
    spec = load_spec(spec_file(tmp_path, more=more))
    sample = draws.draft(spec, 3)
    assert sample.camera.lens.f_number == sample.drawn["camera.lens.f_number"] != 2.0
    assert sample.camera.stops[1].name == "other"
    assert sample.camera.lens.focus_distance_m == 0.7
    assert sample.exposure.time_s == 0.01 and sample.exposure.auto_level == sample.drawn["exposure.auto_level"]
    (light,) = sample.scene.lights
    assert (light.illuminant, light.lux) == ("A", 3000)
    assert (sample.camera.sensor.width_px, sample.camera.sensor.height_px) == (32, 24)


# --- on disk -------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def both(renderer, tmp_path_factory) -> dict[str, Path]:
    """One specification in both formats, with splits: three scenes, two captures each."""
    folders = {}
    for form in ("webdataset", "folders"):
        folder = tmp_path_factory.mktemp(form)
        for name in ("second", "third"):
            (folder / f"{name}.toml").write_text(WALL.replace('"wall"\nfocus', f'"{name}"\nfocus'))
        files = ["wall.toml", "second.toml", "third.toml"]
        spec = spec_file(folder, files=files, format=form, top="splits = {train = 0.6, test = 0.4}")
        make_dataset(spec, folder / "ds")
        folders[form] = folder / "ds"
    return folders


def same(one, other) -> bool:
    arrays = all(
        np.array_equal(value, other.truth[name], equal_nan=value.dtype.kind == "f")
        if isinstance(value, np.ndarray)
        else value == other.truth[name]
        for name, value in one.truth.items()
    )
    return one.index == other.index and one.meta == other.meta and np.array_equal(one.raw_dn, other.raw_dn) and arrays


def test_both_formats_hold_the_same(both):
    first, second = (dasim.open_dataset(both[form]) for form in ("webdataset", "folders"))
    assert len(first) == len(second) == 6
    for one, other in zip(first, second, strict=True):
        assert same(one, other)
    assert {row["key"]: row["sha256"] for row in first.rows} == {row["key"]: row["sha256"] for row in second.rows}


def test_an_independent_mean_leaves_the_raw_picture_as_it_is(renderer, tmp_path):
    """Expectation: same raw numbers, another realisation of ``mean_e`` with its variance, all else the same."""
    samples = []
    for own in ("false", "true"):
        folder = tmp_path / own
        folder.mkdir()
        make_dataset(spec_file(folder, samples=1, more=f"[truth]\nindependent_mean = {own}"), folder / "ds")
        samples += dasim.open_dataset(folder / "ds")
    shared, own = samples
    np.testing.assert_array_equal(own.raw_dn, shared.raw_dn)
    different = {
        name
        for name, part in shared.truth.items()
        if isinstance(part, np.ndarray) and not np.array_equal(part, own.truth[name], equal_nan=part.dtype.kind == "f")
    }
    assert different == {"mean_e", "mean_e_variance"}
    assert own.meta["provenance"]["independent_mean"] and not shared.meta["provenance"]["independent_mean"]


@pytest.fixture(scope="module")
def bursts(renderer, tmp_path_factory) -> dict[str, Path]:
    """Samples of a bracket and burst with a mean of their own, in both formats; shards are made in opposite order."""
    folders = {}
    for form, executor in (("webdataset", inline), ("folders", backwards)):
        folder = tmp_path_factory.mktemp(f"bursts-{form}")
        more = "[frames]\nbracket = [0.5, 1, 2]\nburst = 2\n[truth]\nindependent_mean = true"
        make_dataset(spec_file(folder, samples=3, format=form, more=more), folder / "ds", executor)
        folders[form] = folder / "ds"
    return folders


def test_frames_of_a_sample_are_exposures_of_one_rendering(bursts):
    """Expectation: two frames at each time of the bracket, times the automatic one, with seeds of their own; noise
    differs from frame to frame, and is that of the sensor: raw numbers scatter about the same light.
    """
    assert list(verify.problems(str(bursts["folders"]))) == []
    for sample in dasim.open_dataset(bursts["folders"]):
        frames = sample.meta["sample"]["frames"]
        names = ["raw.png", *(f"raw-{number}.png" for number in range(1, 6))]
        assert [frame["file"] for frame in frames] == names and len(sample.frames_dn) == 6
        np.testing.assert_array_equal(sample.frames_dn[0], sample.raw_dn)
        times = np.array([frame["exposure_s"] for frame in frames])
        np.testing.assert_allclose(times / times[2], np.repeat([0.5, 1, 2], 2))
        assert len({frame["seed"] for frame in frames}) == 6 and frames[0]["seed"] == sample.meta["seed"]
        camera = dasim.load_capture(bursts["folders"] / sample.split / f"{sample.index:09d}").camera
        mean = noise.mosaic(sample.truth["mean_e"].astype(float), camera) / times[0]
        step = noise.electrons_per_dn(camera.sensor)
        electrons = [(raw.astype(float) - 64) * step for raw in sample.frames_dn]
        for number, time_s in enumerate(times):
            assert electrons[number].mean() == pytest.approx(mean.mean() * time_s, rel=0.05)
        for first, second in ((0, 1), (2, 3), (4, 5)):
            temporal = noise.temporal_variance(camera.sensor, times[first]).at(mean * times[first]).mean()
            ratio = (electrons[first] - electrons[second]).var() / (2 * temporal)
            assert ratio == pytest.approx(1.0, abs=SIGMAS * np.sqrt(2 / mean.size) + 0.05)
        shares = [max(frame["rendering_noise_share"]["95"].values()) for frame in frames]
        assert shares[0] == shares[1] < shares[2] < shares[4], "a brighter frame shows more of the rendering's noise"


def test_frames_do_not_depend_on_order_or_format(bursts):
    """Expectation: the same bytes of all files, and one row of the index per sample."""
    first, second = (dasim.open_dataset(bursts[form]) for form in ("webdataset", "folders"))
    assert {row["key"]: row["sha256"] for row in first.rows} == {row["key"]: row["sha256"] for row in second.rows}
    assert all(row["frames"] == 6 and len(row["sha256"]) == 8 for row in first.rows)
    assert "`raw-1.png` to `raw-5.png` further frames" in (bursts["folders"] / "README.md").read_text()
    for one, other in zip(first, second, strict=True):
        assert same(one, other) and len(one.frames_dn) == 6
        assert all(map(np.array_equal, one.frames_dn, other.frames_dn))


def test_damaged_frames_are_found(bursts, tmp_path):
    out = tmp_path / "ds"
    shutil.copytree(bursts["folders"], out)
    (folder,) = out.glob("*/000000001")
    content = bytearray((folder / "raw-3.png").read_bytes())
    content[-20] ^= 1
    (folder / "raw-3.png").write_bytes(content)
    messages = problems(out)
    assert any("raw-3.png: its checksum differs" in line for line in messages)
    assert any("raw-3.png does not have the checksum of the index" in line for line in messages)


def test_frames_of_a_folder_are_what_the_command_exposes(renderer, tmp_path):
    """Expectation: `dasim expose` with the time and seed of a frame gives its raw numbers, byte for byte."""
    spec = spec_file(tmp_path, samples=1, format="folders", more="[frames]\nbracket = [1, 8]")
    make_dataset(spec, tmp_path / "ds")
    (sample,) = dasim.open_dataset(tmp_path / "ds")
    frame = sample.meta["sample"]["frames"][1]
    arguments = ["--time", repr(frame["exposure_s"]), "--seed", str(frame["seed"]), "--out", str(tmp_path / "shot")]
    folder = tmp_path / "ds" / sample.split / "000000000"
    assert run(["expose", str(folder), *arguments]) == 0
    assert (tmp_path / "shot" / "raw.png").read_bytes() == (folder / "raw-1.png").read_bytes()


@pytest.mark.parametrize("form", ["webdataset", "folders"])
def test_dataset_is_a_sequence(both, form):
    """Each sample is the one that the index names, whether read by number, from the end, in slices, or in sequence."""
    dataset = dasim.open_dataset(str(both[form]))
    samples = list(dataset)
    assert [sample.index for sample in samples] == list(range(6))
    assert same(dataset[2], samples[2]) and same(dataset[-1], samples[5])
    assert [sample.index for sample in dataset[1:5:2]] == [1, 3]
    with pytest.raises(IndexError):
        dataset[6]
    train, test = (dasim.open_dataset(both[form], split=name) for name in ("train", "test"))
    assert sorted(s.index for part in (train, test) for s in part) == list(range(6))
    scenes = [{sample.meta["sample"]["scene"] for sample in part} for part in (train, test)]
    assert scenes[0].isdisjoint(scenes[1]) and len(scenes[0] | scenes[1]) == 3
    with pytest.raises(InputError, match="no split 'val'; it has train, test"):
        dasim.open_dataset(both[form], split="val")


def test_folders_are_captures(both):
    """Each folder is read by the functions for captures."""
    sample = dasim.open_dataset(both["folders"])[0]
    folder = both["folders"] / sample.split / "000000000"
    capture, truth = dasim.load_capture(folder), dasim.load_truth(folder)
    assert np.array_equal(capture.raw_dn, sample.raw_dn)
    assert np.array_equal(truth.depth_m, sample.truth["depth_m"], equal_nan=True)


def test_shards_are_in_the_webdataset_form(both):
    """The members of a sample follow each other with the names KEY.raw.png and so on; they do not state an owner."""
    for path in sorted(both["webdataset"].glob("*.tar")):
        with tarfile.open(path) as tar:
            infos = tar.getmembers()
        keys = [info.name.partition(".")[0] for info in infos]
        assert [info.name.partition(".")[2] for info in infos[:3]] == ["raw.png", "truth.exr", "meta.json"]
        assert keys == [key for key in dict.fromkeys(keys) for _ in range(3)]
        assert {(info.uid, info.mtime, info.uname, info.mode) for info in infos} == {(0, 0, "", 0o644)}


def test_index_has_a_row_for_each_sample(both):
    import pyarrow.parquet

    table = pyarrow.parquet.read_table(both["webdataset"] / plan.INDEX)
    assert table.num_rows == 6
    for row, sample in zip(table.to_pylist(), dasim.open_dataset(both["webdataset"]), strict=True):
        depth = sample.truth["depth_m"]
        assert row["depth_p50_m"] == pytest.approx(np.nanmedian(depth), rel=1e-5)  # single precision
        assert sum(row["depth_histogram"]) == np.isfinite(depth).sum()
        assert row["exposure_s"] == sample.meta["exposure_s"]
        picture = cv2.imdecode(np.frombuffer(row["thumbnail"], np.uint8), cv2.IMREAD_COLOR)
        assert picture.shape == (72, 96, 3)


def test_card_says_what_is_in_it(both):
    card = (both["webdataset"] / "README.md").read_text()
    for words in ("# tiny 1.0", "Licence: not stated", "6 of 3 scenes", "contact-sheet.jpg", "da-mobile", "D65"):
        assert words in card
    sheet = cv2.imread(str(both["webdataset"] / "contact-sheet.jpg"))
    assert sheet.shape == (72, 6 * 96, 3)
    manifest = json.loads((both["webdataset"] / plan.MANIFEST).read_text())
    assert {"variant", "llvm", "cpu", "libraries"} <= set(manifest)


def test_half_floats_without_a_margin(tmp_path, renderer):
    """Half floats are off by at most half of their last bit, depth and labels are exact, and the truth lacks its
    margin.
    """
    base = spec_file(tmp_path, samples=1)
    make_dataset(base, tmp_path / "whole")
    base.write_text(base.read_text() + "[truth]\nhalf = true\nmargin_px = 4\nkeep = ['depth', 'mean_e', 'labels']\n")
    make_dataset(base, tmp_path / "cut")
    (whole,), (cut,) = dasim.open_dataset(tmp_path / "whole"), dasim.open_dataset(tmp_path / "cut")
    assert np.array_equal(whole.raw_dn, cut.raw_dn)
    inner = (slice(4, -4), slice(4, -4))
    assert {"depth_m", "mean_e", "object_id"} <= set(cut.truth) and "normal" not in cut.truth
    for name in ("depth_m", "object_id", "boundary"):
        assert np.array_equal(whole.truth[name][inner], cut.truth[name], equal_nan=name == "depth_m")
    difference = np.abs(whole.truth["mean_e"][inner] - cut.truth["mean_e"])
    assert 0 < difference.max() and np.all(difference <= HALF_STEP * np.abs(whole.truth["mean_e"][inner]) + 2**-25)
    assert cut.meta["sample"]["truth"]["offset_px"] == [4, 4]
    assert list(verify.problems(str(tmp_path / "cut"))) == []


# --- verify --------------------------------------------------------------------------------------


def problems(out: Path) -> list[str]:
    """The problems that verify reports, one line each."""
    try:
        return list(verify.problems(str(out)))
    except InputError as error:
        return [str(error)]


@pytest.mark.parametrize("form", ["webdataset", "folders"])
def test_verify_finds_one_flipped_bit_in_any_file(both, form, tmp_path):
    """Set-up: one bit flipped in the first or last byte, in the middle, or in the padding of a tar file."""
    out = tmp_path / "ds"
    shutil.copytree(both[form], out)
    assert problems(out) == []
    logs = ("make.log", "make-claims.log")
    files = [path for path in sorted(out.rglob("*")) if path.is_file() and path.name not in logs]
    assert len(files) == (5 + 3 if form == "webdataset" else 5 + 18)
    for path in files:
        content = path.read_bytes()
        for place in {0, len(content) // 2, len(content) - 1}:
            flipped = bytearray(content)
            flipped[place] ^= 1
            path.write_bytes(flipped)
            messages = problems(out)
            assert messages and all("\n" not in line for line in messages), (path.name, place)
        path.write_bytes(content)
    assert problems(out) == []


@pytest.mark.parametrize("form", ["webdataset", "folders"])
def test_verify_finds_missing_and_extra_files(both, form, tmp_path):
    out = tmp_path / "ds"
    shutil.copytree(both[form], out)
    (out / "extra.txt").write_text("x")
    assert problems(out) == ["extra.txt: is not part of the dataset"]
    (out / "extra.txt").unlink()
    name = next(name for name in sums(out) if name.endswith((".tar", "truth.exr")))
    (out / name).unlink()
    assert any(name in line and "is missing" in line for line in problems(out))


def test_verify_reads_more_than_checksums(both, tmp_path):
    """Set-up: a dataset that was changed and whose checksums were then rewritten. Expectation: rows, seeds and pixels
    are checked too.
    """
    out = tmp_path / "ds"
    shutil.copytree(both["folders"], out)
    (folder,) = out.glob("*/000000002")

    def resealed(name: str, change) -> list[str]:
        path = folder / name
        before = path.read_bytes()
        path.write_bytes(change(before))
        reseal(out, path, before)
        messages = problems(out)
        path.write_bytes(before)
        reseal(out, path, before)
        return messages

    def meta(**changes):
        return lambda content: json.dumps(json.loads(content) | changes).encode()

    assert any("seed differs from" in line for line in resealed("meta.json", meta(seed=1)))
    white = cv2.imencode(".png", np.full((24, 32), 65535, np.uint16))[1].tobytes()
    assert any("beyond the range of the converter" in line for line in resealed("raw.png", lambda _: white))
    small = cv2.imencode(".png", np.zeros((24, 30), np.uint16))[1].tobytes()
    assert any("raw.png is 30 x 24" in line for line in resealed("raw.png", lambda _: small))
    assert any("cannot be read" in line for line in resealed("truth.exr", lambda content: content[:100]))


def reseal(out: Path, path: Path, before: bytes) -> None:
    """Rewrite the index and the checksums for the files as they are now, as in a forgery."""
    import hashlib

    import pyarrow
    import pyarrow.parquet

    rows = pyarrow.parquet.read_table(out / plan.INDEX).to_pylist()
    for row in rows:
        if row["key"] == path.parent.name:
            row["sha256"][path.name] = hashlib.sha256(path.read_bytes()).hexdigest()
    pyarrow.parquet.write_table(pyarrow.Table.from_pylist(rows), out / plan.INDEX)
    lines = [f"{hashlib.sha256((out / name).read_bytes()).hexdigest()}  {name}\n" for name in sums(out)]
    (out / plan.SUMS).write_text("".join(lines))


def test_verify_needs_no_sources(both, tmp_path, monkeypatch):
    """A dataset can be verified where the files of its scenes are missing."""
    shutil.copytree(both["webdataset"], tmp_path / "elsewhere")
    monkeypatch.chdir(tmp_path)
    assert problems(Path("elsewhere")) == []


def test_verify_of_an_unfinished_dataset(tmp_path, renderer):
    spec = spec_file(tmp_path)
    make_dataset(spec, tmp_path / "ds", shard=(1, 2))
    assert "is not finished" in problems(tmp_path / "ds")[0]
    with pytest.raises(InputError, match=r"is not finished, it has no index\.parquet"):
        dasim.open_dataset(tmp_path / "ds")


# --- the commands --------------------------------------------------------------------------------


@pytest.fixture
def command(monkeypatch, capsys, renderer):
    """Run ``dasim dataset`` in this process; returns exit status, stdout and stderr."""
    monkeypatch.setattr(executors, "local", lambda *_, **options: inline)

    def call(*arguments) -> tuple[int, str, str]:
        status = run(["dataset", *map(str, arguments)])
        printed = capsys.readouterr()
        return status, printed.out, printed.err

    return call


def test_make_verify_info(command, tmp_path):
    spec, out = spec_file(tmp_path), tmp_path / "ds"
    status, output, _ = command("make", spec, "--out", out)
    assert status == 0 and "6 of 6 samples" in output
    assert command("make", spec, "--out", out)[0] == 0
    status, output, _ = command("verify", out)
    assert status == 0 and "no problems" in output
    (out / "README.md").write_text("?")
    status, output, _ = command("verify", out)
    assert status == 1 and "README.md: its checksum differs" in output and "1 problems" in output
    status, output, _ = command("info", out, "--plot", tmp_path / "plot.png")
    assert status == 0 and "samples: 6 of 1 scenes" in output and "lights: D65 6" in output
    assert cv2.imread(str(tmp_path / "plot.png")).std() > 1
    assert command("info", out, "--plot", tmp_path / "plot.pdf")[0] == 2


def test_dry_run_writes_nothing(command, tmp_path):
    spec = spec_file(tmp_path)
    status, output, _ = command("make", spec, "--out", tmp_path / "ds", "--dry-run")
    assert status == 0 and not (tmp_path / "ds").exists()
    assert "train: 6 samples in 3 shards" in output
    assert "exposure.auto_level" in output and "estimate from 3 renders" in output and "GB" in output


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda spec, out: spec.write_text(spec.read_text().replace("spp = 4", "spp = 8")), "spec.spp was 4, now 8"),
        (lambda spec, out: rewrite(out, schema=99), "newer than this dasim knows"),
        (lambda spec, out: rewrite(out, llvm="1.0"), "llvm was"),
        (lambda spec, out: (out / plan.MANIFEST).write_text("{"), "is damaged"),
        (lambda spec, out: (out / plan.MANIFEST).rename(out / "x.json"), "is no dataset and not empty"),
        (lambda spec, out: (shutil.rmtree(out), out.write_text("")), "ds"),
    ],
)
def test_folder_of_something_else_is_refused(change, message, command, both, tmp_path):
    out, spec = tmp_path / "ds", tmp_path / "spec.toml"
    shutil.copytree(both["webdataset"].parent, tmp_path, dirs_exist_ok=True)
    change(spec, out)
    before = {path: path.read_bytes() for path in out.rglob("*") if path.is_file()}
    status, _, error = command("make", spec, "--out", out)
    assert status == 2 and message in error and len(error.splitlines()) == 1
    assert {path: path.read_bytes() for path in out.rglob("*") if path.is_file()} == before


def rewrite(out: Path, **changes) -> None:
    manifest = json.loads((out / plan.MANIFEST).read_text())
    (out / plan.MANIFEST).write_text(json.dumps(manifest | changes))


@pytest.mark.parametrize("task", ["verify", "info"])
def test_no_dataset_is_refused(task, command, tmp_path):
    for out in (tmp_path, tmp_path / "nowhere", __file__):
        status, _, error = command(task, out)
        assert status == 2 and "is no dataset" in error and len(error.splitlines()) == 1
    status, _, error = command(task, "nothing://bucket/ds")
    assert status == 2 and "cannot be opened" in error and len(error.splitlines()) == 1


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (("--shard", "3/2"), "--shard '3/2'"),
        (("--shard", "0/2"), "--shard"),
        (("--shard", "1/2", "--retry"), "--retry"),
        (("--jobs", "0"), "--jobs 0"),
        (("--executor", "slurm"), "slurm"),
        (("--variant", "scalar_rgb"), "scalar_rgb"),
    ],
)
def test_impossible_options_are_refused(options, message, command, tmp_path):
    status, _, error = command("make", spec_file(tmp_path), "--out", tmp_path / "ds", *options)
    assert status != 0 and message in error and not (tmp_path / "ds").exists()


def test_folder_without_permission_is_refused(command, tmp_path):
    """Set-up: a folder without write permission, or a system folder if the user is root."""
    closed = tmp_path / "closed"
    closed.mkdir(mode=0o500)
    out = Path("/proc/dasim") if os.access(closed, os.W_OK) else closed / "ds"
    status, _, error = command("make", spec_file(tmp_path), "--out", out)
    assert status == 2 and "cannot be written" in error and len(error.splitlines()) == 1


def test_a_disk_that_is_too_small_is_reported_before_the_start(command, tmp_path, monkeypatch):
    """The estimate of the size is above the actual size, but not many times."""
    spec = spec_file(tmp_path)
    described = load_spec(spec)
    monkeypatch.setattr(storage, "free_bytes", lambda out: 1000)
    status, _, error = command("make", spec, "--out", tmp_path / "ds")
    assert status == 2 and "6 samples need about" in error and "truth.half" in error
    assert not list((tmp_path / "ds").glob("parts/*"))
    monkeypatch.undo()
    make_dataset(spec, tmp_path / "ds")
    size = sum(row["bytes"] for row in dasim.open_dataset(tmp_path / "ds").rows) / 6
    assert size < plan.sample_bytes(described) < 4 * size


# --- in training code ----------------------------------------------------------------------------


def test_torch_loader(both):
    """The example of the README."""
    torch = pytest.importorskip("torch", reason="PyTorch is not installed")

    def batch(samples):
        raw = torch.stack([torch.from_numpy(sample.raw_dn.astype("float32")) for sample in samples])
        depth = torch.stack([torch.from_numpy(sample.truth["depth_m"]) for sample in samples])
        return raw, depth

    train = dasim.open_dataset(both["webdataset"], split="train")
    loader = torch.utils.data.DataLoader(train, batch_size=2, shuffle=True, num_workers=2, collate_fn=batch)
    shapes = [(tuple(raw.shape), tuple(depth.shape)) for raw, depth in loader]
    assert shapes == [((2, 24, 32), (2, 24, 32))] * 2


def test_torch_batches_arrays_by_itself(both):
    """PyTorch's own collate function stacks the arrays: [batch, ...], the same numbers; texts become lists."""
    torch = pytest.importorskip("torch", reason="PyTorch is not installed")
    samples = dasim.open_dataset(both["webdataset"], split="train")
    batches = list(torch.utils.data.DataLoader(samples.arrays(), batch_size=2))
    assert sum(len(batch["key"]) for batch in batches) == len(samples)
    for place, batch in enumerate(batches):
        for number in range(2):
            sample = samples[2 * place + number]
            assert batch["index"][number] == sample.index and batch["scene"][number] == sample.meta["sample"]["scene"]
            np.testing.assert_array_equal(batch["raw_dn"][number].numpy(), sample.raw_dn)
            for name in ("depth_m", "object_id", "valid", "mean_e"):
                np.testing.assert_array_equal(batch[name][number].numpy(), sample.truth[name])


def test_arrays_have_equal_keys_and_plain_values(both):
    """Rationale: default collate functions batch arrays, numbers and texts of equal keys and shapes, nothing else."""
    dataset = dasim.open_dataset(both["folders"]).arrays()
    rows = list(dataset)
    assert len(dataset) == len(rows) == len(dataset[:4]) + 2 and dataset[1]["index"] == rows[1]["index"] == 1
    for row in rows:
        assert row.keys() == rows[0].keys()
        for name, value in row.items():
            assert isinstance(value, (np.ndarray, int, float, str)), name
            if isinstance(value, np.ndarray):
                assert value.shape == rows[0][name].shape and value.dtype.kind in "bif", name


# --- how numbers are stored ----------------------------------------------------------------------


@pytest.mark.parametrize("form", ["webdataset", "folders"])
def test_raw_numbers_that_fill_16_bits(form, renderer, tmp_path):
    """Set-up: the same sample with both scales. Expectation: the picture on disk has 64 times the numbers of the 10-bit
    sensor, and every reader gives the sensor's own.
    """
    made, stored = {}, {}
    for scale in ("dn", "full"):
        (tmp_path / scale).mkdir()
        spec = spec_file(tmp_path / scale, samples=1, format=form, top=f'raw_scale = "{scale}"')
        out = tmp_path / scale / "ds"
        make_dataset(spec, out)
        assert list(verify.problems(str(out))) == []
        made[scale] = dasim.open_dataset(out)[0]
        if form == "folders":
            stored[scale] = cv2.imread(str(out / "train" / "000000000" / "raw.png"), cv2.IMREAD_UNCHANGED)
            loaded = dasim.load_capture(out / "train" / "000000000")
            np.testing.assert_array_equal(loaded.raw_dn, made[scale].raw_dn)
    np.testing.assert_array_equal(made["dn"].raw_dn, made["full"].raw_dn)
    assert (made["dn"].meta["raw_scale"], made["full"].meta["raw_scale"]) == (1, 64)
    if form == "folders":
        np.testing.assert_array_equal(stored["full"], 64 * stored["dn"])
        meta = tmp_path / "full" / "ds" / "train" / "000000000" / "meta.json"
        for wrong, message in (("128", "no multiples of 128"), ("3", "raw_scale 3"), ('"a"', "raw_scale 'a'")):
            meta.write_text(json.dumps(made["full"].meta).replace('"raw_scale": 64', f'"raw_scale": {wrong}'))
            with pytest.raises(InputError, match=message):
                dasim.load_capture(meta.parent)


def test_each_makes_a_grid_of_captures():
    """Expectation: the captures of every scene have all pairs of f-number and focus, the f-number varying fastest."""
    spec = spec_of(
        samples=12,
        cameras=[{"name": "da-mobile", "vary": {"lens.f_number": {"each": [1.8, 4]}}}],
        focus={"distance_m": {"each": [0.2, 0.4, 0.8]}},
        scenes={"captures_per_scene": 6},
    )
    grid = [(n, d) for d in (0.2, 0.4, 0.8) for n in (1.8, 4)]
    for scene in (0, 1):
        lenses = [draws.draft(spec, 6 * scene + number).camera.lens for number in range(6)]
        assert [(lens.f_number, lens.focus_distance_m) for lens in lenses] == grid


def test_webdataset_library(both):
    """The library webdataset reads the same samples, without dasim except for the file of the truth."""
    pytest.importorskip("webdataset", reason="webdataset is not installed")
    shards = sorted(str(path) for path in both["webdataset"].glob("*.tar"))
    program = (
        "import hashlib, json, sys, webdataset\n"
        "for item in webdataset.WebDataset(sys.argv[1:], shardshuffle=False):\n"
        "    files = ('raw.png', 'truth.exr', 'meta.json')\n"
        "    print(json.dumps([item['__key__'], {f: hashlib.sha256(item[f]).hexdigest() for f in files}]))"
    )  # a process of its own: the library leaves files open, which is an error here
    done = subprocess.run([sys.executable, "-c", program, *shards], capture_output=True, text=True, check=True)
    rows = dasim.open_dataset(both["webdataset"]).rows
    assert dict(map(json.loads, done.stdout.splitlines())) == {row["key"]: row["sha256"] for row in rows}


# --- sensors -------------------------------------------------------------------------------------


def test_samples_share_a_sensor_unless_each_has_its_own():
    """Expectation: the frames' seeds differ; the sensor is the camera's, or another for each sample, the same again."""
    shared, own = (
        [draws.draft(spec_of(sensor_per_sample=each), index) for index in range(3)] for each in (False, True)
    )
    assert {plan.camera.sensor.sensor_seed for plan in shared} == {dasim.load_camera("da-mobile").sensor.sensor_seed}
    assert len({plan.camera.sensor.sensor_seed for plan in own}) == len({plan.seed for plan in shared}) == 3
    again = draws.draft(spec_of(sensor_per_sample=True), 1)
    assert again.camera == own[1].camera and [plan.seed for plan in own] == [plan.seed for plan in shared]


# --- kinds of scenes, and the first samples ------------------------------------------------------


def test_kinds_of_scenes_take_turns():
    """Set-up: table tops and rooms, two captures of each scene. Expectation: both captures of a scene show its kind,
    which ``meta.json`` and the index state as the draft does.
    """
    kinds = {"tops": {"room_share": 0.0}, "rooms": {"room_share": 1.0}}
    spec = spec_of(scenes={"kinds": kinds, "captures_per_scene": 2}, size_px=[64, 48])
    drafts = [draws.draft(spec, index) for index in range(6)]
    assert [one.kind for one in drafts] == ["tops", "tops", "rooms", "rooms", "tops", "tops"]
    words = {"tops": "table top,", "rooms": "room,"}
    assert all(one.scene.description.startswith(words[one.kind]) for one in drafts)
    assert draws.draft(spec_of(), 0).kind is None


def test_the_first_samples_are_those_of_the_whole_dataset(tmp_path, renderer):
    """Expectation: the same bytes in the same splits, and a dataset that says so and is complete."""
    spec = spec_file(tmp_path, format="folders", more="[splits]\ntrain = 0.5\ntest = 0.5\n", files=["a.toml", "b.toml"])
    for name in ("a.toml", "b.toml"):
        (tmp_path / name).write_text(WALL)
    make_dataset(spec, tmp_path / "whole")
    spec.write_text("first = 3\n" + spec.read_text())
    make_dataset(spec, tmp_path / "part")
    whole, part = dasim.open_dataset(tmp_path / "whole"), dasim.open_dataset(tmp_path / "part")
    assert len(whole) == 6 and [row["index"] for row in part.rows] == [0, 1, 2]
    for mine, theirs in zip(part.rows, whole.rows, strict=False):
        assert (mine["sha256"], mine["split"], mine["scene"]) == (theirs["sha256"], theirs["split"], theirs["scene"])
    assert not list(verify.problems(str(tmp_path / "part")))
    assert run(["dataset", "make", str(spec), "--out", str(tmp_path / "new"), "--first", "7"]) == 2


def test_bundled_specifications_have_names():
    assert bundled_names() == ["dasim-bench"] and load_spec("dasim-bench").name == "dasim-bench"
    with pytest.raises(InputError, match=r"neither a bundled name \(dasim-bench\) nor a file"):
        load_spec("dasim-bensch")
