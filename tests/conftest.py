"""Fixtures and settings of all tests: number of threads, cameras, scenes from plain data, the renderer."""

# ruff: noqa: E402  (numbers of threads are set before libraries are imported)

from __future__ import annotations

import os
import sys
import tempfile

# Small matrix products gain nothing from several threads, and idle threads spin, which slows a busy computer tenfold.
for _name in ("OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_name, "1")
# Processes of pytest-xdist share the cores: each renders and computes on its part of them.
WORKERS = int(os.environ.get("PYTEST_XDIST_WORKER_COUNT", "1"))
THREADS = max(1, (os.cpu_count() or 1) // WORKERS)
if WORKERS > 1:
    os.environ.setdefault("NUMBA_NUM_THREADS", str(THREADS))

from functools import lru_cache
from pathlib import Path

import cv2
import numpy as np
import pytest

from dasim.base.cache import cache_dir
from dasim.base.errors import InputError
from dasim.base.toml import parse
from dasim.camera import specification as cameras
from dasim.camera.specification import Camera
from dasim.materials import patterns
from dasim.render import backend, shared_kernels
from dasim.scene.procedural import library as procedural_meshes
from dasim.scene.specification import Scene
from tests.support.shared import FOLDER

# Tests with a cache folder of their own find the kernels that were compiled before.
os.environ.setdefault("DRJIT_CACHE_DIR", str(cache_dir() / "kernels"))
# Tests render many small scenes, whose kernels are on disk: the plugins that scenes share would only cost them time.
shared_kernels.FEW_SCENES = 10**9
# They need the same meshes and patterns again and again.
procedural_meshes._mesh_of = lru_cache(64)(procedural_meshes._mesh_of.__wrapped__)
patterns._image = lru_cache(64)(patterns._image.__wrapped__)
REFERENCE = Path(__file__).parents[2] / "shared" / "reference"


def pytest_configure(config):
    """Create the folder that the processes of this run share; they inherit the environment variable with its name."""
    if WORKERS > 1 or getattr(config.option, "numprocesses", None) is None or FOLDER in os.environ:
        return
    folder = tempfile.TemporaryDirectory(prefix="dasim-tests-")
    os.environ[FOLDER] = folder.name
    config.add_cleanup(folder.cleanup)


@pytest.fixture(scope="session")
def reference():
    """Function that reads a measured curve by name, as {column: values}; skips the test where the file is missing."""

    def read(name: str) -> dict[str, np.ndarray]:
        path = REFERENCE / f"{name}.csv"
        if not path.is_file():
            pytest.skip(f"measured data {path.name} is missing")
        lines = [line for line in path.read_text().splitlines() if line and not line.startswith("#")]
        values = np.array([[float(item) for item in line.split(",")] for line in lines[1:]])
        return dict(zip(lines[0].split(","), values.T, strict=True))

    return read


@pytest.fixture(scope="module", autouse=True)
def threads():
    """Reset the number of threads for each module, because datasets set it to one."""
    cv2.setNumThreads(THREADS)
    if "drjit" in sys.modules:
        backend.use_threads(THREADS)


@pytest.fixture(scope="session")
def da_mobile() -> Camera:
    return cameras.load_camera("da-mobile")


@pytest.fixture(scope="session")
def wide(da_mobile):
    """Function that makes a camera with the lens of da-mobile and a coarse sensor: a wide view in few pixels."""

    def make(width: int = 48, height: int = 36, pitch_um: float = 50.0, focus_m: float = 0.4) -> Camera:
        data = da_mobile.model_dump()
        data["sensor"] |= {"width_px": width, "height_px": height, "pixel_pitch_um": pitch_um}
        data["lens"] |= {"focus_distance_m": focus_m}
        return parse(Camera, data, "wide camera")

    return make


DOME = {"kind": "dome", "illuminant": "A", "lux": 500.0}
# Behind the lens plane, so that it illuminates surfaces that face the camera and is never visible itself.
LAMP = {
    "kind": "lamp",
    "illuminant": "D65",
    "lux": 1000.0,
    "position_cm": [0, -30, -60],
    "target_cm": [0, 0, 20],
    "radius_cm": 5,
}


@pytest.fixture(scope="session")
def make_scene():
    """Function that makes a scene from its objects (plain data), by default under a dome."""

    def make(*objects: dict, lights=(DOME,), folder: Path = Path("."), **others) -> Scene:
        data = {"name": "test", "lights": list(lights), "objects": list(objects), "folder": folder, **others}
        return parse(Scene, data, "test scene")

    return make


@pytest.fixture(scope="session")
def lamp() -> dict:
    return LAMP


@pytest.fixture(scope="session")
def renderer() -> str:
    """Name of the fastest variant that works, which is activated in this process."""
    choice = backend.choose()
    backend.activate(choice)
    backend.use_threads(THREADS)
    return choice.variant


@pytest.fixture(scope="session")
def loaded(renderer):
    """Function that translates a scene to Mitsuba."""
    import mitsuba as mi

    from dasim.render import translate

    return lambda scene: mi.load_dict(translate.scene_dict(scene), optimize=False)


@pytest.fixture(scope="session")
def jit(renderer) -> str:
    """Name of the variant of this process; skips the test for the scalar variant, which has no wave-optical blur."""
    if renderer.startswith("scalar"):
        pytest.skip("only scalar_spectral works on this computer, which has no wave-optical blur")
    return renderer


@pytest.fixture(scope="session")
def jit_variant() -> str:
    """Name of a JIT variant that works, for tests that start a process of their own."""
    for name in ("llvm_ad_spectral", "cuda_ad_spectral"):
        try:
            return backend.choose(name).variant
        except InputError:
            continue
    pytest.skip("no JIT variant works on this computer")
