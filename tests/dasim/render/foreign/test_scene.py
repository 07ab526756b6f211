"""Mitsuba scenes from other sources: pose, units, near-infrared colours, light levels, notes and refusals."""

from __future__ import annotations

import gc
import subprocess
import sys

import cv2
import numpy as np
import pytest
import trimesh

import dasim
from dasim.base.errors import InputError
from dasim.camera import radiometry
from dasim.scene.mitsuba_scene import MitsubaScene
from dasim.spectra import illuminants
from dasim.spectra.grid import WAVELENGTH_NM, integrate

DEADLINE_S = 100.0  # of a process that imports, compiles and reads, on a busy computer
SINGLE = 1e-4  # relative: rays and shapes are single precision
LEVEL_LIMIT = 0.01  # relative, of a mean over many pixels: sampling noise of wavelengths
POSE = '<lookat origin="1, 2, 4" target="0.1, 0.2, -0.3" up="0.2, 1, 0"/>'
RED, BLUE = (0.6, 0.05, 0.05), (0.05, 0.1, 0.7)

ROOM = """<scene version="3.0.0">
  <default name="red" value="0.6, 0.05, 0.05"/>
  <integrator type="path"/>
  <sensor type="perspective"><float name="fov" value="40"/>
    <transform name="to_world">POSE</transform>
    <film type="hdrfilm"><integer name="width" value="48"/><integer name="height" value="36"/></film>
  </sensor>
  <bsdf type="twosided" id="red wall"><bsdf type="diffuse"><rgb name="reflectance" value="$red"/></bsdf></bsdf>
  <bsdf type="diffuse" id="blue wall"><rgb name="reflectance" value="0.05, 0.1, 0.7"/></bsdf>
  <bsdf type="diffuse" id="grey"><spectrum name="reflectance" value="0.5"/></bsdf>
  <shape type="rectangle" id="left"><transform name="to_world"><rotate y="1" angle="90"/><translate x="-1"/></transform>
    <ref id="red wall"/></shape>
  <shape type="rectangle" id="back"><transform name="to_world"><translate z="-1"/></transform>
    <ref id="blue wall"/></shape>
  <shape type="sphere" id="ball"><point name="center" x="0.3" y="-0.2" z="0.1"/><float name="radius" value="0.3"/>
    <ref id="grey"/></shape>
  <shape type="shapegroup" id="group"><shape type="cube"><ref id="grey"/></shape></shape>
  <shape type="instance"><ref id="group"/>
    <transform name="to_world"><scale value="0.1"/><translate x="0.5" y="0.5"/></transform></shape>
  <shape type="ply" id="tent"><string name="filename" value="parts/tent.ply"/><ref id="grey"/></shape>
  <shape type="rectangle" id="lamp">
    <transform name="to_world"><rotate x="1" angle="90"/><translate y="1.5"/></transform>
    <emitter type="area"><rgb name="radiance" value="10, 9, 8"/></emitter></shape>
  <emitter type="point"><point name="position" x="0" y="0" z="2"/><rgb name="intensity" value="3"/></emitter>
</scene>""".replace("POSE", POSE)


def wall(inside: str = "", light: str = "", z: float = -4) -> str:
    """A wall across the view of a camera that looks along -z, and whatever else."""
    light = light or '<emitter type="constant"><spectrum name="radiance" value="1"/></emitter>'
    return (
        '<scene version="3.0.0"><sensor type="perspective"/>'
        '<shape type="rectangle"><transform name="to_world"><scale value="50"/><rotate y="1" angle="180"/>'
        f'<translate z="{-z}"/></transform>{inside}</shape>{light}</scene>'
    )


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


