"""Procedural meshes: closed, with faces outwards, of unit size, the same in every run."""

from __future__ import annotations

import numpy as np
import pytest

from dasim.base.errors import InputError
from dasim.scene import loading
from dasim.scene.procedural.library import BODIES, MESHES, procedural
from tests.support.solids import area_vectors, volume

ROUNDING = 1e-9  # double precision, summed over 1e5 faces
SEEDS = (0, 1, 2, 3)


@pytest.mark.parametrize("name", BODIES)
@pytest.mark.parametrize("seed", SEEDS)
def test_bodies_are_closed_face_outwards_and_have_unit_size(name, seed):
    """The area vectors of a closed surface add up to nothing, and its volume is positive where it is right way out."""
    part = procedural(f"{name}:{seed}")
    assert np.abs(area_vectors(part).sum(axis=0)).max() < ROUNDING
    low, high = part.vertices.min(axis=0), part.vertices.max(axis=0)
    assert 0 < volume(part) < np.prod(high - low)
    assert (high - low).max() == pytest.approx(1.0) and np.abs(low + high).max() < ROUNDING


@pytest.mark.parametrize("name", sorted(MESHES))
def test_all_meshes_are_whole(name):
    part = procedural(name)
    assert part.faces.max() < len(part.vertices) == len(part.uv) == len(part.normals)
    assert all(np.isfinite(values).all() for values in part)
    areas = area_vectors(part)
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


@pytest.mark.parametrize(
    ("name", "message"),
    [("rokc", "did you mean 'rock'"), ("rock:-1", "whole number"), ("rock:", "whole number"), ("rock:x", "seed")],
)
def test_unknown_procedural_meshes_are_refused(name, message, tmp_path):
    text = (
        'name = "x"\n[[lights]]\nkind = "dome"\nilluminant = "D65"\nlux = 9\n[[objects]]\nname = "thing"\n'
        f'shape = "mesh"\nfile = "procedural:{name}"\nmaterial = "sand"\nposition_cm = [0, 0, 30]\n'
    )
    (tmp_path / "x.toml").write_text(text)
    with pytest.raises(InputError, match=message) as caught:
        loading.load_scene(tmp_path / "x.toml")
    assert "object 'thing'" in str(caught.value) and "\n" not in str(caught.value)
