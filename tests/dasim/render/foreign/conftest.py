"""Mitsuba scenes from other sources: read from a file, and as the renderer's."""

from __future__ import annotations

import pytest
import trimesh

import dasim
from dasim.scene.mitsuba_scene import MitsubaScene


@pytest.fixture
def xml(tmp_path):
    (tmp_path / "parts").mkdir()
    trimesh.creation.cone(0.2, 0.4).apply_translation((-0.5, 0.3, 0)).export(tmp_path / "parts" / "tent.ply")

    def make(text: str, **choices) -> MitsubaScene:
        (tmp_path / "scene.xml").write_text(text)
        found = dasim.load_scene(tmp_path / "scene.xml", **choices)
        assert isinstance(found, MitsubaScene)
        return found

    return make


@pytest.fixture(scope="module")
def world(renderer):
    from dasim.render import translate

    return translate.world