def test_scene_is_seen_from_its_sensors_pose(xml, world, wide, renderer):
    """Rationale: Mitsuba itself knows where its sensor looks, so its own ray for each pixel is the reference.

    Set-up: a room with shapes of all kinds, a sensor that looks aslant and is rolled, our field of view given to it.
    Expectation: the same shape at every pixel but few on outlines; depth is z of what Mitsuba's ray meets.
    """
    import mitsuba as mi

    from dasim.render import truth

    camera = wide(focus_m=3.0)
    scene = xml(ROOM)
    found = world(scene, camera)
    ours = truth.geometry(found.scene, camera)
    assert found.objects[:3] == ["left", "back", "ball"] and found.objects[4:] == ["tent", "lamp"]
    assert found.materials == ["red wall", "blue wall", "grey", "default"]
    np.testing.assert_array_equal(found.material_number, [0, 1, 2, 3, 3, 3, 4])
    text = ROOM.replace('"fov" value="40"', f'"fov" value="{truth.field_of_view_deg(camera)}"')
    text = text.replace("parts/", str(scene.file.parent) + "/parts/")
    theirs = mi.load_string(text)
    integrator = mi.load_dict({"type": "aov", "aovs": "p:position,t:depth"})
    film = {"type": "hdrfilm", "width": 48, "height": 36, "rfilter": {"type": "box"}}
    look = np.array(theirs.sensors()[0].world_transform().matrix, dtype=float).reshape(4, 4)
    sensor = mi.load_dict(
        {
            "type": "perspective",
            "fov": truth.field_of_view_deg(camera),
            "to_world": mi.ScalarTransform4f(look),
            "film": film,
            "sampler": {"type": "stratified", "sample_count": 1, "jitter": False},
        }
    )
    values = np.array(mi.render(theirs, sensor=sensor, integrator=integrator, spp=1), dtype=float)[..., -4:]
    depth = np.where(values[..., 3] > 0, (values[..., :3] - look[:3, 3]) @ look[:3, 2], np.nan)
    both = ~np.isnan(depth) & ~np.isnan(ours.depth_m)
    assert np.count_nonzero(np.isnan(depth) != np.isnan(ours.depth_m)) <= 5 and both.sum() > 800
    close = np.isclose(ours.depth_m[both], depth[both], rtol=SINGLE)
    assert np.count_nonzero(~close) <= 5, "pixel centres on outlines"
    assert set(np.unique(ours.object_id)) >= {1, 2, 3, 4, 5}


@pytest.mark.parametrize(("unit_cm", "metres"), [(100, 4.0), (2.5, 0.1)])
def test_depth_is_in_metres_by_the_scenes_unit(xml, world, wide, unit_cm, metres):
    from dasim.render import truth

    found = truth.geometry(world(xml(wall(), unit_cm=unit_cm), wide()).scene, wide())
    np.testing.assert_allclose(found.depth_m, metres, rtol=SINGLE)
    np.testing.assert_allclose(found.normal, np.broadcast_to([0, 0, -1], found.normal.shape), atol=1e-6)


def reflected(scene, directions, wavelengths_nm) -> np.ndarray:
    """Reflectance of what rays from the lens centre meet, [ray, wavelength], from the scattering function."""
    import mitsuba as mi

    rows = []
    for direction in directions:
        ray = mi.Ray3f(mi.Point3f(0.0), mi.Vector3f(*(np.array(direction) / np.linalg.norm(direction)).tolist()))
        row = []
        for wavelength in wavelengths_nm:
            ray.wavelengths = mi.Spectrum(float(wavelength))
            si = scene.ray_intersect(ray)
            value = si.bsdf(mi.RayDifferential3f(ray)).eval(mi.BSDFContext(), si, si.wi)
            row.append(np.ravel(value)[0] / np.abs(np.ravel(si.wi)[2]) * np.pi)
        rows.append(row)
    return np.array(rows)


@pytest.mark.parametrize("rule", ["print", "dyed", "achromatic"])
def test_rgb_surfaces_have_the_rules_spectrum_and_nothing_of_rgb_upsampling(xml, world, wide, rule):
    """Expectation: red and blue walls reflect what the rule's spectra say at 450 to 820 nm. Achromatic at 800 nm is
    the colours' luminance; prints and dyes differ there by little, whatever the colour (RGB upsampling: by far).
    """
    from dasim.render.foreign.colours import spectrum_of

    nm = (450, 550, 650, 740, 800, 820)
    found = []
    for colour in (RED, BLUE):
        inside = f'<bsdf type="diffuse"><rgb name="reflectance" value="{colour[0]}, {colour[1]}, {colour[2]}"/></bsdf>'
        scene = world(xml(wall(inside), near_infrared=rule), wide())
        curve = np.interp(nm, WAVELENGTH_NM, spectrum_of(colour, rule))
        (seen,) = reflected(scene.scene, [(0, 0, 1)], nm)
        np.testing.assert_allclose(seen, curve, atol=1e-5)
        assert any(f"rule '{rule}'" in note for note in scene.notes)
        found.append(seen)
    if rule == "achromatic":
        luminance = np.array([RED, BLUE]) @ [0.2126, 0.7152, 0.0722]
        np.testing.assert_allclose([found[0][4], found[1][4]], luminance, atol=2e-3)
    assert found[0][0] < found[1][0] and found[0][2] > 2 * found[1][2], "in the visible they are red and blue"


