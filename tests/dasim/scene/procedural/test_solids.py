"""Solids with edges have the normals of their faces."""

from __future__ import annotations

import numpy as np
import pytest

from dasim.scene.procedural import library, solids


@pytest.mark.parametrize("name", sorted(solids.MESHES))
def test_solids_with_edges_have_normals_of_their_faces(name):
    part = library.procedural(name)
    a, b, c = (part.vertices[part.faces[:, corner]] for corner in range(3))
    across = np.cross(b - a, c - a)
    across /= np.linalg.norm(across, axis=-1, keepdims=True)
    assert part.normals[part.faces] == pytest.approx(np.repeat(across[:, None], 3, axis=1), abs=1e-6)
