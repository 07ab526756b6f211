"""The captures that depth is judged on: two sets without a common scene, each as its hash states."""

from __future__ import annotations

import hashlib
import json

import pytest

from dasim.base.errors import InputError
from dasim.base.toml import parse_toml
from dasim.camera import wavefront
from validation.subjects import held_out

TEST_HASH = "79553f0bbb5fb2aec31ff5c1"  # of the set that figures are measured on
COUNTS = {"tune": 24, "test": 40}
ROUNDING = 1e-9


@pytest.fixture(scope="module")
def entries():
    sets = parse_toml(held_out._Sets, held_out.FILE)
    return {name: getattr(sets, name) for name in COUNTS}


def test_the_test_set_is_the_one_that_figures_are_stated_for():
    """Expectation: a change of the set ``test`` is noticed; it makes all earlier figures void."""
    assert held_out.set_hash("test") == held_out.HASHES["test"] == TEST_HASH
    assert held_out.set_hash("tune") == held_out.HASHES["tune"]


# Of the scenes, cameras and exposures as they were drawn when the sets were fixed, without the classes of objects,
# which came later and change no pixel.
DRAWN = {"tune": "57bdffc2437e8e441052abc3", "test": "260a943a88bc28352238f7f3"}


@pytest.mark.slow
@pytest.mark.parametrize("name", DRAWN)
def test_both_sets_show_the_scenes_that_they_were_fixed_with(name):
    """Expectation: neither the list nor what is drawn from it changes, byte for byte: figures stay comparable."""
    digest = hashlib.sha256()
    for recipe in held_out.recipes(name):
        scene = recipe.scene.model_dump(mode="json", exclude_defaults=True, exclude={"folder"})
        for item in scene["objects"]:
            item.pop("class", None)
        digest.update(json.dumps(scene).encode())
        assert all(wavefront.is_flat(wavefront.of_stop(recipe.camera, stop)) for stop in recipe.camera.stops)
        camera = recipe.camera.model_dump_json(exclude={"stops": {"__all__": {"wavefront_nm"}}})  # came later
        digest.update((recipe.exposure.model_dump_json() + camera).encode())
    assert digest.hexdigest()[:24] == DRAWN[name]


def test_both_sets_are_complete(entries):
    for name, count in COUNTS.items():
        assert len(entries[name]) == count == len({entry.name for entry in entries[name]})


def test_no_scene_for_choices_is_judged(entries):
    """Expectation: no bundled scene and no random number is in both sets; nothing occurs twice in one."""
    scenes = {name: [(e.scene, e.seed, e.number) for e in group] for name, group in entries.items()}
    assert not set(scenes["tune"]) & set(scenes["test"])
    assert all(len(group) == len(set(group)) for group in scenes.values())


def test_the_test_set_has_eight_lights_and_every_camera(entries):
    assert len({entry.illuminant for entry in entries["test"]} - {None}) == 8
    for group in entries.values():
        assert {entry.camera for entry in group} == {"da-mobile", "da-8mm", "da-4x4"}


def lit_as_listed(entry) -> bool:
    """Whether size, light, illuminance and gain of a recipe are those of its entry."""
    recipe = held_out._recipe(entry)
    lights = recipe.scene.lights
    assert (recipe.camera.sensor.width_px, recipe.camera.sensor.height_px) == held_out.SIZE_PX
    assert entry.gain is None or recipe.exposure.gain == entry.gain
    assert entry.illuminant is None or {light.illuminant for light in lights} == {entry.illuminant}
    return entry.lux is None or sum(light.lux for light in lights) == pytest.approx(entry.lux, rel=ROUNDING)


@pytest.mark.parametrize("name", ["light-2", "desk"])
def test_lux_light_and_gain_are_as_listed(entries, name):
    assert lit_as_listed(next(entry for entry in entries["test"] if entry.name == name))


@pytest.mark.slow
@pytest.mark.parametrize("name", ["tune", "test"])
def test_all_captures_are_as_listed(entries, name):
    assert all(map(lit_as_listed, entries[name]))
    assert [recipe.name for recipe in held_out.recipes(name)] == [entry.name for entry in entries[name]]


def test_a_changed_set_is_refused(tmp_path):
    file = tmp_path / "held_out.toml"
    file.write_text(held_out.FILE.read_text().replace("number = 25", "number = 99"))
    with pytest.raises(InputError, match="the set 'test' has the hash"):
        held_out.recipes("test", file)


def test_comments_do_not_change_the_hash(tmp_path):
    file = tmp_path / "held_out.toml"
    file.write_text("# A comment.\n" + held_out.FILE.read_text())
    assert held_out.set_hash("test", file) == TEST_HASH
