"""Building blocks of procedural meshes against volumes and rotations in closed form."""

from __future__ import annotations

import numpy as np
import pytest

from dasim.scene import shapes
from dasim.scene.procedural.triangles import ball, rotation_matrix, sheet, tube
from tests.support.solids import area_vectors, volume

ROUNDING = 1e-9  # double precision, summed over 1e5 faces


def test_ball_has_the_volume_and_normals_of_a_sphere():
    part = sheet(ball(64, 128), periodic=True)
    # A polyhedron of n steps inscribed in a sphere lacks about pi^2 / n^2 of it.
    assert volume(part) == pytest.approx(4 / 3 * np.pi, rel=2 * np.pi**2 / 64**2)
    assert np.sum(part.normals * part.vertices, axis=-1).min() > np.cos(np.pi / 64)


def test_closed_tube_has_the_volume_of_a_torus():
    angle = np.linspace(0, 2 * np.pi, 301)
    ring = np.stack([np.cos(angle), np.sin(angle), np.zeros_like(angle)], axis=-1)
    part = tube(ring, 0.1, 64, closed=True)
    assert volume(part) == pytest.approx(2 * np.pi**2 * 0.1**2, rel=2 * np.pi**2 / 64**2)
    assert np.abs(area_vectors(part).sum(axis=0)).max() < ROUNDING


def test_rotations_are_those_of_mesh_objects():
    item = {"shape": "mesh", "file": "procedural:rock", "name": "a", "material": "sand", "rotation_deg": (10, 20, 30)}
    matrix = shapes.placement(shapes.Mesh(**item))
    assert np.allclose(matrix[:3, :3], rotation_matrix(10, 20, 30), atol=ROUNDING)
