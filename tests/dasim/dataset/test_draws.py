"""Draws of a dataset: distributions, splits, and what a sample depends on."""

from __future__ import annotations

from collections import Counter

import numpy as np
import pytest

import dasim
from dasim.base.toml import parse
from dasim.dataset import draws, plan
from dasim.dataset.specification import DatasetSpec, load_spec
from tests.support.datasets import spec_file

COUNT = 400
SIGMAS = 5


def spec_of(**changes) -> DatasetSpec:
    return parse(DatasetSpec, {"name": "test", "samples": COUNT, **changes}, "test")


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
    more = "gain = 2\n[light]\nilluminant = 'A'\nscale = 3\n[focus]\ndistance_m = 0.7\n"
    more += '[[cameras]]\nname = "da-mobile"\n[cameras.vary]\n'
    more += "'lens.f_number' = {uniform = [2.2, 2.8]}\n'stops.1.name' = 'other'\n"
    spec = load_spec(spec_file(tmp_path, more=more))
    sample = draws.draft(spec, 3)
    assert sample.camera.lens.f_number == sample.drawn["camera.lens.f_number"] != 2.0
    assert sample.camera.stops[1].name == "other"
    assert sample.camera.lens.focus_distance_m == 0.7
    assert sample.exposure.gain == 2 and sample.exposure.auto_level == sample.drawn["exposure.auto_level"]
    (light,) = sample.scene.lights
    assert (light.illuminant, light.lux) == ("A", 3000)
    assert (sample.camera.sensor.width_px, sample.camera.sensor.height_px) == (32, 24)


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


def test_samples_share_a_sensor_unless_each_has_its_own():
    """Expectation: the frames' seeds differ; the sensor is the camera's, or another for each sample, the same again."""
    shared, own = (
        [draws.draft(spec_of(sensor_per_sample=each), index) for index in range(3)] for each in (False, True)
    )
    assert {plan.camera.sensor.sensor_seed for plan in shared} == {dasim.load_camera("da-mobile").sensor.sensor_seed}
    assert len({plan.camera.sensor.sensor_seed for plan in own}) == len({plan.seed for plan in shared}) == 3
    again = draws.draft(spec_of(sensor_per_sample=True), 1)
    assert again.camera == own[1].camera and [plan.seed for plan in own] == [plan.seed for plan in shared]


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
