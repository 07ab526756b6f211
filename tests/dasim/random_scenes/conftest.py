"""Random scenes that many tests look at."""

from __future__ import annotations

import pytest

import dasim
from tests.support.drawn_scenes import DRAWS, SEED, Measured, measure, things


@pytest.fixture(scope="package")
def samples() -> list[tuple[dasim.Scene, list[Measured]]]:
    """Scenes with all of their objects, each measured while its meshes are loaded."""
    scenes_drawn = (dasim.random_scene(SEED, index) for index in range(DRAWS))
    return [(scene, [measure(item, scene) for item in things(scene)]) for scene in scenes_drawn]


@pytest.fixture(scope="package")
def all_scenes(samples) -> list[dasim.Scene]:
    return [scene for scene, _ in samples]


@pytest.fixture(scope="package")
def measured(samples) -> list[list[Measured]]:
    return [layout for _, layout in samples]
