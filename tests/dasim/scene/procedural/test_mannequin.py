"""The head of the mannequin has its size, symmetry and an opening at the neck only."""

from __future__ import annotations

import pytest

from dasim.scene import meshes
from dasim.scene.procedural.library import procedural


def test_head_is_one_unit_high_symmetric_and_around_its_middle():
    skin = procedural("figure-skin")
    assert skin.vertices[:, 1].min() == pytest.approx(-0.5, abs=0.02)
    front = skin.vertices[(skin.vertices[:, 2] < -0.15) & (skin.vertices[:, 1] < 0.6)]
    assert front[:, 1].max() == pytest.approx(0.5, abs=0.05)  # the chin
    assert skin.vertices[:, 0].max() == pytest.approx(-skin.vertices[:, 0].min(), abs=1e-3)
    assert 20_000 <= len(skin.faces) <= 60_000
    assert meshes.winding_number(skin.vertices[skin.faces]) == pytest.approx(1.0, abs=0.1)  # open at the neck
