"""Simulated photographs shared by several claims, cached between runs by a fingerprint of all that they depend on.

Tested in tests/validation/claims/test_pictures.py and tests/dasim/base/test_fingerprint.py.
"""

from __future__ import annotations

import json
import shutil
import sys
from pathlib import Path
from typing import Literal

import dasim
from dasim.base import cache
from dasim.base.cache import cache_dir
from dasim.base.errors import InputError
from dasim.base.fingerprint import fingerprint, named_files, text_hash
from dasim.camera.noise import Exposure
from dasim.camera.specification import Camera
from dasim.files.captures import load_capture, load_truth
from dasim.render import backend
from dasim.scene.mitsuba_scene import MitsubaScene
from dasim.scene.specification import Scene
from dasim.simulation.exposure import Shot
from dasim.typing import Progress


def photographed(
    scene: Scene | MitsubaScene,
    camera: Camera,
    seed: int = 0,
    *,
    spp: int | Literal["auto"],
    exposure: Exposure | None = None,
    progress: Progress = lambda stage, share: None,
) -> Shot:
    """A simulated capture and its truth as their files hold them: 16-bit raw numbers, truth as 32-bit floats.

    The photograph is kept in the cache under the scene, the camera, the exposure, the seed and the samples, for as long
    as code, data, libraries and the renderer's variant stay the same.
    """
    assert isinstance(scene, Scene), "what decides a foreign scene is not in its description"
    exposure = exposure or Exposure()
    path = _place(scene, camera, exposure, seed, spp)
    earlier = _load(path)
    if earlier is not None:
        cache.used(path)
        return earlier
    shot = dasim.simulate(scene, camera, seed, spp=spp, exposure=exposure, progress=progress)
    earlier = _load(path)
    if earlier is not None:  # by another process meanwhile
        return earlier
    try:
        for old in path.parent.glob(f"{path.stem}.*"):
            shutil.rmtree(old, ignore_errors=True)
        dasim.save_capture(path, shot.capture, shot.truth)
        cache.bound(path.parent)
        return Shot(load_capture(path), load_truth(path))
    except (InputError, OSError) as error:
        print(f"note: a photograph cannot be kept: {error}", file=sys.stderr)
        return shot


def _load(path: Path) -> Shot | None:
    """A photograph from the cache; None where it is missing or damaged."""
    try:
        return Shot(load_capture(path), load_truth(path))
    except (InputError, OSError):
        return None


def _place(scene: Scene, camera: Camera, exposure: Exposure, seed: int, spp: int | str) -> Path:
    """Folder of a photograph: a name of what is photographed, and the fingerprint of what photographs."""
    described = scene.model_dump(mode="json", exclude={"folder"})
    parts = [json.dumps(described), camera.model_dump_json(), exposure.model_dump_json(), str(seed), str(spp)]
    what = text_hash([*parts, *named_files(described, scene.folder)])
    functions = (dasim.simulate, dasim.save_capture, dasim.load_truth)
    how = fingerprint(*functions, variant=backend.choose().variant, excluding=("cameras", "scenes"))
    return _folder() / f"{what}.{how}"


def forget() -> None:
    """Remove all photographs, so that they are simulated again."""
    shutil.rmtree(_folder(), ignore_errors=True)


def _folder() -> Path:
    return cache_dir() / "shots"
