"""Lights of different spectra: which a scene has, what each adds along a path, and the pictures of several together."""

from __future__ import annotations

import numpy as np
import pytest

import dasim
from dasim.scene import specification as scenes
from dasim.spectra import grid, illuminants

SINGLE = 1e-4  # relative, of spectra in single precision
SUM_LIMIT = 0.005  # of a picture's mean: sampling noise of three pictures, which is common to all of a field's pixels
SIGMAS = 5.0
RESOLVED = 0.05  # of the mean: what five standard deviations must stay below
RAYS = 1 << 19

LAMP = {"kind": "lamp", "lux": 600.0, "position_cm": [-30, -40, -20], "target_cm": [0, 0, 40], "radius_cm": 6}
SKY = {"kind": "sky", "lux": 300.0, "illuminant": "D75", "distribution": "overcast"}
WALL = {"name": "wall", "shape": "plane", "size_cm": [90, 70], "position_cm": [0, 0, 45], "material": "wood-light"}
BALL = {"name": "ball", "shape": "sphere", "radius_cm": 5, "position_cm": [-7, 6, 34], "material": "cotton-red"}


def dome(illuminant: str) -> dict:
    return {"kind": "dome", "lux": 400.0, "illuminant": illuminant}


def lamp(illuminant: str) -> dict:
    return LAMP | {"illuminant": illuminant}


@pytest.fixture
def xml(tmp_path):
    """A Mitsuba scene: a wall before the camera, and the given emitters."""

    def make(emitters: str, **choices):
        wall = '<shape type="rectangle"><transform name="to_world"><rotate y="1" angle="180"/><translate z="1"/>'
        text = f'<scene version="3.0.0"><sensor type="perspective"/>{wall}</transform></shape>{emitters}</scene>'
        (tmp_path / "scene.xml").write_text(text)
        return dasim.load_scene(tmp_path / "scene.xml", **choices)

    return make


@pytest.mark.parametrize(
    ("lights", "expected"),
    [
        ([dome("D65")], [("D65",)]),
        ([dome("D65"), lamp("D65")], [("D65",), ("D65",)]),
        ([dome("D65"), lamp("F11")], [("F11",), ("D65",)]),
        ([dome("D55"), lamp("D65"), lamp("D55")], [("D65",), ("D55",), ("D55",)]),
        ([dome("F11"), SKY], [("F11", "D75")]),
        ([SKY, lamp("D75")], [("D75",), ("D75",)]),
    ],
)
def test_each_emitter_has_its_light(jit, loaded, make_scene, lights, expected):
    """Expectation: as many lights as there are illuminants, and each emitter's or layer's curve is its illuminant's."""
    from dasim.render import light_spectra

    result = light_spectra.lights_of(loaded(make_scene(WALL, lights=lights)))
    assert len(result.spectra) == len({name for names in expected for name in names})
    by_emitter = [tuple(result.spectra[light] for light in numbers) for _, numbers in result.emitters]
    assert sorted(map(len, by_emitter)) == sorted(map(len, expected))
    curves = {name: illuminants.illuminant(name) for names in expected for name in names}

    def name_of(curve) -> str:
        at_grid = np.interp(grid.WAVELENGTH_NM, light_spectra.FINE_NM, curve)
        errors = {name: np.abs(at_grid / at_grid.mean() - exact / exact.mean()).max() for name, exact in curves.items()}
        close = [name for name, error in errors.items() if error < SINGLE * curves[name].max() / curves[name].mean()]
        assert len(close) == 1
        return close[0]

    assert sorted(tuple(name_of(curve) for curve in numbers) for numbers in by_emitter) == sorted(expected)


def test_daylight_is_sun_and_sky(jit, loaded, make_scene):
    from dasim.render import light_spectra

    daylight = {"kind": "daylight", "lux": 1000.0, "elevation_deg": 30, "azimuth_deg": 100}
    assert len(light_spectra.lights_of(loaded(make_scene(WALL, lights=[daylight]))).spectra) == 2


def test_spectra_that_differ_smoothly_are_one(jit, loaded, make_scene):
    """Rationale: the nodes of the field hold the ratio of two blackbodies, so that one field is exact for both."""
    from dasim.render import light_spectra

    lights = [dome("blackbody-3000K"), lamp("blackbody-4000K")]
    assert len(light_spectra.lights_of(loaded(make_scene(WALL, lights=lights))).spectra) == 1


POINT = '<emitter type="point"><point name="position" x="0" y="0" z="-1"/>{}</emitter>'
CONSTANT = '<emitter type="constant">{}</emitter>'
TABLE = '<spectrum name="intensity" value="400:1, 545:1, 546:9, 547:1, 830:1"/>'