def test_picture_lies_where_mitsuba_puts_it(xml, world, wide, jit, tmp_path):
    """Set-up: a grey picture on a wall, scaled by to_uv and repeated. Mitsuba's own grey upsampling is flat, and so is
    the achromatic rule's, so both reflect the same at every wavelength.

    Expectation: the same reflectance at 30 places, in the near-infrared too.
    """
    import mitsuba as mi

    rng = np.random.default_rng(0)
    picture = cv2.resize(rng.integers(30, 220, (4, 5), dtype=np.uint8), (40, 32), interpolation=cv2.INTER_LINEAR)
    cv2.imwrite(str(tmp_path / "grey.png"), cv2.merge([picture] * 3))
    inside = (
        '<bsdf type="diffuse"><texture type="bitmap" name="reflectance"><string name="filename" value="grey.png"/>'
        '<transform name="to_uv"><scale x="12" y="9"/></transform></texture></bsdf>'
    )
    text = wall(inside)
    ours = world(xml(text), wide()).scene
    theirs = mi.load_string(text.replace("grey.png", str(tmp_path / "grey.png")))
    directions = np.column_stack([rng.uniform(-0.8, 0.8, (30, 2)), np.ones(30)])
    # Theirs looks along z with x left and y up.
    (expected,) = reflected_at_once(theirs, directions * [-1, -1, 1], 550)
    assert np.ptp(expected) > 0.2
    found = reflected_at_once(ours, directions, 550, 700)
    np.testing.assert_allclose(found[0], expected, atol=1e-4)
    np.testing.assert_allclose(found[1], expected, atol=1e-3)  # the basis sums to 1, but for rounding


def reflected_at_once(scene, directions, *wavelengths_nm) -> list[np.ndarray]:
    """``reflected`` of many rays in a JIT variant, [wavelength][ray]."""
    import mitsuba as mi

    unit = directions / np.linalg.norm(directions, axis=-1, keepdims=True)
    ray = mi.RayDifferential3f(mi.Ray3f(mi.Point3f(0.0), mi.Vector3f(unit.T.astype(np.float32))))
    found = []
    for wavelength in wavelengths_nm:
        ray.wavelengths = mi.Spectrum(float(wavelength))
        si = scene.ray_intersect(ray)
        value = si.bsdf(ray).eval(mi.BSDFContext(), si, si.wi)
        found.append(np.array(value[0]) / np.abs(np.array(si.wi.z)) * np.pi)
    return found


def test_scalar_pictures_become_blends_or_their_mean(wide, tmp_path):
    """Set-up: in a process of its own, ``scalar_spectral``: a picture, half black and half white, on a matt wall and
    on a rough plastic. Expectation: the matt one shows both halves, the plastic its mean, and the notes say so.
    """
    import subprocess
    import sys

    picture = np.zeros((2, 8, 3), np.uint8)
    picture[:, 4:] = 255
    cv2.imwrite(str(tmp_path / "half.png"), picture)
    texture = '<texture type="bitmap" name="KEY"><string name="filename" value="half.png"/></texture>'
    for name, key in (("diffuse", "reflectance"), ("roughplastic", "diffuse_reflectance")):
        (tmp_path / f"{name}.xml").write_text(wall(f'<bsdf type="{name}">{texture.replace("KEY", key)}</bsdf>'))
    program = (
        "import sys, dasim\nfrom dasim.render import backend\nbackend.activate(backend.choose('scalar_spectral'))\n"
        "from dasim.render import translate\nimport numpy as np, mitsuba as mi\n"
        "for name in sys.argv[1:]:\n"
        "    world = translate.world(dasim.load_scene(name), dasim.load_camera('da-mobile'))\n"
        "    row = []\n"
        "    for x in (-4.0, 4.0):\n"
        "        ray = mi.Ray3f(mi.Point3f(0.0), mi.Vector3f(*(np.array([x, 0, 4]) / np.sqrt(x * x + 16)).tolist()))\n"
        "        ray.wavelengths = mi.Spectrum(550.0)\n"
        "        si = world.scene.ray_intersect(ray)\n"
        "        row.append(np.ravel(si.bsdf(mi.RayDifferential3f(ray)).eval(mi.BSDFContext(), si, si.wi))[0])\n"
        "    print(abs(row[0] - row[1]) > 0.1, any('their mean colour' in note for note in world.notes))\n"
    )
    names = [str(tmp_path / f"{name}.xml") for name in ("diffuse", "roughplastic")]
    done = subprocess.run([sys.executable, "-c", program, *names], capture_output=True, text=True, timeout=120)
    assert done.stdout.split() == ["True", "False", "False", "True"], done.stderr[-1000:]


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
    cd_m2 = 2 * illuminants.MAX_LUMINOUS_EFFICACY_LM_W * integrate(illuminants.luminous_efficiency())
    np.testing.assert_allclose(rates[0] / rates[1], cd_m2 / (500 / np.pi), rtol=LEVEL_LIMIT)


