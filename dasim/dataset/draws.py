"""Sample i of a dataset: scene, camera, focus, light, exposure and split, from the specification and i alone.

Tested in tests/dasim/dataset/test_specification.py.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import lru_cache
from typing import Any

import numpy as np

from dasim import loading
from dasim.base.toml import Specification, parse
from dasim.camera import specification as cameras
from dasim.camera.noise import Exposure
from dasim.camera.specification import Camera
from dasim.dataset.specification import DatasetSpec, named_camera, random_spec, scene_count, scene_keys, varied
from dasim.random_scenes import specification
from dasim.scene.mitsuba_scene import MitsubaScene
from dasim.scene.specification import Scene

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
    drawn = values(spec, index)
    base = named_camera(spec, spec.cameras[_choice(spec, index)])
    camera = cameras.cropped(varied(base, _below(drawn, "camera")), *spec.size_px)
    scene, exposure = _scene(spec, number, base)
    scene = _lit(scene, **_below(drawn, "light"))
    if "focus.distance_m" in drawn:
        camera = cameras.refocused(camera, float(drawn["focus.distance_m"]))
    else:
        camera = loading.focused(camera, scene)
    changes = _below(drawn, "exposure")
    return Draft(
        index=index,
        split=split_of_scene(spec, number),
        scene_key=scene_key(spec, number),
        scene=scene,
        camera=camera,
        exposure=parse(Exposure, exposure.model_dump() | changes, "exposure") if changes else exposure,
        seed=capture_seed(spec, index),
        drawn=drawn,
    )


def values(spec: DatasetSpec, index: int) -> dict[str, Any]:
    """What the specification's distributions give for a sample; needs no files."""
    choice = spec.cameras[_choice(spec, index)]
    random = _generator(spec, index, "camera", 1)
    drawn: dict[str, Any] = {"camera": choice.name}
    drawn |= {f"camera.{key}": draw.draw(random) for key, draw in choice.vary.items()}
    parts: tuple[tuple[str, Specification], ...] = (
        ("light", spec.light),
        ("focus", spec.focus),
        ("exposure", spec.exposure),
    )
    for stage, part in parts:
        random = _generator(spec, index, stage)
        draws = {key: getattr(part, key) for key in type(part).model_fields}
        drawn |= {f"{stage}.{key}": draw.draw(random) for key, draw in draws.items() if draw is not None}
    return drawn


def _below(drawn: dict[str, Any], stage: str) -> dict[str, Any]:
    return {key.partition(".")[2]: value for key, value in drawn.items() if key.startswith(f"{stage}.")}


def capture_seed(spec: DatasetSpec, index: int) -> int:
    """Seed of a sample's rendering and sensor noise."""
    return int(np.random.SeedSequence((spec.seed, index, _STAGES["capture"])).generate_state(1)[0])


def scene_key(spec: DatasetSpec, number: int) -> str:
    """What a scene is called in the index."""
    return (scene_keys(spec) or {number: f"random:{spec.seed}:{number}"})[number]


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


def _generator(spec: DatasetSpec, index: int, stage: str, part: int = 0) -> np.random.Generator:
    return np.random.default_rng(np.random.SeedSequence((spec.seed, index, _STAGES[stage], part)))


def _choice(spec: DatasetSpec, index: int) -> int:
    """Which of the cameras takes a sample."""
    weights = np.array([choice.weight for choice in spec.cameras])
    return int(_generator(spec, index, "camera").choice(len(weights), p=weights / weights.sum()))


def _scene(spec: DatasetSpec, number: int, camera: Camera) -> tuple[Scene | MitsubaScene, Exposure]:
    """A scene, and how it wants to be exposed.

    Random scenes fit the frame of the first camera, so that all captures of one show the same scene.
    """
    keys = scene_keys(spec)
    if not keys:
        first = cameras.cropped(named_camera(spec, spec.cameras[0]), *spec.size_px)
        source = random_spec(spec)
        scene = specification.random_scene(spec.seed, number, source, first)
        return scene, specification.random_exposure(spec.seed, number, source)
    name = keys[number]
    path = spec.folder / name
    described = loading.load_scene(path if spec.scenes.family == "files" else name, camera=camera)
    return described, Exposure()


def _lit(scene: Scene | MitsubaScene, illuminant: str | None = None, scale: float = 1.0) -> Scene | MitsubaScene:
    """The scene under another illuminant or level, where the specification says so."""
    if isinstance(scene, MitsubaScene) or (illuminant is None and scale == 1.0):
        return scene
    data = scene.model_dump(mode="json", exclude={"folder"})
    for light in data["lights"]:
        light["lux"] *= scale
        if illuminant is not None and "illuminant" in light:
            light["illuminant"] = illuminant
    changed = parse(Scene, data, f"scene {scene.name}, light", folder=scene.folder)
    return changed.model_copy(update={"folder": scene.folder})
