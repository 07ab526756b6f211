"""Mitsuba scenes from other sources: pose, units, notes and refusals."""

from __future__ import annotations

import numpy as np
import pytest

import dasim
from dasim.base.errors import InputError
from tests.support.exr import write_exr
from tests.support.foreign_scenes import ROOM, wall

SINGLE = 1e-4  # relative: rays and shapes are single precision


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
    write_exr(tmp_path / "nan.exr", np.full((8, 16, 3), np.nan, np.float32))
    with pytest.raises(InputError) as caught:
        world(xml(text), wide())
    message = str(caught.value)
    assert "\n" not in message and "scene.xml" in message
    for part in message_part:
        assert part in message, message


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