@pytest.mark.parametrize(
    "value", ['<rgb name="intensity" value="3"/>', '<spectrum name="intensity" value="400:2, 830:4"/>']
)
def test_a_picture_does_not_depend_on_the_scenes_unit(xml, world, wide, value):
    """Rationale: what a surface receives of a point is I / r^2 in the scene's unit, whatever that is called.

    Expectation: a wall lit by a point light has the same picture at 1 m and at 10 cm a unit.
    """
    from dasim.render import passes

    light = f'<emitter type="point"><point name="position" x="1" y="0" z="1"/>{value}</emitter>'
    rates = []
    for unit_cm in (100, 10):
        scene = world(xml(wall("", light), unit_cm=unit_cm), wide()).scene
        rates.append(passes.pinhole_pass(scene, wide(16, 12), passes.Sampling(16, 0)))
    assert rates[0].min() > 0
    np.testing.assert_allclose(rates[1], rates[0], rtol=1e-3)


def test_notes_say_what_was_done_and_what_was_not(xml, wide, renderer):
    """Expectation: the capture says in one line each what was replaced, and that no media are there."""
    inside = (
        '<bsdf type="diffuse"><spectrum name="reflectance" value="400:0.1, 700:0.5"/></bsdf>'
        '<medium type="homogeneous" name="interior"><float name="albedo" value="0.5"/></medium>'
    )
    light = '<emitter type="constant"><rgb name="radiance" value="2, 1, 1"/></emitter>'
    shot = dasim.simulate(xml(wall(inside, light), illuminant="A"), wide(16, 12), spp=2)
    notes = shot.capture.provenance["notes"]
    for part in ("sensor 'perspective'", "ends at 700 nm", "media: not supported", "the spectrum of A at the same"):
        assert sum(part in note for note in notes) == 1, (part, notes)
    assert all("\n" not in note for note in notes)
    assert shot.capture.illuminant == "A"
    assert shot.capture.provenance["scene"]["name"] == "scene"


def test_defaults_and_files_beside_the_scene_are_found_from_anywhere(xml, world, wide, monkeypatch, tmp_path_factory):
    monkeypatch.chdir(tmp_path_factory.mktemp("elsewhere"))
    found = world(xml(ROOM), wide())
    assert "tent" in found.objects
    assert xml(ROOM).focus_cm is None and dasim.focused(wide(), xml(ROOM)) == wide()


def test_many_instances_are_copies_of_their_group(xml, world, wide):
    """Expectation: each of 12 instances is an object of its own, and shows as many shapes as its group has."""
    spheres = '<shape type="sphere"><float name="radius" value="0.1"/></shape>' * 2
    instances = "".join(
        f'<shape type="instance" id="pair {k}"><ref id="pair"/>'
        f'<transform name="to_world"><translate x="{k / 10}" z="-1"/></transform></shape>'
        for k in range(12)
    )
    text = wall().replace("</scene>", f'<shape type="shapegroup" id="pair">{spheres}</shape>{instances}</scene>')
    found = world(xml(text), wide())
    assert found.objects[1:] == [f"pair {k}" for k in range(12)]
    assert sum(shape.id().startswith("object_") for shape in found.scene.shapes()) == 1 + 2 * 12


@pytest.mark.parametrize(
    ("text", "noted"),
    [
        ('<bsdf type="diffuse"><spectrum name="reflectance" value="2"/></bsdf>', "clipped to 1"),
        ('<bsdf type="diffuse"><spectrum name="reflectance" value="400:1.5, 830:1.9"/></bsdf>', "clipped to 1"),
        ('<bsdf type="diffuse"><rgb name="reflectance" value="2, 2, 2"/></bsdf>', "clipped to 1"),
    ],
)
def test_no_surface_reflects_more_than_it_receives(xml, world, wide, text, noted):
    """Expectation: a wall of reflectance 2 is as bright as one of reflectance 1, and that is noted."""
    import drjit as dr
    import mitsuba as mi

    def brightness(inside: str) -> float:
        found = world(xml(wall(inside)), wide())
        notes.append(found.notes)
        si = found.scene.ray_intersect(mi.Ray3f([0, 0, 0], [0, 0, 1], 0, mi.Spectrum(600.0)))
        context = mi.BSDFContext()
        value = si.bsdf().eval(context, si, mi.Vector3f(0, 0, 1))
        return float(np.ravel(value)[0]) * dr.pi

    notes: list[list[str]] = []
    assert brightness(text) == pytest.approx(1.0, abs=0.01)
    assert any(noted in line for line in notes[0])


