"""Captures that depth and all-in-focus pictures are judged on: the set ``tune`` for choices, ``test`` for figures."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, Literal, NamedTuple

import dasim
import recon
from dasim.base.errors import InputError
from dasim.base.fingerprint import text_hash
from dasim.base.toml import Specification, parse_toml
from dasim.camera.noise import Exposure
from dasim.camera.specification import Camera
from dasim.random_scenes.scene import random_exposure
from dasim.random_scenes.specification import RandomScenes
from dasim.scene.loading import load_scene
from dasim.scene.specification import Scene
from dasim.simulation.exposure import Shot
from dasim.typing import Progress, ShareDone
from dasim.values import PsfBank
from validation.subjects.shots import photographed

FILE = Path(__file__).with_name("held_out.toml")
SIZE_PX = (384, 288)
SEED = 1  # of rendering and sensor noise

SetName = Literal["tune", "test"]

# Of the sets that figures were measured on: figures of a set with another hash cannot be compared with them.
HASHES: dict[SetName, str] = {"tune": "baa508c6f16b1e282bc93734", "test": "79553f0bbb5fb2aec31ff5c1"}


class Recipe(NamedTuple):
    """What a capture of a set shows, and through which camera."""

    name: str
    scene: Scene
    camera: Camera
    exposure: Exposure


class _Entry(Specification):
    """A capture as the file lists it; the head of the file explains the keys."""

    name: str
    scene: str
    camera: str
    seed: int = 0
    number: int = 0
    depth_cm: tuple[float, float] | None = None
    illuminant: str | None = None
    lux: float | None = None
    gain: float | None = None


class _Sets(Specification):
    tune: tuple[_Entry, ...]
    test: tuple[_Entry, ...]


def recipes(name: SetName, file: Path = FILE) -> list[Recipe]:
    """The captures of a set, without rendering them; raises InputError for another set than that of ``HASHES``."""
    found = set_hash(name, file)
    if found != HASHES[name]:
        raise InputError(
            f"{file}: the set '{name}' has the hash {found}, figures are stated for {HASHES[name]}; restore the file"
        )
    return [_recipe(entry) for entry in _entries(name, file)]


def set_hash(name: SetName, file: Path = FILE) -> str:
    """Hash of the list of a set's captures, which does not depend on comments and the order of keys."""
    return text_hash([entry.model_dump_json() for entry in _entries(name, file)])


def capture(recipe: Recipe, progress: Progress = lambda stage, share: None) -> Shot:
    """The capture and the truth of a recipe, with rendering noise below its default share of the sensor's."""
    return photographed(recipe.scene, recipe.camera, SEED, spp="auto", exposure=recipe.exposure, progress=progress)


def calibrated(recipes: Sequence[Recipe], progress: ShareDone) -> Iterator[tuple[Recipe, Shot, PsfBank]]:
    """Each recipe with its capture and truth, and a bank calibrated for its camera and focus; rendered when asked for.

    ``progress`` gets the share of the captures that are done with.
    """
    for number, recipe in enumerate(recipes):
        shot = capture(recipe)
        diffraction = shot.capture.provenance["diffraction"]
        yield recipe, shot, recon.calibrate(dasim.calibration_captures(recipe.camera, diffraction=diffraction))
        progress((number + 1) / len(recipes))


def _entries(name: SetName, file: Path) -> tuple[_Entry, ...]:
    entries: tuple[_Entry, ...] = getattr(parse_toml(_Sets, file), name)
    return entries


def _recipe(entry: _Entry) -> Recipe:
    camera = dasim.cropped(dasim.load_camera(entry.camera), *SIZE_PX)
    if entry.scene == "random":
        # Both sets were fixed when objects of rooms floated by default.
        depth_cm = entry.depth_cm or RandomScenes().depth_cm
        spec = RandomScenes(floating=True, depth_cm=depth_cm)
        scene = dasim.random_scene(entry.seed, entry.number, spec, camera)
        exposure = random_exposure(entry.seed, entry.number, spec)
    else:
        scene, exposure = load_scene(entry.scene), Exposure()
    if entry.gain is not None:
        exposure = exposure.model_copy(update={"gain": entry.gain})
    scene = _lit(scene, entry.illuminant, entry.lux)
    return Recipe(entry.name, scene, dasim.focused(camera, scene), exposure)


def _lit(scene: Scene, illuminant: str | None, lux: float | None) -> Scene:
    """The scene with one illuminant in all lights, and with another sum of their illuminances."""
    total = sum(light.lux for light in scene.lights)
    factor = 1.0 if lux is None else lux / total
    lights = []
    for light in scene.lights:
        changes: dict[str, Any] = {"lux": light.lux * factor}
        if illuminant is not None and "illuminant" in type(light).model_fields:
            changes["illuminant"] = illuminant
        lights.append(light.model_copy(update=changes))
    return scene.model_copy(update={"lights": tuple(lights)})
