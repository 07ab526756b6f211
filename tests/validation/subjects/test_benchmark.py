"""The benchmark: its splits are those that figures are stated for, and nothing was chosen on them."""

from __future__ import annotations

import tomllib
from collections import Counter

import pytest

from dasim.dataset import draws
from dasim.dataset.specification import kind, load_spec
from validation.subjects import benchmark, held_out


@pytest.mark.parametrize("split", ["tune", "test"])
def test_a_split_is_the_one_that_figures_are_stated_for(split):
    assert benchmark.recipe_hash(split) == benchmark.HASHES[split]


def test_the_hash_is_of_scenes_and_stated_keys():
    spec = load_spec(benchmark.NAME)
    for change in ({"seed": spec.seed + 1}, {"samples": 299}, {"size_px": (512, 384)}):
        assert benchmark.recipe_hash("test", spec.model_copy(update=change)) != benchmark.HASHES["test"]
    assert benchmark.recipe_hash("test", spec.model_copy(update={"first": 3})) == benchmark.HASHES["test"]


def test_nothing_was_chosen_on_the_scenes_of_the_benchmark():
    """Expectation: no scene of the sets that methods are tuned and claims judged on has the seed of the benchmark."""
    sets = tomllib.loads(held_out.FILE.read_text())
    seeds = {entry.get("seed") for entries in sets.values() for entry in entries}
    assert len(seeds) > 1 and load_spec(benchmark.NAME).seed not in seeds


def test_the_benchmark_has_three_difficulties_in_either_split():
    spec = load_spec(benchmark.NAME)
    assert spec.samples == 300 and list(spec.scenes.kinds) == ["table-tops", "rooms", "hard"]
    numbers = [draws.scene_number(spec, index) for index in range(spec.samples)]
    counts = Counter((draws.split_of_scene(spec, number), kind(spec, number)) for number in numbers)
    assert sum(count for (split, _), count in counts.items() if split == "test") == 240
    assert min(counts.values()) >= 10 and len(counts) == 6, counts
