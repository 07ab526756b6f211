"""Scene files: wrong input and its messages, and the placement of objects."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

import dasim
from dasim.base.errors import InputError
from dasim.scene import loading, shapes
from dasim.scene import specification as scenes

GOOD = """
name = "mine"
focus_cm = 40
[[lights]]
kind = "dome"
illuminant = "D65"
lux = 500
[materials.pattern]
kind = "blend"
image = "skimage:brick"
dark = "soil"
bright = "sand"
[[objects]]
name = "wall"
shape = "plane"
size_cm = [50, 40]
position_cm = [0, 0, 40]
material = "pattern"
[[objects]]
name = "ball"
shape = "sphere"
radius_cm = 2
position_cm = [1, 0, 20]
material = "brick"
"""
MESH = '[[objects]]\nname = "thing"\nshape = "mesh"\nfile = "thing.obj"\nposition_cm = [0, 0, 20]\nmaterial = "brick"\n'
RIGID = 1e-12  # double precision


def load(folder, text):
    path = folder / "mine.toml"
    path.write_text(text)
    return loading.load_scene(path)


def refusal(folder, text) -> str:
    with pytest.raises(InputError) as caught:
        load(folder, text)
    message = str(caught.value)
    assert "\n" not in message and "mine.toml" in message, message
    return message


def test_good_scene_and_bundled_ones_load(tmp_path):
    scene = load(tmp_path, GOOD)
    assert [item.name for item in scene.objects] == ["wall", "ball"]
    assert scene.folder == tmp_path.resolve()
    assert "desk" in loading.scene_names()
    for name in loading.scene_names():
        assert loading.load_scene(name).objects


@pytest.mark.parametrize(
    ("old", "new", "message_part"),
    [
        ("lux = 500", "lux = 500\ncolor = 3", ["lights.0", "color: unknown key"]),
        ("focus_cm = 40", "focus_m = 0.4", ["focus_m: unknown key"]),
        ("radius_cm = 2", "radius = 2", ["objects.ball", "radius_cm: is missing", "radius: unknown key"]),
        ('shape = "sphere"', 'shape = "ball"', ["objects.ball: shape 'ball' is unknown; allowed are plane, disc"]),
        ('kind = "dome"', 'kind = "star"', ["lights.0: kind 'star' is unknown; allowed are dome, lamp"]),
        ('kind = "blend"', 'kind = "photo"', ["materials.pattern", "'photo'", "'print', 'dyed', 'achromatic'"]),
        ('kind = "blend"', 'kind = "paint"', ["materials.pattern: kind 'paint' is unknown; allowed are", "coated"]),
        (
            'material = "brick"',
            'material = "glass-pain"',
            ["material 'glass-pain' is unknown", "did you mean 'glass-pane'"],
        ),
        (
            'material = "brick"',
            'material = "bricks"',
            ["object 'ball'", "material 'bricks' is unknown", "brick", "pattern"],
        ),
        ('bright = "sand"', 'bright = "snad"', ["material 'pattern'", "'snad'", "did you mean 'sand'"]),
        ('illuminant = "D65"', 'illuminant = "F99"', ["lights.0 (dome)", "illuminant 'F99'", "did you mean 'F9'"]),
        ('"skimage:brick"', '"no.png"', ["material 'pattern'", "no.png", "no such file"]),
        ('"skimage:brick"', '"skimage:no"', ["material 'pattern'", "skimage:no", "does not ship"]),
        ('"skimage:brick"', '"mine.toml"', ["material 'pattern'", "cannot be read as a picture"]),
        ('"skimage:brick"', '"skimage:brick"\nrepeat = [0, 1]', ["materials.pattern", "repeat"]),
        ("lux = 500", "lux = nan", ["lights.0", "lux"]),
        ("lux = 500", "lux = 0", ["lights.0", "lux"]),
        ("position_cm = [0, 0, 40]", "position_cm = [0, 0, nan]", ["objects.wall", "position_cm"]),
        ("position_cm = [0, 0, 40]", "position_cm = [0, inf, 40]", ["objects.wall", "position_cm"]),
        ("position_cm = [0, 0, 40]", "position_cm = [0, 40]", ["objects.wall", "position_cm"]),
        ("size_cm = [50, 40]", "size_cm = [50, 0]", ["objects.wall", "size_cm"]),
        ("radius_cm = 2", "radius_cm = -2", ["objects.ball", "radius_cm", "-2"]),
        ("focus_cm = 40", "focus_cm = 0", ["focus_cm"]),
        ("position_cm = [1, 0, 20]", "position_cm = [1, 0, -20]", ["object 'ball'", "behind the lens"]),
        ("position_cm = [1, 0, 20]", "position_cm = [1, 0, 0]", ["object 'ball'", "on the lens"]),
        ("position_cm = [0, 0, 40]", "position_cm = [0, 0, 0.05]", ["object 'wall'", "on the lens"]),
        ('name = "ball"', 'name = "wall"', ["objects", "used twice: wall"]),
        ('name = "ball"', 'name = ""', ["objects.1", "name"]),
        ('name = "mine"', "", ["name: is missing"]),
        ("[[lights]]", "[[lamps]]", ["lights: is missing", "lamps: unknown key"]),
        ("lux = 500", "lux = ", ["not valid TOML"]),
        ("focus_cm = 40", "view = {look_at_cm = [0, 0, 0]}", ["view", "look_at_cm must differ"]),
        ("focus_cm = 40", "view = {look_at_cm = [0, 9, 0]}", ["view", "straight above or below"]),
    ],
)
def test_problems_are_named_in_one_line(tmp_path, old, new, message_part):
    """Expectation: InputError with the file, the key or object, and the value or what is allowed."""
    assert GOOD.count(old) >= 1
    message = refusal(tmp_path, GOOD.replace(old, new, 1))
    for part in message_part:
        assert part in message, message


@pytest.mark.parametrize(
    ("light", "refused"),
    [
        ('kind = "lamp"\nposition_cm = [0, 0, 0]\ntarget_cm = [0, 0, 40]\nradius_cm = 8', True),
        ('kind = "lamp"\nposition_cm = [3, 0, 0.05]\ntarget_cm = [3, 0, 40]\nradius_cm = 8', True),
        ('kind = "bulb"\nposition_cm = [0, 3, 0]\ntarget_cm = [0, 0, 40]\nradius_cm = 3', True),
        ('kind = "panel"\nposition_cm = [0, 0, 0]\ntarget_cm = [0, 0, 40]\nsize_cm = [2, 2]', True),
        ('kind = "lamp"\nposition_cm = [3, 0, 0]\ntarget_cm = [3, 0, 40]\nradius_cm = 2', False),  # beside it
        ('kind = "bulb"\nposition_cm = [0, 5, 0]\ntarget_cm = [0, 0, 40]\nradius_cm = 3', False),
    ],
)
def test_lights_that_touch_the_lens_are_refused(tmp_path, light, refused):
    """Rationale: the blur of such a lamp has no bound, and neither has the memory of its kernels."""
    text = GOOD.replace('kind = "dome"', light)
    if refused:
        assert "lies on the lens or encloses it" in refusal(tmp_path, text)
    else:
        (tmp_path / "beside.toml").write_text(text)
        assert dasim.load_scene(tmp_path / "beside.toml").lights


def test_lamp_on_its_target_and_an_empty_scene_are_refused(tmp_path):
    lamp = 'kind = "lamp"\nposition_cm = [1, 2, 3]\ntarget_cm = [1, 2, 3]\nradius_cm = 1'
    assert "must differ" in refusal(tmp_path, GOOD.replace('kind = "dome"', lamp))
    assert "objects" in refusal(tmp_path, GOOD[: GOOD.index("[[objects]]")])


def test_several_mistakes_are_named_at_once(tmp_path):
    bad = (
        GOOD.replace('material = "brick"', 'material = "unobtainium"')
        .replace('"D65"', '"F99"')
        .replace('"sand"', '"tin"')
    )
    message = refusal(tmp_path, bad)
    assert all(part in message for part in ("'unobtainium'", "'F99'", "'tin'")), message


def test_a_view_of_its_own_may_leave_objects_behind_the_lens(tmp_path):
    """Rationale: a camera that moves through a scene passes objects; a scene without a view has none but mistakes."""
    view = "[view]\nposition_cm = [0, 0, 30]\nlook_at_cm = [0, 0, 40]\n"
    assert len(load(tmp_path, GOOD + view).objects) == 2


def test_file_that_is_not_there():
    with pytest.raises(InputError, match=r"scene 'attic' is neither a bundled name \(.*desk.*\) nor a file"):
        loading.load_scene("attic")


@pytest.mark.parametrize(
    ("content", "message_part"),
    [
        (None, "no such file"),
        ("", ""),
        ("v 0 0 0\nv 1 0 0\nv 0 1 0\n", "no faces"),
        ("v 0 0 0\nv 1 0 0\nv nan 1 0\nf 1 2 3\n", "not finite"),
        ("v 0 0 0\nv 1 0 0\nf 1 2 9\n", ""),
        ("rubbish \x00\x01", ""),
    ],
)
def test_mesh_that_is_missing_empty_or_broken(tmp_path, content, message_part):
    if content is not None:
        (tmp_path / "thing.obj").write_text(content)
    message = refusal(tmp_path, GOOD + MESH)
    assert "object 'thing'" in message and "thing.obj" in message and message_part in message, message


def test_mesh_on_disk_may_change_between_two_loads(tmp_path):
    """Rationale: in a notebook, a user edits a mesh and loads the scene again; the new file must be read.

    Expectation: half extents of the file as it is, in its unit of 1 cm, and of 2.5 mm.
    """
    trimesh.creation.box((2, 2, 2)).export(tmp_path / "thing.obj")
    scene = load(tmp_path, GOOD + MESH)
    np.testing.assert_allclose(shapes.half_extent_m(scene.objects[2], scene.folder)[1], 0.01)
    scene = load(tmp_path, GOOD + MESH + "unit_cm = 0.25\n")
    np.testing.assert_allclose(shapes.half_extent_m(scene.objects[2], scene.folder)[1], 0.0025)
    trimesh.creation.box((6, 2, 2)).export(tmp_path / "thing.obj")
    scene = load(tmp_path, GOOD + MESH)
    np.testing.assert_allclose(shapes.half_extent_m(scene.objects[2], scene.folder)[1], (0.03, 0.01, 0.01))


@pytest.mark.parametrize(
    ("position_cm", "look_at_cm"), [((0, 0, 0), (0, 0, 1)), ((30, -20, 5), (0, 0, 30)), ((0, -50, 0), (3, 0, -40))]
)
def test_view_is_a_rigid_right_handed_transform(make_scene, position_cm, look_at_cm):
    """Expectation: lengths and handedness stay; the target lies on the axis before the lens; down stays down."""
    wall = {"name": "w", "shape": "plane", "size_cm": (1, 1), "position_cm": (0, 0, 30), "material": "brick"}
    scene = make_scene(wall, view={"position_cm": position_cm, "look_at_cm": look_at_cm})
    matrix = scenes.world_to_camera(scene)
    np.testing.assert_allclose(matrix[:3, :3] @ matrix[:3, :3].T, np.eye(3), atol=RIGID)
    assert np.linalg.det(matrix[:3, :3]) == pytest.approx(1.0, abs=RIGID)
    np.testing.assert_array_equal(matrix[3], [0, 0, 0, 1])
    target = matrix @ [*np.multiply(look_at_cm, 0.01), 1]
    np.testing.assert_allclose(target[:2], 0, atol=RIGID)
    assert target[2] == pytest.approx(np.linalg.norm(np.subtract(look_at_cm, position_cm)) / 100)
    np.testing.assert_allclose(matrix @ [*np.multiply(position_cm, 0.01), 1], [0, 0, 0, 1], atol=RIGID)
    assert matrix[1, 1] > 0 and matrix[0, 1] == pytest.approx(0, abs=RIGID), "no roll: y has no part to the right"


@pytest.mark.parametrize(
    ("rotation_deg", "axis", "goes_to"),
    [
        ((90, 0, 0), (0, 1, 0), (0, 0, 1)),
        ((0, 90, 0), (0, 0, 1), (1, 0, 0)),
        ((0, 0, 90), (1, 0, 0), (0, 1, 0)),
        ((90, 90, 0), (0, 1, 0), (1, 0, 0)),  # first about x, then about y: down goes to forward, then to right
        ((0, 90, 90), (0, 0, 1), (0, 1, 0)),  # forward to right, then to down
    ],
)
def test_rotations_turn_right_handed_in_order(make_scene, rotation_deg, axis, goes_to):
    item = {"name": "w", "shape": "plane", "size_cm": (1, 1), "position_cm": (0, 0, 30), "material": "brick"}
    scene = make_scene(item | {"rotation_deg": rotation_deg})
    turned = scenes.object_to_camera(scene.objects[0], scene)[:3, :3] @ axis
    np.testing.assert_allclose(turned, goes_to, atol=RIGID)


def test_scene_proposes_a_focus_and_its_main_light(make_scene, da_mobile):
    wall = {"name": "w", "shape": "plane", "size_cm": (1, 1), "position_cm": (0, 0, 30), "material": "brick"}
    scene = make_scene(wall, focus_cm=12)
    assert scenes.focused(da_mobile, scene).lens.focus_distance_m == pytest.approx(0.12)
    assert scenes.focused(da_mobile, make_scene(wall)) == da_mobile
    with pytest.raises(InputError, match="focal length"):
        scenes.focused(da_mobile, make_scene(wall, focus_cm=0.3))
    lights = [{"kind": "dome", "illuminant": "A", "lux": 10.0}, {"kind": "dome", "illuminant": "D55", "lux": 20.0}]
    assert scenes.main_illuminant(make_scene(wall, lights=lights)) == "D55"


def test_mesh_without_texture_coordinates_takes_no_texture(tmp_path):
    """Rationale: a renderer would make up coordinates, a triangle at a time. Expectation: refused, by name."""
    trimesh.creation.box((1, 1, 1)).export(tmp_path / "bare.ply")
    (tmp_path / "bare.toml").write_text(
        'name = "bare"\n[[lights]]\nkind = "dome"\nilluminant = "D65"\nlux = 100\n'
        '[materials.photo]\nkind = "print"\nimage = "skimage:coffee"\n'
        '[[objects]]\nname = "cube"\nshape = "mesh"\nfile = "bare.ply"\nposition_cm = [0, 0, 20]\nmaterial = "photo"\n'
    )
    with pytest.raises(InputError, match=r"object 'cube': mesh bare\.ply has no texture coordinates"):
        loading.load_scene(tmp_path / "bare.toml")
