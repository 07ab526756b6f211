"""Mitsuba scenes from other sources: light levels, and where lights stand."""

from __future__ import annotations

import gc
import subprocess
import sys

import cv2
import numpy as np
import pytest

import dasim
from dasim.base.errors import InputError
from dasim.render import backend
from dasim.spectra import illuminants, observer
from dasim.spectra.grid import WAVELENGTH_NM, integrate
from tests.support.exr import write_exr
from tests.support.foreign_scenes import ASLANT, wall

DEADLINE_S = 100.0  # of a process that imports, compiles and reads, on a busy computer
SINGLE = 1e-4  # relative: rays and shapes are single precision
LEVEL_LIMIT = 0.01  # relative, of a mean over many pixels: sampling noise of wavelengths


def test_light_and_grey_are_those_of_the_same_scene_in_toml(xml, make_scene, loaded, world, wide):
    """Set-up: a wall of reflectance 0.5 under an even light of D65, described both ways; a pinhole sees both.

    Expectation: the ratio of both is the documented one: an RGB light of luminance 1 is as bright as a spectrum of
    1 W m^-2 sr^-1 nm^-1 (683 lm/W times the integral of V), a dome of E lux has a luminance of E / pi.
    """
    from dasim.render import passes

    inside = '<bsdf type="diffuse"><spectrum name="reflectance" value="0.5"/></bsdf>'
    light = '<emitter type="constant"><rgb name="radiance" value="2"/></emitter>'
    foreign = world(xml(wall(inside, light)), wide()).scene
    ours = make_scene(
        {"name": "w", "shape": "plane", "size_cm": (9000, 9000), "position_cm": (0, 0, 400), "material": "half"},
        lights=[{"kind": "dome", "illuminant": "D65", "lux": 500.0}],
        materials={"half": {"kind": "spectrum", "points": [(400, 0.5), (830, 0.5)]}},
    )
    rates = [
        passes.pinhole_pass(s, wide(16, 12), passes.Sampling(64, 0)).mean(axis=(0, 1)) for s in (foreign, loaded(ours))
    ]
    cd_m2 = 2 * illuminants.MAX_LUMINOUS_EFFICACY_LM_W * integrate(observer.luminous_efficiency())
    np.testing.assert_allclose(rates[0] / rates[1], cd_m2 / (500 / np.pi), rtol=LEVEL_LIMIT)


@pytest.mark.parametrize(
    ("material", "light", "message_part"),
    [
        (
            '<bsdf type="conductor"><spectrum name="eta" value="1e30"/><spectrum name="k" value="1e30"/></bsdf>',
            "",
            "look at 'rectangle-1'",
        ),
        ("", '<emitter type="constant"><rgb name="radiance" value="1e38"/></emitter>', "of 192 pixels"),
        (
            '<bsdf type="normalmap"><texture type="bitmap" name="normalmap"><string name="filename" value="one.exr"/>'
            '</texture><bsdf type="diffuse"/></bsdf>',
            "",
            "does not render in Mitsuba",
        ),
    ],
)
def test_light_that_is_not_finite_or_not_rendered_is_one_line(
    xml, wide, renderer, tmp_path, material, light, message_part
):
    """Set-up: an index of refraction and light beyond single precision, a colour picture as a map of normals."""
    write_exr(tmp_path / "one.exr", np.ones((8, 16, 3), np.float32))
    with pytest.raises(InputError) as caught:
        dasim.simulate(xml(wall(material, light)), wide(16, 12), spp=2)
    assert message_part in str(caught.value) and "\n" not in str(caught.value)
    del caught
    gc.collect()  # Dr.Jit runs the code of all plugins that are alive: one that fails would fail the tests that follow


SHAPE = '<shape type="sphere"><float name="radius" value="0.5"/></shape>'


def pose_of_theirs(text: str):
    """Mitsuba's own scene, and the transform of camera axes (x right, y down) into its world."""
    import mitsuba as mi

    with backend.reading_threads():
        theirs = mi.load_string(text)
    look = np.array(theirs.sensors()[0].world_transform().matrix, dtype=float).reshape(4, 4)
    return theirs, look @ np.diag([-1.0, -1.0, 1.0, 1.0])


