"""Light straight from lamps: solid angles against closed forms, and the means of plain sampling with less noise."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from dasim.render import lamps
from dasim.spectra.illuminants import illuminant

WALL = {"name": "wall", "shape": "plane", "size_cm": (400, 400), "position_cm": (0, 0, 40), "material": "grey-card"}
# Its shadow is narrower than a cell of the grid.
WIRE = {"name": "wire", "shape": "cylinder", "radius_cm": 0.2, "height_cm": 60, "position_cm": (3, 0, 33)}
LAMP = {"kind": "lamp", "illuminant": "D65", "lux": 300, "position_cm": (-40, 0, 0), "target_cm": (0, 0, 40)}
PANEL = {"kind": "panel", "illuminant": "D65", "lux": 900, "position_cm": (60, -40, -10), "target_cm": (0, 0, 40)}
DOME = {"kind": "dome", "illuminant": "D65", "lux": 300}


@pytest.fixture
def passes(jit):
    from dasim.render import passes

    return passes


@pytest.fixture
def field_of(passes):
    def field(scene, camera, seed=7):
        return passes.irradiance_field(scene, camera, illuminant("D65"), 0.0, 16, seed)

    return field


def _on_axis(field):
    """Projected solid angle of the first lamp at the node nearest to the axis."""
    columns = field.shape[1]
    x, y = (round(-start / 3.0) for start in field.start_px)
    return np.array(field.lamps.whole)[y * columns + x]


def test_projected_solid_angle_of_a_disc(field_of, make_scene, loaded, wide):
    """Expectation: pi r^2 / (r^2 + h^2) of a disc straight ahead."""
    lamp = LAMP | {"position_cm": (0, 0, -20), "radius_cm": 10}
    field = field_of(loaded(make_scene(WALL, lights=[lamp])), wide())
    assert _on_axis(field) == pytest.approx(np.pi * 10**2 / (10**2 + 60**2), rel=1e-3)


def test_projected_solid_angle_of_a_rectangle(field_of, make_scene, loaded, wide):
    """Expectation: four times the closed form of a rectangle with a corner straight ahead and sides X h and Y h."""
    panel = PANEL | {"position_cm": (0, 0, -20), "size_cm": (60, 30)}
    field = field_of(loaded(make_scene(WALL, lights=[panel])), wide())
    x, y = 30 / 60, 15 / 60
    by_x, by_y = np.hypot(1, x), np.hypot(1, y)
    corner = (x / by_x * np.arctan(y / by_x) + y / by_y * np.arctan(x / by_y)) / 2
    assert _on_axis(field) == pytest.approx(4 * corner, rel=1e-3)


def _pictures(passes, scene, camera, field, seeds):
    return np.array([passes.pinhole_pass(scene, camera, passes.Sampling(16, seed), field)[..., 1] for seed in seeds])


def _z(first, second):
    """Difference of the means of two stacks of pictures over its standard error, in blocks of 4 x 4 pixels."""
    blocks = [stack.reshape(len(stack), 9, 4, 12, 4).mean(axis=(2, 4)) for stack in (first, second)]
    error = np.sqrt(sum(block.var(axis=0, ddof=1) / len(block) for block in blocks))
    return (blocks[0].mean(axis=0) - blocks[1].mean(axis=0)) / error


@pytest.fixture
def wire(make_scene, loaded):
    return loaded(
        make_scene(
            WALL,
            WIRE | {"material": "grey-card"},
            lights=[LAMP | {"radius_cm": 1}, PANEL | {"size_cm": (60, 60)}, DOME],
        )
    )


def test_means_are_those_of_plain_sampling_with_less_noise(passes, field_of, wire, wide):
    """Rationale: a shadow narrower than a cell of the grid is one that no node sees.

    Set-up: a wall, a thin wire before it, a small lamp and a large one; 12 pictures with the grid and 12 without.
    Expectation: block means differ by chance alone; where the wire casts no shadow, noise is less than a quarter.
    """
    camera = wide()
    field = field_of(wire, camera)
    ours = _pictures(passes, wire, camera, field, range(12))
    plain = _pictures(passes, wire, camera, replace(field, lamps=None), range(50, 62))
    z = _z(ours, plain)
    assert np.sqrt(np.mean(z**2)) < 1.3
    assert abs(z.mean()) < 4 / np.sqrt(z.size)
    assert ours.std(axis=0)[:, 35:43].mean() < plain.std(axis=0)[:, 35:43].mean() / 4


def test_what_the_nodes_see_changes_no_mean(passes, field_of, wire, wide):
    """Expectation: with half of what the nodes see, means are the same; with 3 % more of the whole lamp, others."""
    camera = wide()
    field = field_of(wire, camera)
    plain = _pictures(passes, wire, camera, replace(field, lamps=None), range(50, 62))
    half = replace(field, lamps=replace(field.lamps, seen=field.lamps.seen / 2))
    assert np.sqrt(np.mean(_z(_pictures(passes, wire, camera, half, range(12)), plain) ** 2)) < 1.3
    larger = replace(field.lamps, whole=field.lamps.whole * 1.03, seen=field.lamps.seen * 1.03)
    wrong = _pictures(passes, wire, camera, replace(field, lamps=larger), range(12))
    assert np.sqrt(np.mean(_z(wrong, plain) ** 2)) > 1.6


def test_lamps_in_doubt_are_sampled_several_times(passes, field_of, wire, wide, monkeypatch):
    """Rationale: among leaves few cells of the grid know a lamp, and the place on it makes most of the noise.

    Set-up: the wall, its lamps in doubt everywhere, sampled once and ``SPLIT`` times.
    Expectation: means are the same, the variance falls by a third or more; the frame's share of cells
    that know a lamp decides.
    """
    camera = wide()
    assert set(np.array(field_of(wire, camera).lamps.samples)) == {1}
    monkeypatch.setattr(lamps, "CLEAR", 2.0)
    split = field_of(wire, camera)
    assert np.array(split.lamps.samples).tolist() == [lamps.SPLIT] * 2 + [1] * (lamps.MOST_EMITTERS - 2)
    doubt = replace(split.lamps, usable=split.lamps.usable * 0)
    often = _pictures(passes, wire, camera, replace(split, lamps=doubt), range(12))
    once = _pictures(
        passes, wire, camera, replace(split, lamps=replace(doubt, samples=doubt.samples * 0 + 1)), range(50, 62)
    )
    assert np.sqrt(np.mean(_z(often, once) ** 2)) < 1.3
    assert once.var(axis=0)[:, 35:43].mean() > often.var(axis=0)[:, 35:43].mean() * 1.5


def test_their_number_does_not_depend_on_the_samples(jit):
    """Rationale: if a sample without light ended the sampling of its lamp, light would be lost.

    Set-up: a cube that shines on all sides; samples on sides that are turned away bring no light. A panel, which faces
    a point with all of its samples or with none, would not tell.
    Expectation: sampled once or twice, a point receives as much light on average.
    """
    import drjit as dr
    import mitsuba as mi

    transform, count = mi.ScalarTransform4f, 2**16
    scene = mi.load_dict({
        "type": "scene",
        "lamp": {
            "type": "cube",
            "to_world": transform().translate([0.5, 0, 2]),
            "emitter": {"type": "area", "radiance": {"type": "uniform", "value": 1.0}},
        },
        "wall": {"type": "rectangle", "to_world": transform().scale(5), "bsdf": {"type": "diffuse"}},
    })  # fmt: skip
    ray = mi.RayDifferential3f(mi.Ray3f(mi.Point3f(dr.opaque(mi.Float, 2.0, count), 0, 1), mi.Vector3f(0, 0, -1)))
    ray.wavelengths = mi.Spectrum(*lamps.PROBE_NM)
    si = scene.ray_intersect(ray)
    none, table = mi.UInt32(dr.zeros(mi.UInt32, count)), dr.zeros(mi.Float, lamps.MOST_EMITTERS)
    cell = lamps.Cell(none, none, mi.Point2f(0.0), mi.UInt32(1), mi.Bool(True))
    rows = np.arange(count) / count
    place = mi.Point2f(mi.Float(np.random.default_rng(0).permutation(rows)), mi.Float(rows))
    means, spread = [], 0.0
    for samples in (1, 2):
        numbers = mi.UInt32([samples] * lamps.MOST_EMITTERS)
        grid = lamps.Grid(table, table, mi.UInt32(table), numbers, mi.UInt32(1), mi.UInt32(1))
        chosen, none_known = lamps.chosen(scene), mi.Bool(dr.zeros(mi.Bool, count))
        even = lamps.Even(*(none_known,) * 3, *(mi.Spectrum(0.0),) * 2)
        light = lamps.light(scene, chosen, si.bsdf(ray), si, place, si.is_valid(), even, (grid, cell))
        values = np.array(light[0])
        means.append(values.mean())
        spread = max(spread, values.std() / np.sqrt(count))
    assert spread < 0.01 * means[0]
    assert abs(means[1] - means[0]) < 5 * spread


def test_of_many_lamps_each_ray_draws_one(passes, field_of, make_scene, loaded, wide, monkeypatch):
    """Expectation: one lamp more than every ray samples, and there is no grid; the picture is the same."""
    monkeypatch.setattr(lamps, "MOST_EMITTERS", 8)
    lights = [LAMP | {"position_cm": (-40 + 10 * k, -30, 0), "radius_cm": 1, "lux": 50 + 20 * k} for k in range(9)]
    scene, camera = loaded(make_scene(WALL, lights=lights)), wide()
    field = field_of(scene, camera)
    assert field.lamps is None
    drawn = _pictures(passes, scene, camera, field, range(12))
    monkeypatch.setattr(lamps, "MOST_EMITTERS", 16)
    z = _z(drawn, _pictures(passes, scene, camera, field_of(scene, camera), range(50, 62)))
    assert np.sqrt(np.mean(z**2)) < 1.3
    assert abs(z.mean()) < 4 / np.sqrt(z.size)
