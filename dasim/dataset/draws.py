"""Sample i of a dataset: scene, camera, focus, light, exposure and split, from the specification and i alone."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import lru_cache
from typing import Any

import numpy as np

from dasim import camera as cameras
from dasim import foreign, random_scenes
from dasim.camera import Camera
from dasim.dataset.specification import DatasetSpec, Draw, named_camera, random_spec, scene_count, scene_keys, varied
from dasim.foreign import MitsubaScene
from dasim.scene import Scene
from dasim.sensor import Exposure
from dasim.specification import parse

# Each part on a generator of its own: another distribution of one leaves the others as they are.
_STAGES = {"camera": 1, "light": 2, "focus": 3, "exposure": 4, "capture": 5, "splits": 6}


@dataclass(frozen=True)
class Draft:
    """A sample before it is photographed."""

    index: int
    split: str
    scene_key: str  # two samples with the same key show the same scene
    scene: Scene | MitsubaScene
    camera: Camera
    exposure: Exposure
    seed: int  # of rendering and sensor noise
    drawn: dict[str, Any] = field(default_factory=dict)  # what the specification's distributions gave


def draft(spec: DatasetSpec, index: int) -> Draft:
    """Sample ``index``, 0 to ``spec.samples`` - 1; InputError where what was drawn cannot be photographed."""
    number = scene_number(spec, index)
    drawn: dict[str, Any] = {}
    base, camera = _camera(spec, index, drawn)
    scene, exposure, key = _scene(spec, number, base)
    scene = _lit(spec, scene, index, drawn)
    camera = cameras.cropped(camera, *spec.size_px)
    if spec.focus.distance_m is None:
        camera = foreign.focused(camera, scene)
    else:
        drawn["focus.distance_m"] = spec.focus.distance_m.draw(_generator(spec, index, "focus"))
        camera = cameras.refocused(camera, float(drawn["focus.distance_m"]))
    return Draft(
        index=index,
        split=split_of_scene(spec, number),
        scene_key=key,
        scene=scene,
        camera=camera,
        exposure=_exposure(spec, exposure, index, drawn),
        seed=int(np.random.SeedSequence((spec.seed, index, _STAGES["capture"])).generate_state(1)[0]),
        drawn=drawn,
    )


def scene_number(spec: DatasetSpec, index: int) -> int:
    """Which scene a sample shows."""
    keys = scene_keys(spec)
    return index % len(keys) if keys else index // spec.scenes.captures_per_scene


def split_of_scene(spec: DatasetSpec, number: int) -> str:
    """The split of a scene and so of all its samples."""
    return _splits(scene_count(spec), spec.seed, tuple(spec.splits.items()))[number]


@lru_cache(maxsize=4)
def _splits(count: int, seed: int, shares: tuple[tuple[str, float], ...]) -> tuple[str, ...]:
    """A split for each scene, in shuffled order; each split gets one scene at least, and else its share, rounded."""
    ends = np.rint(np.cumsum([share for _, share in shares]) / sum(share for _, share in shares) * count).astype(int)
    for place in range(len(shares)):  # one scene each for this split and for those behind it
        ends[place] = max(ends[place], (ends[place - 1] if place else 0) + 1)
        ends[place] = min(ends[place], count - (len(shares) - 1 - place))
    names = np.repeat([name for name, _ in shares], np.diff([0, *ends]))
    order = np.random.default_rng(np.random.SeedSequence((seed, _STAGES["splits"]))).permutation(count)
    found = np.empty(count, dtype=names.dtype)
    found[order] = names
    return tuple(map(str, found))


def _generator(spec: DatasetSpec, index: int, stage: str) -> np.random.Generator:
    return np.random.default_rng(np.random.SeedSequence((spec.seed, index, _STAGES[stage])))


def _camera(spec: DatasetSpec, index: int, drawn: dict[str, Any]) -> tuple[Camera, Camera]:
    """The camera before and after its parameters were drawn."""
    random = _generator(spec, index, "camera")
    weights = np.array([choice.weight for choice in spec.cameras])
    choice = spec.cameras[int(random.choice(len(weights), p=weights / weights.sum()))]
    base = named_camera(spec, choice)
    values = {key: draw.draw(random) for key, draw in choice.vary.items()}
    drawn["camera"] = choice.name
    drawn |= {f"camera.{key}": value for key, value in values.items()}
    return base, varied(base, values)


def _scene(spec: DatasetSpec, number: int, camera: Camera) -> tuple[Scene | MitsubaScene, Exposure, str]:
    """A scene, how it wants to be exposed, and what it is called.

    Random scenes fit the frame of the first camera, so that all captures of one show the same scene.
    """
    keys = scene_keys(spec)
    if not keys:
        first = cameras.cropped(named_camera(spec, spec.cameras[0]), *spec.size_px)
        source = random_spec(spec)
        scene = random_scenes.random_scene(spec.seed, number, source, first)
        return scene, random_scenes.random_exposure(spec.seed, number, source), f"random:{spec.seed}:{number}"
    name = keys[number]
    path = spec.folder / name
    described = foreign.load_scene(path if spec.scenes.family == "files" else name, camera=camera)
    return described, Exposure(), name


def _lit(spec: DatasetSpec, scene: Scene | MitsubaScene, index: int, drawn: dict[str, Any]) -> Scene | MitsubaScene:
    """The scene under another illuminant or level, where the specification says so."""
    random = _generator(spec, index, "light")
    changes: dict[str, Any] = {}
    for key, draw in (("illuminant", spec.light.illuminant), ("scale", spec.light.scale)):
        if draw is not None:
            changes[key] = drawn[f"light.{key}"] = draw.draw(random)
    if not changes or isinstance(scene, MitsubaScene):
        return scene
    data = scene.model_dump(mode="json", exclude={"folder"})
    for light in data["lights"]:
        if "illuminant" in changes and "illuminant" in light:
            light["illuminant"] = changes["illuminant"]
        if "scale" in changes and light.get("lux") is not None:
            light["lux"] *= changes["scale"]
    changed = parse(Scene, data, f"scene {scene.name}, light", folder=scene.folder)
    return changed.model_copy(update={"folder": scene.folder})


def _exposure(spec: DatasetSpec, own: Exposure, index: int, drawn: dict[str, Any]) -> Exposure:
    random = _generator(spec, index, "exposure")
    draws: tuple[tuple[str, Draw | None], ...] = tuple(
        (key, getattr(spec.exposure, key)) for key in ("time_s", "gain", "auto_level")
    )
    values = {key: draw.draw(random) for key, draw in draws if draw is not None}
    drawn |= {f"exposure.{key}": value for key, value in values.items()}
    return parse(Exposure, own.model_dump() | values, "exposure") if values else own
