"""Height fields, and what is refused: analytic heights, cameras inside a mesh, numbers of materials."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
import trimesh

from dasim.base.errors import InputError
from dasim.scene import loading, meshes, object_materials, shapes

DEPTH_LIMIT = 1e-4  # relative; rays and shapes are single precision
HEAD = 'name = "mine"\n[[lights]]\nkind = "dome"\nilluminant = "D65"\nlux = 500\n'
AT_20 = "\nposition_cm = [0, 0, 20]\n"


def relief(**others) -> dict:
    return {
        "name": "relief",
        "shape": "heightfield",
        "image": "relief.png",
        "size_cm": (16, 12),
        "height_cm": 4,
        "position_cm": (0, 0, 30),
        "material": "grey-card",
    } | others


@pytest.fixture(scope="module")
def geometry(loaded):
    from dasim.render import truth

    return lambda scene, camera: truth.geometry(loaded(scene), camera)


@pytest.mark.parametrize("bits", [8, 16])
def test_height_field_is_a_ramp_where_its_picture_is(geometry, make_scene, wide, tmp_path, bits):
    """Set-up: a picture that grows from black at the left to white at the right: a plane between z = 30 and 26 cm.

    Expectation: z at the pixel centres is that of the tilted plane, where a value stands at its pixel's centre:
    z = 30 - 4 (u W - 0.5) / (W - 1) with u = x / 16 + 1/2. 8 bits hold 52 steps exactly (255 = 51 x 5).
    """
    columns = 52
    ramp = np.tile(np.rint(np.linspace(0, 2**bits - 1, columns)), (8, 1))
    assert cv2.imwrite(str(tmp_path / "relief.png"), ramp.astype(np.uint8 if bits == 8 else np.uint16))
    camera = wide()
    maps = geometry(make_scene(relief(), folder=tmp_path), camera)
    sensor, lens = camera.sensor, camera.lens
    image_mm = 1 / (1 / lens.focal_length_mm - 1 / (lens.focus_distance_m * 1e3))
    x = (np.arange(sensor.width_px) - (sensor.width_px - 1) / 2) * sensor.pixel_pitch_um / 1e3 / image_mm
    # z = a - b X with X = x z, in cm
    b = 4 / 16 * columns / (columns - 1)
    z = 0.01 * (30 - 4 * (columns / 2 - 0.5) / (columns - 1)) / (1 + b * x)
    inside = (np.abs(x * z) < 0.078) & ~np.isnan(maps.depth_m[18])
    assert inside.sum() > 25
    np.testing.assert_allclose(maps.depth_m[18, inside], z[inside], rtol=DEPTH_LIMIT)
    assert (maps.object_id[18, inside] == 1).all()


def test_height_field_reaches_as_far_as_a_plane_and_white_is_nearer(geometry, make_scene, wide, tmp_path):
    """Expectation: all black is the plane itself, all white a plane that much nearer; outlines agree."""
    for value, depth_cm in ((0, 30), (255, 26)):
        cv2.imwrite(str(tmp_path / "relief.png"), np.full((5, 7), value, np.uint8))
        maps = geometry(make_scene(relief(rotation_deg=(0, 0, 20)), folder=tmp_path), wide())
        plane = {"name": "p", "shape": "plane", "size_cm": (16, 12), "material": "grey-card"}
        flat = make_scene(plane | {"position_cm": (0, 0, depth_cm), "rotation_deg": (0, 0, 20)})
        np.testing.assert_allclose(maps.depth_m, geometry(flat, wide()).depth_m, rtol=DEPTH_LIMIT)


def test_texture_lies_on_a_height_field_as_on_a_plane(loaded, make_scene, wide, tmp_path):
    """Set-up: a picture with one bright quarter on a black (flat) height field and on a plane.

    Expectation: the same picture, pixel by pixel (noise aside, which is the same too: same samples).
    """
    from dasim.render import passes

    quarter = np.zeros((8, 8, 3), np.uint8)
    quarter[:4, :4] = 255
    cv2.imwrite(str(tmp_path / "quarter.png"), quarter)
    cv2.imwrite(str(tmp_path / "relief.png"), np.zeros((5, 7), np.uint8))
    materials = {"q": {"kind": "blend", "image": "quarter.png", "dark": "carbon-black", "bright": "ceramic-white"}}
    pictures = []
    for item in (relief(material="q"), relief(material="q", shape="plane")):
        if item["shape"] == "plane":
            del item["image"], item["height_cm"]
        scene = loaded(make_scene(item, materials=materials, folder=tmp_path))
        pictures.append(passes.pinhole_pass(scene, wide(), passes.Sampling(16, 0))[..., 1])
    assert pictures[1][12, 16] > 10 * pictures[1][24, 32]
    np.testing.assert_allclose(pictures[0], pictures[1], rtol=2e-3, atol=2e-3 * pictures[1].max())


def test_large_pictures_are_averaged_down(loaded, make_scene, tmp_path):
    """Expectation: at most 512 heights a side, that is 513 cells with the rim."""
    cv2.imwrite(str(tmp_path / "relief.png"), np.zeros((8, 2000), np.uint8))
    built = loaded(make_scene(relief(), folder=tmp_path)).shapes()[0]
    assert built.face_count() == 2 * 513 * 9


def refusal(folder, item: str) -> str:
    (folder / "mine.toml").write_text(HEAD + "[[objects]]\nname = 'thing'\n" + item)
    with pytest.raises(InputError) as caught:
        loading.load_scene(folder / "mine.toml")
    message = str(caught.value)
    assert "\n" not in message and "thing" in message
    return message


@pytest.fixture
def files(tmp_path):
    ball = trimesh.creation.icosphere(subdivisions=1)
    ball.export(tmp_path / "plain.stl")
    ball.visual = trimesh.visual.ColorVisuals(ball, vertex_colors=np.tile(np.uint8([9, 99, 199]), (42, 1)))
    ball.export(tmp_path / "coloured.ply")
    (tmp_path / "broken.png").write_text("no picture")
    (tmp_path / "cut.ply").write_bytes((tmp_path / "coloured.ply").read_bytes()[:300])
    (tmp_path / "cut.glb").write_bytes(ball.export(file_type="glb")[:300])
    return tmp_path


@pytest.mark.parametrize(
    ("item", "message_part"),
    [
        ('shape = "mesh"\nfile = "coloured.ply"', ["coloured.ply", "RGB colours", "print, dyed, achromatic"]),
        ('shape = "mesh"\nfile = "coloured.ply"\nnear_infrared = "rgb"', ["'rgb' is unknown", "print, dyed"]),
        (
            'shape = "mesh"\nfile = "plain.stl"',
            ["plain.stl", "has no colours of its own", "give the object a material"],
        ),
        ('shape = "mesh"\nfile = "plain.stl"\nnear_infrared = "print"', ["has no colours of its own"]),
        (
            'shape = "mesh"\nfile = "coloured.ply"\nnear_infrared = "print"\nmaterial = "brick"',
            ["objects.thing", "near_infrared is for a mesh with colours of its own"],
        ),
        ('shape = "mesh"\nfile = "cut.ply"\nmaterial = "brick"', ["cut.ply", "does not load", "allowed are OBJ"]),
        ('shape = "mesh"\nfile = "cut.glb"\nmaterial = "brick"', ["cut.glb", "does not load"]),
        ('shape = "mesh"\nfile = "coloured.ply"\nmaterial = "brick"\nunit_cm = 6000', ["m large", "unit_cm is 6000"]),
        ('shape = "mesh"\nfile = "coloured.ply"\nmaterial = "brick"\nunit_cm = 1e-4', ["m large", "unit_cm is 0.0001"]),
        ('shape = "plane"\nmaterial = "brick"\nsize_cm = [10001, 10]', ["100 m large", "in centimetres"]),
        ('shape = "sphere"\nmaterial = "brick"\nradius_cm = 0.0004', ["8e-06 m large", "10 um to 100 m"]),
        ('shape = "heightfield"\nmaterial = "brick"\nsize_cm = [1, 1]\nheight_cm = 1\nimage = "no.png"', ["no.png"]),
        (
            'shape = "heightfield"\nmaterial = "brick"\nsize_cm = [1, 1]\nheight_cm = 1\nimage = "broken.png"',
            ["broken.png", "cannot be read"],
        ),
        ('shape = "heightfield"\nmaterial = "brick"\nsize_cm = [1, 1]\nimage = "skimage:coins"', ["height_cm: is mis"]),
    ],
)
def test_problems_of_an_object_are_one_line(files, item, message_part):
    message = refusal(files, item + AT_20)
    for part in message_part:
        assert part in message, message


def test_camera_may_stand_in_a_room_but_not_in_a_body(files):
    """Set-up: a ball of 40 cm around the camera: closed, inside out, half a shell; and one that touches the lens.

    Expectation: the message for the closed one says how a room is oriented; the others are rooms; the lens stays clear.
    """
    ball = trimesh.creation.icosphere(subdivisions=3)
    ball.export(files / "body.ply")
    room = ball.copy()
    room.invert()
    room.export(files / "room.ply")
    shell = trimesh.Trimesh(ball.vertices, ball.faces[ball.triangles_center[:, 2] > 0.1], process=False)
    shell.export(files / "shell.ply")
    item = 'shape = "mesh"\nmaterial = "brick"\nunit_cm = 20\nfile = '
    assert "the camera is inside it" in refusal(files, item + '"body.ply"')
    for name in ("room.ply", "shell.ply"):
        text = HEAD + "[[objects]]\nname = 'thing'\n" + item + f'"{name}"'
        (files / "mine.toml").write_text(text)
        loading.load_scene(files / "mine.toml")
    assert "lies on the lens" in refusal(files, item + '"room.ply"\nposition_cm = [0, 0, 19.95]')
    assert "encloses it" in refusal(
        files, 'shape = "sphere"\nmaterial = "brick"\nradius_cm = 5\nposition_cm = [0, 0, 4]'
    )
    # In the corner of its box, but outside the ball
    text = HEAD + "[[objects]]\nname = 'thing'\n"
    (files / "mine.toml").write_text(
        text + 'shape = "sphere"\nmaterial = "brick"\nradius_cm = 5\nposition_cm = [4, 4, 4]\n'
    )
    loading.load_scene(files / "mine.toml")


def test_winding_number_and_distance_of_a_closed_surface():
    """Closed form: 1 inside, 0 outside, -1 inside out, 5/6 in the middle of a cube without its lid."""
    ball = trimesh.creation.icosphere(subdivisions=3)
    assert meshes.winding_number(ball.triangles) == pytest.approx(1, abs=1e-9)
    assert meshes.winding_number(ball.triangles[:, ::-1]) == pytest.approx(-1, abs=1e-9)
    assert meshes.winding_number(ball.triangles + 3) == pytest.approx(0, abs=1e-9)
    box = trimesh.creation.box((2, 2, 2))
    five = box.triangles[box.face_normals[:, 2] < 0.5]
    assert meshes.winding_number(five) == pytest.approx(5 / 6, abs=1e-9)
    rng = np.random.default_rng(0)
    for centre in rng.normal(0, 2, (5, 3)):
        distance = meshes.distance_from_origin(ball.triangles + centre)
        assert distance == pytest.approx(abs(np.linalg.norm(centre) - 1), abs=0.02), (
            "flat triangles lie a little inside"
        )


def test_materials_are_numbered_in_order_of_first_use(make_scene):
    ball = {"shape": "sphere", "radius_cm": 1, "position_cm": (0, 0, 20)}
    scene = make_scene(
        ball | {"name": "a", "material": "brick"},
        ball | {"name": "b", "material": "soil"},
        ball | {"name": "c", "material": "brick"},
        {"name": "d", "shape": "mesh", "file": "x.ply", "near_infrared": "print", "position_cm": (0, 0, 20)},
    )
    assert object_materials.material_names_of(scene) == ["brick", "soil", "colours of d"]
    np.testing.assert_array_equal(object_materials.material_number_of_object(scene), [0, 1, 2, 1, 3])


def test_half_extent_of_a_height_field_holds_its_relief(make_scene):
    item = make_scene(relief()).objects[0]
    centre, half = shapes.half_extent_m(item, make_scene(relief()).folder)
    np.testing.assert_allclose(centre, [0, 0, -0.02])
    np.testing.assert_allclose(half, [0.08, 0.06, 0.02])
