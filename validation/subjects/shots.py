"""Photographs that several claims look at: taken once, kept between runs by the content of what decides them.

Tested in tests/validation/claims/test_pictures.py.
"""

from __future__ import annotations

import os
import shutil
import sys
from pathlib import Path
from typing import Literal

import dasim
from dasim.base.cache import cache_dir
from dasim.base.errors import InputError
from dasim.camera.noise import Exposure
from dasim.camera.specification import Camera
from dasim.files.captures import load_capture, load_truth
from dasim.render import backend
from dasim.scene.mitsuba_scene import MitsubaScene
from dasim.scene.specification import Scene
from dasim.simulation.simulate import Shot
from dasim.typing import Progress
from validation.gates import stored


def photographed(
    scene: Scene | MitsubaScene,
    camera: Camera,
    seed: int = 0,
    *,
    spp: int | Literal["auto"],
    exposure: Exposure | None = None,
    progress: Progress = lambda stage, share: None,
) -> Shot:
    """What :func:`dasim.simulate` gives, as it stands in its files: 16-bit raw numbers, truth of 32-bit floats.

    Kept in the cache under the scene, the camera, the seed and the samples, as long as the simulator, its data, its
    libraries and the renderer's variant are the same. A copy made by another process meanwhile is as good.
    """
    assert isinstance(scene, Scene), "what decides a foreign scene is not in its description"
    exposure = exposure or Exposure()
    what = stored.hashed([*(part.model_dump_json() for part in (scene, camera, exposure)), str(seed), str(spp)])
    path = _folder() / f"{what}.{stored.hashed(stored.simulator(backend.choose().variant))}"
    try:
        return Shot(load_capture(path), load_truth(path))
    except (InputError, OSError):
        pass  # none, or damaged: take it
    shot = dasim.simulate(scene, camera, seed, spp=spp, exposure=exposure, progress=progress)
    try:
        for old in _folder().glob(f"{what}.*"):
            shutil.rmtree(old, ignore_errors=True)
        partial = path.with_name(f"{path.name}-{os.getpid()}")
        dasim.save_capture(partial, shot.capture, shot.truth)
        if not path.exists():
            partial.rename(path)
        shutil.rmtree(partial, ignore_errors=True)
        return Shot(load_capture(path), load_truth(path))
    except (InputError, OSError) as error:
        print(f"note: a photograph is not kept: {error}", file=sys.stderr)
        return shot


def forget() -> None:
    """Take all photographs anew."""
    shutil.rmtree(_folder(), ignore_errors=True)


def _folder() -> Path:
    return cache_dir() / "shots"
