"""Meshes by formula: closed, the right way out, of the size they say, the same in every run."""

from __future__ import annotations

import numpy as np
import pytest

from dasim.base.errors import InputError
from dasim.scene import meshes, specification
from dasim.scene.procedural.library import BODIES, MESHES, procedural
from dasim.scene.procedural.triangles import ball, sheet, tube, turned

ROUNDING = 1e-9  # double precision, summed over 1e5 faces
SEEDS = (0, 1, 2, 3)


def _areas(part) -> np.ndarray:
    a, b, c = (part.vertices[part.faces[:, corner]] for corner in range(3))
    return np.cross(b - a, c - a) / 2


def _volume(part) -> float:
    return float(np.sum(part.vertices[part.faces[:, 0]] * _areas(part)) / 3)


def test_ball_has_the_volume_and_normals_of_a_sphere():
    part = sheet(ball(64, 128), round_about=True)
    # A polyhedron of n steps inscribed in a sphere lacks about pi^2 / n^2 of it.
    assert _volume(part) == pytest.approx(4 / 3 * np.pi, rel=2 * np.pi**2 / 64**2)
    assert np.sum(part.normals * part.vertices, axis=-1).min() > np.cos(np.pi / 64)


def test_closed_tube_has_the_volume_of_a_torus():
    angle = np.linspace(0, 2 * np.pi, 301)
    ring = np.stack([np.cos(angle), np.sin(angle), np.zeros_like(angle)], axis=-1)
    part = tube(ring, 0.1, 64, closed=True)
    assert _volume(part) == pytest.approx(2 * np.pi**2 * 0.1**2, rel=2 * np.pi**2 / 64**2)
    assert np.abs(_areas(part).sum(axis=0)).max() < ROUNDING


@pytest.mark.parametrize("name", BODIES)
@pytest.mark.parametrize("seed", SEEDS)
def test_bodies_are_closed_outside_out_and_of_unit_size(name, seed):
    """The area vectors of a closed surface add up to nothing, and its volume is positive where it is right way out."""
    part = procedural(f"{name}:{seed}")
    assert np.abs(_areas(part).sum(axis=0)).max() < ROUNDING
    assert _volume(part) > 0
    low, high = part.vertices.min(axis=0), part.vertices.max(axis=0)
    assert (high - low).max() == pytest.approx(1.0) and np.abs(low + high).max() < ROUNDING


@pytest.mark.parametrize("name", sorted(MESHES))
def test_all_meshes_are_whole(name):
    part = procedural(name)
    assert part.faces.max() < len(part.vertices) == len(part.uv) == len(part.normals)
    assert all(np.isfinite(values).all() for values in part)
    areas = _areas(part)
    solid = np.linalg.norm(areas, axis=-1) > 1e-12
    # A corner's normal lies on the side of its faces, but at creases of a few.
    same = np.einsum("ij,ij->i", areas, part.normals[part.faces].mean(axis=1))[solid] > 0
    assert same.mean() > 0.98
    assert np.abs(np.linalg.norm(part.normals, axis=-1) - 1).max() < 1e-6 or name in ("superellipsoid", "twisted-box")


@pytest.mark.parametrize("name", sorted(name for name in MESHES if not name.startswith("figure-")))
def test_meshes_are_the_same_every_time(name):
    again = MESHES[name](0)
    assert all(np.array_equal(first, second) for first, second in zip(procedural(name), again, strict=True))


@pytest.mark.parametrize("name", BODIES)
def test_seeds_draw_other_proportions(name):
    first, second = procedural(f"{name}:1"), procedural(f"{name}:2")
    assert first.vertices.shape != second.vertices.shape or not np.allclose(first.vertices, second.vertices)


def test_head_is_one_unit_high_symmetric_and_around_its_middle():
    skin = procedural("figure-skin")
    assert skin.vertices[:, 1].min() == pytest.approx(-0.5, abs=0.02)
    front = skin.vertices[(skin.vertices[:, 2] < -0.15) & (skin.vertices[:, 1] < 0.6)]
    assert front[:, 1].max() == pytest.approx(0.5, abs=0.05)  # the chin
    assert skin.vertices[:, 0].max() == pytest.approx(-skin.vertices[:, 0].min(), abs=1e-3)
    assert 20_000 <= len(skin.faces) <= 60_000
    assert meshes.turns_around_origin(skin.vertices[skin.faces]) == pytest.approx(1.0, abs=0.1)  # open at the neck


def test_turns_are_a_mesh_objects():
    item = {"shape": "mesh", "file": "procedural:rock", "name": "a", "material": "sand", "rotation_deg": (10, 20, 30)}
    placed = specification.placement(specification.Mesh(**item))
    assert np.allclose(placed[:3, :3], turned(10, 20, 30), atol=ROUNDING)


@pytest.mark.parametrize(
    ("name", "said"),
    [("rokc", "did you mean 'rock'"), ("rock:-1", "whole number"), ("rock:", "whole number"), ("rock:x", "seed")],
)
def test_what_there_is_not_is_refused(name, said, tmp_path):
    text = (
        'name = "x"\n[[lights]]\nkind = "dome"\nilluminant = "D65"\nlux = 9\n[[objects]]\nname = "thing"\n'
        f'shape = "mesh"\nfile = "procedural:{name}"\nmaterial = "sand"\nposition_cm = [0, 0, 30]\n'
    )
    (tmp_path / "x.toml").write_text(text)
    with pytest.raises(InputError, match=said) as caught:
        specification.load_scene(tmp_path / "x.toml")
    assert "object 'thing'" in str(caught.value) and "\n" not in str(caught.value)