@pytest.mark.parametrize(
    "emitter",
    [
        '<emitter type="directional"><vector name="direction" x="1" y="-2" z="0.5"/>VALUE</emitter>',
        '<emitter type="directional"><transform name="to_world"><rotate x="1" y="1" angle="70"/></transform>'
        "VALUE</emitter>",
        '<emitter type="point"><point name="position" x="1" y="2" z="3"/>VALUE</emitter>',
        '<emitter type="point"><transform name="to_world"><translate x="1" y="2"/></transform>VALUE</emitter>',
        '<emitter type="spot"><float name="cutoff_angle" value="85"/>'
        '<transform name="to_world"><lookat origin="1,2,3" target="0,0,1" up="0,1,0"/></transform>'
        "VALUE</emitter>",
    ],
)
def test_lights_that_are_no_shapes_stand_where_mitsuba_puts_them(xml, world, wide, emitter):
    """Expectation: from a point of the scene, the direction towards the light and what it gives there (in W m^-2 at
    600 nm, in a scene whose unit is the metre and in one whose unit is 5 cm) are those of Mitsuba's own scene.
    """
    import drjit as dr
    import mitsuba as mi

    key = "irradiance" if "directional" in emitter else "intensity"
    text = f'<scene version="3.0.0">{ASLANT}{SHAPE}' + emitter.replace("VALUE", f'<spectrum name="{key}" value="3"/>')
    text += "</scene>"
    theirs, to_world = pose_of_theirs(text)
    place = np.array([0.1, -0.2, 1.1, 1.0])
    rows = []
    for scene, matrix, unit in (
        (theirs, to_world, 1.0),
        (world(xml(text), wide()).scene, np.eye(4), 1.0),
        (world(xml(text, unit_cm=5), wide()).scene, np.eye(4), 0.05),
    ):
        si = dr.zeros(mi.SurfaceInteraction3f)
        at = matrix @ (place * [unit, unit, unit, 1.0])
        si.p, si.wavelengths = mi.Point3f(*at[:3].tolist()), mi.Spectrum(600.0)
        found, value = scene.sample_emitter_direction(si, mi.Point2f(0.5, 0.5), False)
        towards = np.linalg.inv(matrix)[:3, :3] @ np.ravel(found.d)
        rows.append([*towards, np.ravel(value)[0]])
    assert rows[0][3] > 0
    np.testing.assert_allclose(rows[1], rows[0], rtol=SINGLE, atol=1e-6)
    np.testing.assert_allclose(rows[2], rows[0], rtol=SINGLE, atol=1e-6)


READ_ON_ONE_THREAD = """
import cv2, numpy as np
import dasim
from dasim.render import backend, translate
backend.activate(backend.choose())
backend.use_threads(1)
scene = dasim.load_scene("scene.xml")
translate.world(scene, dasim.cropped(dasim.load_camera("da-mobile"), 32, 24))
"""


def test_an_environment_map_is_read_on_one_thread(jit, tmp_path):
    """Rationale: workers of datasets render on one thread, and Mitsuba's EXR reader waits for ever for a second one."""
    write_exr(tmp_path / "sky.exr", np.ones((128, 256, 3), np.float32))
    light = '<emitter type="envmap"><string name="filename" value="sky.exr"/></emitter>'
    (tmp_path / "scene.xml").write_text(f'<scene version="3.0.0">{ASLANT}{SHAPE}{light}</scene>')
    command = [sys.executable, "-c", READ_ON_ONE_THREAD]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, timeout=DEADLINE_S, check=False)
    assert done.returncode == 0, done.stderr


def test_environment_map_keeps_its_directions_and_gets_the_illuminant(xml, world, wide, jit, tmp_path):
    """Set-up: a smooth coloured map, turned, seen in 40 directions. Expectation: at 555 nm and 800 nm ours is the map's
    luminance times the illuminant that is as bright as one of 1 everywhere; tints are gone (the map has several).
    """
    import drjit as dr
    import mitsuba as mi

    from dasim.render.foreign.lights import one_unit

    rng = np.random.default_rng(5)
    small = rng.uniform(0.2, 1.0, (5, 8, 3)).astype(np.float32)
    picture = cv2.resize(np.concatenate([small, small[:, :1]], axis=1), (256, 128), interpolation=cv2.INTER_LINEAR)
    picture[:, -1] = picture[:, 0]
    write_exr(tmp_path / "sky.exr", picture)
    light = (
        '<emitter type="envmap"><string name="filename" value="sky.exr"/><float name="scale" value="2"/>'
        '<transform name="to_world"><rotate y="1" angle="50"/></transform></emitter>'
    )
    text = f'<scene version="3.0.0">{ASLANT}{SHAPE}{light}</scene>'
    ours = world(xml(text, illuminant="A"), wide()).scene
    _, to_world = pose_of_theirs(text.replace("sky.exr", str(tmp_path / "sky.exr")))
    directions = rng.normal(size=(40, 3))
    directions /= np.linalg.norm(directions, axis=-1, keepdims=True)
    # Mitsuba's map: its middle is +z, its top +y, u runs with atan2(x, -z).
    turn = np.radians(50)
    own = np.array([[np.cos(turn), 0, np.sin(turn)], [0, 1, 0], [-np.sin(turn), 0, np.cos(turn)]])
    x, y, z = (directions @ to_world[:3, :3].T @ own).T
    u, v = (np.arctan2(x, -z) / (2 * np.pi)) % 1, np.arccos(np.clip(y, -1, 1)) / np.pi
    luminance = 2 * (picture @ [0.2126, 0.7152, 0.0722])
    expected = luminance[np.clip((v * 127).round().astype(int), 0, 127), (u * 255).round().astype(int)]
    for wavelength in (556, 800):
        si = dr.zeros(mi.SurfaceInteraction3f, len(directions))
        si.wi = mi.Vector3f(-directions.T.astype(np.float32))
        si.wavelengths = mi.Spectrum(float(wavelength))
        found = np.array(ours.environment().eval(si)[0])
        at = one_unit("A")[WAVELENGTH_NM == wavelength][0]
        np.testing.assert_allclose(found, expected * at, rtol=0.05)  # nearest texel here, half a row there