def test_files_of_spectra_are_found_beside_the_scene(xml, world, wide, monkeypatch, tmp_path, tmp_path_factory):
    (tmp_path / "half.spd").write_text("400 0.5\n830 0.5\n")
    scene = xml(wall('<bsdf type="diffuse"><spectrum name="reflectance" filename="half.spd"/></bsdf>'))
    monkeypatch.chdir(tmp_path_factory.mktemp("elsewhere"))
    assert world(scene, wide()).objects


def test_rough_metal_with_a_pattern_of_roughness_has_finite_light(xml, world, wide, jit, tmp_path):
    """Rationale: a smooth mesh shows some rays its back, where a pattern of roughness has no value and a sampled
    direction is NaN with the weight 0. Such samples must not count.

    Set-up: a coarse mesh of a ball with a checkerboard of roughness, of amorphous carbon, before even light.
    Expectation: every pixel is finite, and the mean of all is that of Mitsuba's own path tracer.
    """
    from dasim.render import passes, stock, wavelengths

    trimesh.creation.icosphere(subdivisions=1, radius=1.0).export(tmp_path / "ball.ply")
    carbon = (
        '<bsdf type="roughconductor"><string name="material" value="a-C"/><texture name="alpha" type="checkerboard">'
        '<float name="color0" value="0.3"/><float name="color1" value="0.5"/></texture></bsdf>'
    )
    shape = f'<shape type="ply"><string name="filename" value="ball.ply"/>{carbon}</shape>'
    light = '<emitter type="constant"><spectrum name="radiance" value="1"/></emitter>'
    scene = xml(f'<scene version="3.0.0">{ASLANT}{shape}{light}</scene>')
    camera = wide(48, 36)
    ours = world(scene, camera).scene
    sampling = passes.Sampling(64, 0)
    rate = passes.pinhole_pass(ours, camera, sampling)
    assert np.isfinite(rate).all()
    theirs = stock.pinhole_pass(ours, camera, wavelengths.pinhole_responses(camera), sampling)
    theirs *= radiometry.relative_illumination(camera)[..., None]
    np.testing.assert_allclose(rate.mean(axis=(0, 1)), theirs.mean(axis=(0, 1)), rtol=LEVEL_LIMIT)


def test_sizes_beyond_likely_units_are_noted(xml, world, wide):
    found = world(xml(wall(), unit_cm=1e4), wide())
    assert any("1e+04 m large" in line and "unit_cm is 10000" in line for line in found.notes), found.notes


