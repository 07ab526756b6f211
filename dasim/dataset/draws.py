"""Sample i of a dataset: scene, camera, focus, light, exposure and split, which depend on the specification and i."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import lru_cache
from typing import Any

import numpy as np

from dasim import loading
from dasim.base.toml import Specification, parse
from dasim.camera import specification as cameras
from dasim.camera.dotted_keys import with_values
from dasim.camera.noise import Exposure
from dasim.camera.specification import Camera
from dasim.dataset.choices import Draw
from dasim.dataset.specification import DatasetSpec, kind, named_camera, random_spec, scene_count, scene_keys
from dasim.random_scenes.scene import random_exposure, random_scene
from dasim.scene.mitsuba_scene import MitsubaScene, is_mitsuba
from dasim.scene.poses import seen_from
from dasim.scene.specification import Scene
from dasim.simulation.exposure import frame_seed

# Each part has its own random generator: changing the distribution of one part does not change the others.
_STAGES = {"camera": 1, "light": 2, "focus": 3, "exposure": 4, "capture": 5, "splits": 6, "sensor": 7}


@dataclass(frozen=True)
class Draft:
    """A sample before it is rendered."""

    index: int
    split: str
    scene_key: str  # two samples with the same key show the same scene
    scene: Scene | MitsubaScene
    camera: Camera
    exposure: Exposure
    seed: int  # of rendering and sensor noise
    drawn: dict[str, Any] = field(default_factory=dict)  # values from the distributions, by dotted key
    kind: str | None = None  # of the scene, where the dataset has several


def draft(spec: DatasetSpec, index: int) -> Draft:
    """Draft of sample ``index``, 0 to ``spec.made`` - 1; raises InputError if its random values are not allowed."""
    number, (_, view) = scene_number(spec, index), capture_and_view(spec, index)
    settings = values(spec, index)
    drawn = named_camera(spec, spec.cameras[_choice(spec, index)].name)
    scene, exposure = _scene(spec, number, drawn)
    scene = _relight(scene, **_below(settings, "light"))
    camera = cameras.cropped(_camera(spec, index, drawn, _below(settings, "camera")), *spec.size_px)
    if "focus.distance_m" in settings:
        camera = cameras.refocused(camera, float(settings["focus.distance_m"]))
    else:
        camera = loading.focused(camera, scene)
    changes = _below(settings, "exposure")
    return Draft(
        index=index,
        split=split_of_scene(spec, number),
        scene_key=scene_key(spec, number),
        scene=scene if isinstance(scene, MitsubaScene) else seen_from(scene, spec.views.pose(view)),
        camera=camera,
        exposure=parse(Exposure, exposure.model_dump() | changes, "exposure") if changes else exposure,
        seed=capture_seed(spec, index),
        drawn=settings,
        kind=kind(spec, number),
    )


def _camera(spec: DatasetSpec, index: int, drawn: Camera, changes: dict[str, Any]) -> Camera:
    """Camera of a sample: the ``drawn`` camera with its ``changes``, or the one that the rig specifies for this view.

    Without ``sensor_per_sample``, the first camera of a rig has the sensor of its file, each other one its own sensor.
    """
    place = capture_and_view(spec, index)[1] % len(spec.views.rig)
    other = spec.views.rig[place].camera
    camera = with_values(drawn, changes) if other is None else named_camera(spec, other)
    if spec.sensor_per_sample:
        return with_values(camera, {"sensor.sensor_seed": _seed(spec, index, "sensor")})
    return with_values(camera, {"sensor.sensor_seed": (camera.sensor.sensor_seed or 0) + place}) if place else camera


def capture_and_view(spec: DatasetSpec, index: int) -> tuple[int, int]:
    """Number of the capture that a sample belongs to, and number of its view of it, each from 0."""
    return divmod(index, spec.views.count)


def values(spec: DatasetSpec, index: int) -> dict[str, Any]:
    """Random values of a sample from the specification's distributions, by dotted key; reads no files.

    The views of a capture share them, but for the camera of a view for which the rig states one.
    """
    choice = spec.cameras[_choice(spec, index)]
    random = _generator(spec, index, "camera", 1)
    settings: dict[str, Any] = {"camera": choice.name}
    turn = capture_number(spec, index)
    for key, draw in choice.vary.items():
        settings[f"camera.{key}"], turn = draw.draw(random, turn), _left(draw, turn)
    parts: tuple[tuple[str, Specification], ...] = (
        ("light", spec.light),
        ("focus", spec.focus),
        ("exposure", spec.exposure),
    )
    for stage, part in parts:
        random = _generator(spec, index, stage)
        draws = {key: getattr(part, key) for key in type(part).model_fields}
        for key, draw in draws.items():
            if draw is not None:
                settings[f"{stage}.{key}"], turn = draw.draw(random, turn), _left(draw, turn)
    own = spec.views.rig[capture_and_view(spec, index)[1] % len(spec.views.rig)].camera
    if own is not None:
        settings = {"camera": own} | {key: value for key, value in settings.items() if not key.startswith("camera")}
    return settings


def _left(draw: Draw, turn: int) -> int:
    """Turn of the next ``each`` of the grid, which advances after each full cycle of this one."""
    return turn if draw.each is None else turn // len(draw.each)


def _below(settings: dict[str, Any], stage: str) -> dict[str, Any]:
    """Values whose keys have the prefix ``stage`` and a dot, by the key without this prefix."""
    return {key.partition(".")[2]: value for key, value in settings.items() if key.startswith(f"{stage}.")}


def capture_seed(spec: DatasetSpec, index: int) -> int:
    """Seed of a sample's rendering and sensor noise."""
    return _seed(spec, index, "capture")