@pytest.mark.parametrize(
    ("emitters", "curves"),
    [
        (POINT.format(TABLE), ["line"]),
        (POINT.format(TABLE) + CONSTANT.format('<spectrum name="radiance" value="2"/>'), ["line", "even"]),
        (POINT.format('<rgb name="intensity" value="3, 1, 1"/>') + CONSTANT.format(""), ["F11", "D65"]),
        (POINT.format('<rgb name="intensity" value="3, 1, 1"/>'), ["F11"]),
    ],
)
def test_mitsuba_scenes_have_the_spectra_that_their_emitters_have(jit, xml, wide, emitters, curves):
    """Set-up: a table with a line of 2 nm, an even spectrum, and colours, which get the illuminant that is chosen.

    Expectation: these are the lights, and the common spectrum is the chosen illuminant only where that is the only one.
    """
    from dasim.render import light_spectra, translate

    scene = xml(emitters, illuminant="F11")
    world = translate.world(scene, wide())
    lights = light_spectra.lights_of(world.scene)
    nm = light_spectra.FINE_NM
    known = {name: np.interp(nm, grid.WAVELENGTH_NM, illuminants.illuminant(name)) for name in ("F11", "D65")}
    known |= {"line": np.interp(nm, [400, 545, 546, 547, 830], [1, 1, 9, 1, 1]), "even": np.ones_like(nm)}
    assert len(lights.spectra) == len(curves)
    total = light_spectra.total(scene, world.scene)
    for name in curves:
        if name == "D65":  # Mitsuba's own table
            continue
        errors = [np.abs(c / c.mean() - known[name] / known[name].mean()).max() for c in lights.spectra]
        assert min(errors) < SINGLE * known[name].max() / known[name].mean(), (name, errors)
    np.testing.assert_equal(bool(np.all(total == illuminants.illuminant("F11"))), curves == ["F11"])


@pytest.mark.slow
@pytest.mark.parametrize(
    "lights",
    [
        pytest.param([dome("D65"), lamp("F11")], id="dome and lamp"),
        pytest.param([SKY, dome("F11"), lamp("A")], id="sky, dome and lamp"),
    ],
)
def test_light_by_light_adds_up_to_mitsubas_path_tracer(jit, loaded, make_scene, lights):
    """Rationale: Mitsuba's own integrator knows nothing of lights that are kept apart.

    Set-up: rays from a place before a mirror, a glass ball, a matt ball and a wall, away from the lamp.
    Expectation: the sum over lights is Mitsuba's radiance at each of four wavelengths, within five of the standard
    deviations of both means; every light adds something, and the slots that no light has add nothing.
    """
    import drjit as dr
    import mitsuba as mi

    from dasim.render import light_spectra, transport
    from dasim.render.light_paths import radiance_by_light

    objects = [
        WALL,
        BALL,
        {"name": "mirror", "shape": "sphere", "radius_cm": 4, "position_cm": [7, 5, 30], "material": "chromium"},
        {"name": "lens", "shape": "sphere", "radius_cm": 3, "position_cm": [0, -6, 28], "material": "glass"},
    ]
    scene = loaded(make_scene(*objects, lights=lights))
    numbers = mi.load_dict({"type": "independent"})
    numbers.seed(5, RAYS)
    direction = mi.warp.square_to_uniform_hemisphere(numbers.next_2d())
    ray = mi.RayDifferential3f(mi.Ray3f(mi.Point3f(0, 0, 0.2), direction))
    ray.wavelengths = mi.Spectrum(436.0, 546.0, 640.0, 760.0)
    whole = transport.path_integrator().sample(scene, numbers, ray)[0]
    shares = light_spectra.lights_of(scene).shares()
    parts = radiance_by_light(scene, numbers, ray, mi.Bool(True), shares)
    assert len(parts) >= len(lights)
    means = [dr.mean(part[1]).numpy().item() for part in parts]
    assert min(means[: len(lights)]) > 0 and not any(means[len(lights) :])
    for k in range(4):
        theirs, ours = np.array(whole[k]), np.array(sum(part[k] for part in parts))
        limit = SIGMAS * np.sqrt((theirs.var() + ours.var()) / RAYS)
        assert abs(theirs.mean() - ours.mean()) < limit, k
        assert limit < RESOLVED * theirs.mean()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("first", "second"),
    [
        pytest.param([dome("D65")], [lamp("F11")], id="dome and lamp"),
        pytest.param([dome("F11")], [SKY], id="dome and sky"),
        pytest.param([SKY, lamp("D75")], [lamp("F11")], id="sky and lamps"),
    ],
)
def test_pictures_of_lights_add_up(jit, loaded, make_scene, wide, first, second):
    """Rationale: light adds. A picture under one spectrum needs one field, and is checked elsewhere.

    Expectation: the picture under both is the sum of the pictures under each, in every channel.
    """
    from dasim.render import passes

    camera = wide(48, 36, 15.0)

    def picture(lights):
        scene = make_scene(WALL, BALL, lights=lights)
        field = passes.irradiance_field(loaded(scene), camera, scenes.light_spectrum(scene), 0.0, 256, 1)
        assert field is not None and field.share > 0.5
        return passes.pinhole_pass(loaded(scene), camera, passes.Sampling(128, 2), field).mean(axis=(0, 1))

    both, parts = picture([*first, *second]), picture(first) + picture(second)
    np.testing.assert_allclose(both, parts, rtol=SUM_LIMIT)