@pytest.mark.parametrize(
    ("text", "message_part"),
    [
        (ROOM.replace("</scene>", ""), ["does not load", "scene.xml"]),
        ("rubbish", ["does not load"]),
        (ROOM.replace("parts/tent", "parts/none"), ["none.ply"]),
        (ROOM.replace('type="ply"', 'type="plyx"'), ["plyx"]),
        (ROOM.replace('<ref id="grey"/></shape>', '<ref id="gray"/></shape>'), ["gray"]),
        (wall().replace('<sensor type="perspective"/>', ""), ["has no sensor"]),
        (wall("", "<integrator type='path'/>"), ["no lights"]),
        (wall("", '<emitter type="sunsky"/>'), ["'sunsky'", "720 nm", "constant"]),
        (
            wall(
                '<bsdf type="diffuse"><texture type="bitmap" name="reflectance">'
                '<string name="filename" value="no.png"/></texture></bsdf>'
            ),
            ["no.png"],
        ),
        (wall('<bsdf type="diffuse"><rgb name="reflectance" value="nan, 0, 0"/></bsdf>'), ["diffuse.reflectance"]),
        (wall("", '<emitter type="constant"><rgb name="radiance" value="-1,-1,-1"/></emitter>'), ["constant.radiance"]),
        (wall("", '<emitter type="point"><spectrum name="intensity" value="-1"/></emitter>'), ["point.intensity"]),
        (wall().replace("</scene>", '<shape type="instance"/></scene>'), ["no shapegroup"]),
        (
            wall("", '<emitter type="envmap"><string name="filename" value="nan.exr"/></emitter>'),
            ["nan.exr of a light"],
        ),
        (wall().replace('<scale value="50"/>', '<scale value="nan"/>'), ["object 'rectangle-1'", "not finite"]),
        (wall(z=-0.0005), ["object 'rectangle-1'", "reaches into the lens", "unit_cm is 100"]),
        (
            wall().replace(
                "</scene>", '<shape type="sphere"><point name="center" value="1e38, 0, 1e308"/></shape></scene>'
            ),
            ["object 'sphere-2'", "reaches to infinity"],
        ),
    ],
)
def test_what_is_wrong_is_one_line(xml, world, wide, tmp_path, text, message_part):
    import mitsuba as mi

    mi.Bitmap(np.full((8, 16, 3), np.nan, np.float32)).write(str(tmp_path / "nan.exr"))
    with pytest.raises(InputError) as caught:
        world(xml(text), wide())
    message = str(caught.value)
    assert "\n" not in message and "scene.xml" in message
    for part in message_part:
        assert part in message, message


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
    import mitsuba as mi

    mi.Bitmap(np.ones((8, 16, 3), np.float32)).write(str(tmp_path / "one.exr"))
    with pytest.raises(InputError) as caught:
        dasim.simulate(xml(wall(material, light)), wide(16, 12), spp=2)
    assert message_part in str(caught.value) and "\n" not in str(caught.value)
    del caught
    gc.collect()  # Dr.Jit runs the code of all plugins that are alive: one that fails would fail the tests that follow


@pytest.mark.parametrize("material", ["Li", "MgO"])
def test_metals_continue_beyond_their_tables(xml, world, wide, material):
    """Rationale: Mitsuba's tables of lithium and magnesium oxide end at 751 and 768 nm, and their index is zero beyond:
    a perfect mirror.

    Expectation: at normal incidence and 820 nm the reflectance is that of the last value of the table,
    |(n - 1) / (n + 1)|^2, and a note says so.
    """
    import mitsuba as mi

    index = complex(*(mi.spectrum_from_file(str(mi.file_resolver().resolve(f"data/ior/{material}.{part}.spd")))[1][-1]
                      for part in ("eta", "k")))  # fmt: skip
    inside = f'<bsdf type="conductor"><string name="material" value="{material}"/></bsdf>'
    found = world(xml(wall(inside)), wide())
    ray = mi.RayDifferential3f(mi.Ray3f(mi.Point3f(0.0), mi.Vector3f(0.0, 0.0, 1.0)))
    ray.wavelengths = mi.Spectrum(820.0)
    si = found.scene.ray_intersect(ray)
    _, weight = si.bsdf(ray).sample(mi.BSDFContext(), si, 0.5, mi.Point2f(0.5))
    assert np.ravel(weight)[0] == pytest.approx(abs((index - 1) / (index + 1)) ** 2, rel=SINGLE)
    assert any(f"spectrum {material}.eta covers" in note for note in found.notes)


@pytest.mark.parametrize(
    ("choices", "message_part"),
    [
        ({"unit_cm": 0}, "unit_cm"),
        ({"near_infrared": "rgb"}, "near_infrared"),
        ({"illuminant": "D66"}, "illuminant 'D66'"),
    ],
)
def test_choices_are_checked(xml, choices, message_part):
    with pytest.raises(InputError, match=message_part):
        xml(ROOM, **choices)


def test_choices_are_for_mitsuba_scenes_only(tmp_path):
    with pytest.raises(InputError, match="unit_cm is for Mitsuba scenes"):
        dasim.load_scene("desk", unit_cm=1)
    with pytest.raises(InputError, match="no such file"):
        dasim.load_scene(tmp_path / "none.xml")


# --- lights ---------------------------------------------------------------------------------------

ASLANT = '<sensor type="perspective"><transform name="to_world">' + POSE + "</transform></sensor>"
SHAPE = '<shape type="sphere"><float name="radius" value="0.5"/></shape>'


def pose_of_theirs(text: str):
    """Mitsuba's own scene, and the transform of camera axes (x right, y down) into its world."""
    import mitsuba as mi

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
    import mitsuba as mi

    mi.Bitmap(np.ones((128, 256, 3), np.float32)).write(str(tmp_path / "sky.exr"))
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
    mi.Bitmap(picture).write(str(tmp_path / "sky.exr"))
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