def frame_seeds(spec: DatasetSpec, index: int) -> list[int]:
    """Seed of the sensor noise of each frame of a sample."""
    return [frame_seed(capture_seed(spec, index), number) for number in range(spec.frames.count)]


def _seed(spec: DatasetSpec, index: int, stage: str) -> int:
    return int(np.random.SeedSequence((spec.seed, index, _STAGES[stage])).generate_state(1)[0])


def scene_key(spec: DatasetSpec, number: int) -> str:
    """Name of scene ``number`` in the index."""
    return (scene_keys(spec) or {number: f"random:{spec.seed}:{number}"})[number]


def scene_number(spec: DatasetSpec, index: int) -> int:
    """Number of the scene that a sample shows, from 0."""
    keys, capture = scene_keys(spec), capture_and_view(spec, index)[0]
    return capture % len(keys) if keys else capture // spec.scenes.captures_per_scene


def capture_number(spec: DatasetSpec, index: int) -> int:
    """Number of a sample's capture among the captures of its scene, from 0."""
    keys, capture = scene_keys(spec), capture_and_view(spec, index)[0]
    return capture // len(keys) if keys else capture % spec.scenes.captures_per_scene


def split_of_scene(spec: DatasetSpec, number: int) -> str:
    """Name of the split that contains a scene and all its samples."""
    return _splits(scene_count(spec), spec.seed, tuple(spec.splits.items()))[number]


@lru_cache(maxsize=4)
def _splits(count: int, seed: int, shares: tuple[tuple[str, float], ...]) -> tuple[str, ...]:
    """Split of each scene, at random; the splits have their shares of the scenes, rounded, and at least one each."""
    ends = np.rint(np.cumsum([share for _, share in shares]) / sum(share for _, share in shares) * count).astype(int)
    for place in range(len(shares)):  # leaves one scene at least for this split and for each later one
        ends[place] = max(ends[place], (ends[place - 1] if place else 0) + 1)
        ends[place] = min(ends[place], count - (len(shares) - 1 - place))
    names = np.repeat([name for name, _ in shares], np.diff([0, *ends]))
    order = np.random.default_rng(np.random.SeedSequence((seed, _STAGES["splits"]))).permutation(count)
    splits = np.empty(count, dtype=names.dtype)
    splits[order] = names
    return tuple(map(str, splits))


def _generator(spec: DatasetSpec, index: int, stage: str, part: int = 0) -> np.random.Generator:
    capture = capture_and_view(spec, index)[0]
    return np.random.default_rng(np.random.SeedSequence((spec.seed, capture, _STAGES[stage], part)))


def _choice(spec: DatasetSpec, index: int) -> int:
    """Index of a sample's camera among those of the specification, drawn with their weights."""
    weights = np.array([choice.weight for choice in spec.cameras])
    return int(_generator(spec, index, "camera").choice(len(weights), p=weights / weights.sum()))


def _scene(spec: DatasetSpec, number: int, camera: Camera) -> tuple[Scene | MitsubaScene, Exposure]:
    """Scene ``number`` and its exposure.

    A random scene is laid out for the frame of the first camera, so that all captures of it show the same objects.
    """
    keys = scene_keys(spec)
    if not keys:
        first = cameras.cropped(named_camera(spec, spec.cameras[0].name), *spec.size_px)
        source = random_spec(spec, number)
        scene = random_scene(spec.seed, number, source, first)
        return scene, random_exposure(spec.seed, number, source)
    name = keys[number]
    if spec.scenes.family != "files":
        return loading.load_scene(name, camera=camera), Exposure()
    choices = spec.scenes.mitsuba.model_dump() if is_mitsuba(name) else {}
    return loading.load_scene(spec.folder / name, camera=camera, **choices), Exposure()


def _relight(scene: Scene | MitsubaScene, illuminant: str | None = None, scale: float = 1.0) -> Scene | MitsubaScene:
    """The scene with another illuminant in all lights and their illuminance times ``scale``; XML scenes unchanged."""
    if isinstance(scene, MitsubaScene) or (illuminant is None and scale == 1.0):
        return scene
    data = scene.model_dump(mode="json", exclude={"folder"})
    for light in data["lights"]:
        light["lux"] *= scale
        if illuminant is not None and "illuminant" in light:
            light["illuminant"] = illuminant
    result = parse(Scene, data, f"scene {scene.name}, light", folder=scene.folder)
    return result.model_copy(update={"folder": scene.folder})
