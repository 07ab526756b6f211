"""Texture splitting: other points of a cell against rays that are traced there, and means against plain rays."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from dasim.render import splitting
from dasim.spectra.illuminants import illuminant

CELLS = 4.0
PX_PER_M = 300.0
BOARD = {"shape": "plane", "size_cm": (60, 60), "material": "stone"}
STONE = {"kind": "blend", "image": "skimage:gravel", "repeat": [12, 12], "dark": "soil", "bright": "ceramic-white"}
LAMP = {
    "kind": "lamp",
    "illuminant": "D65",
    "lux": 300,
    "position_cm": (-20, 20, -20),
    "target_cm": (0, 0, 50),
    "radius_cm": 1,
}
DOME = {"kind": "dome", "illuminant": "D65", "lux": 300}


def _rays(place_px, on_lens):
    """What :func:`splitting.uv_shifts` reads of a pass and its rays, which focus at one metre."""
    import drjit as dr
    import mitsuba as mi

    place = mi.Point2f(*(mi.Float(side.astype(np.float32)) for side in place_px.T))
    origin = mi.Point3f(*(mi.Float(side.astype(np.float32)) for side in on_lens.T), 0.0)
    film = place - mi.Point2f(16, 12)
    slope = film / PX_PER_M - mi.Point2f(origin.x, origin.y)
    ray = mi.RayDifferential3f(mi.Ray3f(origin, dr.normalize(mi.Vector3f(slope.x, slope.y, 1.0))))
    ray.wavelengths = mi.Spectrum(550.0)
    shared = SimpleNamespace(pinhole=lambda at: at, axis=mi.Point2f(16, 12), px_per_m=mi.Float(PX_PER_M))
    return shared, SimpleNamespace(place=place, cells=mi.Float(CELLS), film=film, ray=ray)


def _uv(scene, ray):
    si = scene.ray_intersect(ray)
    return si, np.array(si.uv).reshape(2, -1).T, np.array(si.is_valid())


def test_points_are_where_parallel_rays_end(jit):
    """Set-up: rays through a lens of 4 mm at two slanted walls, one behind the other, whose edge crosses the frame.

    Expectation: texture coordinates of all points are those where rays through their places on the sensor end, from the
    same place on the lens and on the same wall; all places are in the ray's own cell.
    """
    import mitsuba as mi

    transform = mi.ScalarTransform4f
    walls = {
        name: {"type": "rectangle", "to_world": transform().translate(at).rotate([0, 1, 0], turn).scale(0.4)}
        for name, at, turn in (("far", [0, 0, 1.2], 170), ("near", [0.4, 0, 0.8], 215))
    }
    scene = mi.load_dict({"type": "scene"} | walls)
    random = np.random.default_rng(0)
    place = random.uniform([0, 0], [32, 24], (4096, 2))
    lens = random.uniform(-0.002, 0.002, (4096, 2))
    shared, rays = _rays(place, lens)
    si, own, _ = _uv(scene, rays.ray)
    cell = np.floor(place * CELLS)
    compared = 0
    for shift, found in zip(splitting.OTHERS, splitting.uv_shifts(shared, rays, si), strict=True):
        there = (cell + (place * CELLS - cell + shift) % 1) / CELLS
        other, uv, hit = _uv(scene, _rays(there, lens)[1].ray)
        same = hit & (np.array(si.prim_index) == np.array(other.prim_index)) & np.array(other.shape == si.shape)
        moved = np.array(found).reshape(2, -1).T
        np.testing.assert_allclose((own + moved)[same], uv[same], atol=2e-5)
        compared += same.sum()
        assert np.abs(moved[same]).mean() > 1e-4
    assert compared > 8000


def test_points_beyond_a_border_or_a_horizon_are_left_out(jit):
    """Expectation: no shift of points beyond the border of the texture, nor where a plane is seen from its side."""
    import mitsuba as mi

    transform = mi.ScalarTransform4f
    random = np.random.default_rng(0)
    place, lens = random.uniform([0, 0], [32, 24], (4096, 2)), np.zeros((4096, 2))
    shared, rays = _rays(place, lens)
    card = mi.load_dict(
        {"type": "scene", "a": {"type": "rectangle", "to_world": transform().translate([0, 0, 1]).scale(0.0203)}}
    )
    si, own, hit = _uv(card, rays.ray)
    shifts = splitting.uv_shifts(shared, rays, si)
    at = np.stack([own + np.array(shift).reshape(2, -1).T for shift in shifts])[:, hit]
    assert (at >= 0).all() and (at <= 1).all()
    assert (np.abs(at - own[hit]).max(axis=-1) == 0).mean() > 0.01
    low = transform().translate([0, 1e-4, 1]).rotate([1, 0, 0], 90).scale(0.9)
    si, own, hit = _uv(mi.load_dict({"type": "scene", "a": {"type": "rectangle", "to_world": low}}), rays.ray)
    moved = np.array(splitting.uv_shifts(shared, rays, si)[0]).reshape(2, -1).T[hit]
    assert (np.abs(moved).max(axis=-1) == 0).mean() > 0.9


@pytest.mark.parametrize("light", [DOME, LAMP], ids=["dome", "lamp"])
def test_means_are_those_of_plain_rays_with_less_noise(jit, loaded, make_scene, wide, monkeypatch, light):
    """Set-up: a slanted board of gravel, much finer than the pixels, and the edge of another one; under a dome, and
    under a lamp; 12 pictures with splitting and 12 without.

    Expectation: block means differ by chance alone, and noise is less than two thirds.
    """
    from dasim.render import passes

    far = BOARD | {"name": "far", "position_cm": (0, 0, 60), "rotation_deg": (50, 0, 0)}
    near = BOARD | {"name": "near", "position_cm": (31, 0, 30)}
    scene = loaded(make_scene(far, near, lights=[light], materials={"stone": STONE}))
    camera = wide()
    field = passes.irradiance_field(scene, camera, illuminant("D65"), 0.0, 64, 7)

    def pictures(seeds):
        return np.array(
            [passes.pinhole_pass(scene, camera, passes.Sampling(16, seed), field)[..., 1] for seed in seeds]
        )

    ours = pictures(range(12))
    monkeypatch.setattr(splitting, "OTHERS", ())
    plain = pictures(range(50, 62))
    blocks = [stack.reshape(12, 9, 4, 12, 4).mean(axis=(2, 4)) for stack in (ours, plain)]
    error = np.sqrt(sum(block.var(axis=0, ddof=1) / len(block) for block in blocks))
    lit = error > 0  # all but the lamp's shadow of the other board
    assert lit.mean() > 0.9
    z = ((blocks[0].mean(axis=0) - blocks[1].mean(axis=0)) / np.where(lit, error, 1.0))[lit]
    assert np.sqrt(np.mean(z**2)) < 1.3
    assert abs(z.mean()) < 4 / np.sqrt(z.size)
    assert np.median(ours.std(axis=0)) < 2 / 3 * np.median(plain.std(axis=0))
