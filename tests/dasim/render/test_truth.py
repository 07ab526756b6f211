"""Geometry at the pixel centres: analytic intersections, labels, orientation of textures and meshes, boundaries."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
import trimesh

from dasim.camera import depth_blur
from dasim.camera import geometry as camera_geometry
from dasim.camera import specification as cameras

DEPTH_LIMIT = 1e-4  # relative; rays and shapes are single precision, amplified where they meet at an angle
NORMAL_LIMIT = 1e-3  # single precision through Mitsuba's own normals
INSIDE = 0.97  # of a shape's half width: at its outline single precision decides whether it is hit


def pixel_rays(camera) -> np.ndarray:
    """Directions [h, w, 3] with z = 1 through the pixel centres."""
    sensor, lens = camera.sensor, camera.lens
    image_mm = 1 / (1 / lens.focal_length_mm - 1 / (lens.focus_distance_m * 1e3))
    x = (np.arange(sensor.width_px) - (sensor.width_px - 1) / 2) * sensor.pixel_pitch_um / 1e3 / image_mm
    y = (np.arange(sensor.height_px) - (sensor.height_px - 1) / 2) * sensor.pixel_pitch_um / 1e3 / image_mm
    return np.stack([*np.meshgrid(x, y), np.ones((len(y), len(x)))], axis=-1)


def quadratic(a, b, c):
    """Both roots, smaller first, NaN where there is none."""
    with np.errstate(invalid="ignore"):
        root = np.sqrt(b * b - 4 * a * c)
    return (-b - root) / (2 * a), (-b + root) / (2 * a)


def slanted_plane(rays):
    """Centre (0, 0, 30) cm, turned 50 degrees about y: its normal is (-sin 50, 0, -cos 50)."""
    normal = np.array([-np.sin(np.radians(50)), 0, -np.cos(np.radians(50))])
    depth = 0.3 * normal[2] / (rays @ normal)
    point = rays * depth[..., None]
    along = (point[..., 2] - 0.3) / -np.sin(np.radians(50))
    return np.where((np.abs(along) < 0.1 * INSIDE) & (np.abs(point[..., 1]) < 0.06 * INSIDE), depth, np.nan), normal


def sphere(rays):
    centre, radius = np.array([0.02, -0.01, 0.25]), 0.05
    depth, _ = quadratic((rays**2).sum(-1), -2 * rays @ centre, centre @ centre - radius**2)
    normal = (rays * depth[..., None] - centre) / radius
    return np.where(-(normal * rays).sum(-1) > 0.2, depth, np.nan), normal


def box(rays):
    """8 x 6 x 4 cm around (0, 0, 25) cm, turned 30 degrees about z: slabs in the turned axes."""
    c, s = np.cos(np.radians(30)), np.sin(np.radians(30))
    turned = np.stack([rays[..., 0] * c + rays[..., 1] * s, -rays[..., 0] * s + rays[..., 1] * c], -1)
    front = 0.23
    inside = (np.abs(turned[..., 0] * front) < 0.04 * INSIDE) & (np.abs(turned[..., 1] * front) < 0.03 * INSIDE)
    return np.where(inside, front, np.nan), np.array([0.0, 0.0, -1.0])


def cylinder(rays):
    """Axis along y through (1, 0, 25) cm, radius 3, height 8 cm, open at its ends."""
    a, b = rays[..., 0] ** 2 + 1, -2 * (0.01 * rays[..., 0] + 0.25)
    depth, _ = quadratic(a, b, 0.01**2 + 0.25**2 - 0.03**2)
    normal = np.stack([rays[..., 0] * depth - 0.01, 0 * depth, depth - 0.25], -1) / 0.03
    inside = (np.abs(rays[..., 1] * depth) < 0.04 * INSIDE) & (-(normal * rays).sum(-1) > 0.2)
    return np.where(inside, depth, np.nan), normal


SHAPES = {
    slanted_plane: {"shape": "plane", "size_cm": (20, 12), "position_cm": (0, 0, 30), "rotation_deg": (0, 50, 0)},
    sphere: {"shape": "sphere", "radius_cm": 5, "position_cm": (2, -1, 25)},
    box: {"shape": "box", "size_cm": (8, 6, 4), "position_cm": (0, 0, 25), "rotation_deg": (0, 0, 30)},
    cylinder: {"shape": "cylinder", "radius_cm": 3, "height_cm": 8, "position_cm": (1, 0, 25)},
}


@pytest.fixture(scope="module")
def geometry(loaded):
    from dasim.render import truth

    return lambda scene, camera: truth.geometry(loaded(scene), camera)


def thing(name="thing", material="grey-card", **others) -> dict:
    return {"name": name, "material": material} | others


@pytest.mark.parametrize("expected", SHAPES, ids=lambda function: function.__name__)
def test_depth_and_normals_are_those_of_the_shape(geometry, make_scene, wide, expected):
    """Set-up: one shape, 48 x 36 rays written out here from similar triangles.

    Expectation: z (not range) at the pixel centre within 0.01 %, unit normals towards the camera, nothing elsewhere.
    """
    camera = wide()
    maps = geometry(make_scene(thing(**SHAPES[expected])), camera)
    depth, normal = expected(pixel_rays(camera))
    inside = ~np.isnan(depth)
    assert inside.sum() > 100
    np.testing.assert_allclose(maps.depth_m[inside], depth[inside], rtol=DEPTH_LIMIT)
    normal = np.broadcast_to(normal, (*depth.shape, 3))[inside]
    np.testing.assert_allclose(maps.normal[inside], normal, atol=NORMAL_LIMIT)
    assert (maps.object_id[inside] == 1).all()
    missed = np.isnan(maps.depth_m)
    assert missed[0, 0] and (maps.object_id[missed] == 0).all() and (maps.normal[missed] == 0).all()


def test_labels_follow_the_order_of_the_scene_and_places_its_axes(geometry, make_scene, wide):
    """The proof of the axes: +x appears on the right, +y below. Objects are numbered in order, 0 is nothing."""
    ball = {"shape": "sphere", "radius_cm": 1.5}
    scene = make_scene(
        thing("right", **ball, position_cm=(5, 0, 25)),
        thing("below", **ball, position_cm=(0, 4, 25)),
        thing("both", **ball, position_cm=(-5, -4, 25)),
        thing("card", shape="disc", radius_cm=1.5, position_cm=(0, 0, 25)),
    )
    labels = geometry(scene, wide()).object_id
    assert labels.dtype == np.uint32
    centres = {k: np.argwhere(labels == k).mean(axis=0) - (17.5, 23.5) for k in range(1, 5)}
    per_cm = 10 * (3.6 * 400 / 396.4) / 250 / 0.05  # pixels a centimetre at 25 cm: s / d over the pitch, in mm
    for label, place in ((1, (0, 5)), (2, (4, 0)), (3, (-4, -5)), (4, (0, 0))):
        np.testing.assert_allclose(centres[label], np.multiply(place, per_cm), atol=0.6)
    assert (labels == 0).any()


def test_labels_do_not_depend_on_earlier_scenes_or_on_the_kind_of_shape(geometry, make_scene, wide, tmp_path):
    """Rationale: a data set renders many scenes in one process, and meshes are made another way than other shapes.

    Set-up: another scene is alive; then a plane, a mesh, and a lamp. Expectation: plane 1, mesh 2.
    """
    vertices = np.array([[-5, -5, 0], [5, -5, 0], [5, 5, 0]], float)
    trimesh.Trimesh(vertices, [[0, 1, 2]], process=False).export(tmp_path / "half.obj")
    wall = thing("wall", shape="plane", size_cm=(60, 60), position_cm=(0, 0, 40))
    half = thing("half", shape="mesh", file="half.obj", position_cm=(0, 0, 25))
    for _ in range(2):
        labels = geometry(make_scene(wall, half, folder=tmp_path), wide()).object_id
        assert labels[12, 30] == 2, "upper right"
        assert labels[24, 18] == 1 and labels[0, 0] == 1


def test_nearer_hides_farther(geometry, make_scene, wide):
    wall = thing("wall", shape="plane", size_cm=(60, 60), position_cm=(0, 0, 30))
    card = thing("card", shape="plane", size_cm=(4, 4), position_cm=(0, 0, 20))
    maps = geometry(make_scene(wall, card), wide())
    assert maps.object_id[18, 24] == 2 and maps.depth_m[18, 24] == pytest.approx(0.2, rel=DEPTH_LIMIT)
    assert maps.object_id[0, 0] == 1 and maps.depth_m[0, 0] == pytest.approx(0.3, rel=DEPTH_LIMIT)


def test_view_moves_the_camera(geometry, make_scene, wide):
    """Set-up: a ball at (10, 5, 30) cm, seen from (40, -10, 10) cm. Expectation: in the middle of the picture, its
    nearest point its radius nearer than its centre; what is right of it in the scene's own +x from the front appears
    in front or behind, so a second ball above (-y) appears above.
    """
    target, stand = np.array([10, 5, 30]), np.array([40, -10, 10])
    ball, upper = (
        thing(n, shape="sphere", radius_cm=2, position_cm=tuple(p))
        for n, p in (("a", target), ("b", target - (0, 8, 0)))
    )
    scene = make_scene(ball, upper, view={"position_cm": tuple(stand), "look_at_cm": tuple(target)})
    maps = geometry(scene, wide(50, 38))
    centre = np.argwhere(maps.object_id == 1).mean(axis=0)
    np.testing.assert_allclose(centre, (18.5, 24.5), atol=0.6)
    nearest = np.nanmin(np.where(maps.object_id == 1, maps.depth_m, np.nan))
    # The middle lies between four pixels of 5.4 mm: their rays meet the ball 3.8 mm off its tip, 0.36 mm deeper.
    assert nearest == pytest.approx(np.linalg.norm(target - stand) / 100 - 0.02 + 3.6e-4, abs=1e-4)
    above = np.argwhere(maps.object_id == 2).mean(axis=0)
    assert above[0] < centre[0] - 5 and above[1] == pytest.approx(centre[1], abs=0.6)


# --- textures and meshes -------------------------------------------------------------------------


@pytest.fixture(scope="module")
def corner_picture(tmp_path_factory):
    """A folder with a picture that is white in its top left quarter, grey at the top right, black below."""
    folder = tmp_path_factory.mktemp("textures")
    data = np.zeros((64, 64, 3), np.uint8)
    data[:32, :32], data[:32, 32:] = 255, 188
    assert cv2.imwrite(str(folder / "corner.png"), data)
    return folder


CORNER = {"corner": {"kind": "blend", "image": "corner.png", "dark": "carbon-black", "bright": "ceramic-white"}}


@pytest.fixture(scope="module")
def quarters(loaded):
    """Mean green of the four quarters of a square area of the picture, relative to the brightest."""
    from dasim.render import passes

    def measure(scene, camera, half_px: int):
        picture = passes.pinhole_pass(loaded(scene), camera, passes.Sampling(16, 0))[..., 1]
        y, x = camera.sensor.height_px // 2, camera.sensor.width_px // 2
        cut = picture[y - half_px : y + half_px, x - half_px : x + half_px]
        values = cut.reshape(2, half_px, 2, half_px).mean(axis=(1, 3))
        return values / values.max()

    return measure


TOP_LEFT = np.array([[1.0, 0.5], [0.05, 0.05]])  # white, half of it, black
QUARTER_LIMIT = 0.08  # the picture's middle falls between two pixels, and pixels blend across it


@pytest.mark.parametrize(
    "shape",
    [
        {"shape": "plane", "size_cm": (10, 10), "position_cm": (0, 0, 25)},
        {"shape": "box", "size_cm": (10, 10, 2), "position_cm": (0, 0, 26)},
    ],
    ids=lambda shape: shape["shape"],
)
def test_texture_stands_upright_and_is_not_mirrored(quarters, make_scene, wide, corner_picture, shape):
    """Expectation: the picture's bright top left corner is at the top left of a flat face that faces the camera."""
    scene = make_scene(thing(material="corner", **shape), materials=CORNER, folder=corner_picture)
    np.testing.assert_allclose(quarters(scene, wide(), 8), TOP_LEFT, atol=QUARTER_LIMIT)


def test_texture_is_repeated_in_mirrored_copies(quarters, make_scene, wide, corner_picture):
    """Set-up: two copies across. Expectation: halves of the face are mirror images, the bright top left stays."""
    materials = {"corner": CORNER["corner"] | {"repeat": (2, 1)}}
    plane = thing(material="corner", shape="plane", size_cm=(10, 10), position_cm=(0, 0, 25))
    values = quarters(make_scene(plane, materials=materials, folder=corner_picture), wide(), 8)
    np.testing.assert_allclose(values[:, 0], values[:, 1], atol=0.03)
    assert values[0, 0] > 10 * values[1, 0]


@pytest.mark.parametrize("shape", ["sphere", "cylinder"])
def test_texture_on_round_shapes_is_upright_and_runs_to_the_right(loaded, make_scene, wide, tmp_path, shape):
    """Set-up: a picture whose top half is brighter, with a ramp to the right (black to white in linear light).

    Expectation: the upper half of the shape is brighter; along a row brightness grows to the right, steadily: a
    mirrored texture would fall, and a seam that faces the camera would break it.
    """
    linear = np.tile(np.linspace(0, 1, 256), (64, 1))
    linear[32:] *= 0.3
    encoded = np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)
    assert cv2.imwrite(str(tmp_path / "ramp.png"), np.rint(255 * encoded).astype(np.uint8))
    materials = {"ramp": {"kind": "blend", "image": "ramp.png", "dark": "carbon-black", "bright": "ceramic-white"}}
    size = {"radius_cm": 5} if shape == "sphere" else {"radius_cm": 4, "height_cm": 9}
    item = thing(material="ramp", shape=shape, position_cm=(0, 0, 25), **size)
    from dasim.render import passes

    scene = loaded(make_scene(item, materials=materials, folder=tmp_path))
    picture = passes.pinhole_pass(scene, wide(), passes.Sampling(64, 0))[..., 1]
    upper, lower = picture[14, 17:31], picture[21, 17:31]
    assert np.corrcoef(upper, np.arange(len(upper)))[0, 1] > 0.9, upper
    assert np.median(upper / lower) > 1.5


def quad(uv: bool = True) -> trimesh.Trimesh:
    """A square of 10 units that faces -z, x right and y down, its texture's v up as mesh files have it."""
    vertices = np.array([[-5, -5, 0], [5, -5, 0], [5, 5, 0], [-5, 5, 0]], float)
    visual = trimesh.visual.TextureVisuals(uv=[[0, 1], [1, 1], [1, 0], [0, 0]]) if uv else None
    return trimesh.Trimesh(vertices, [[0, 1, 2], [0, 2, 3]], visual=visual, process=False)


@pytest.mark.parametrize("suffix", ["obj", "ply", "glb"])
def test_users_mesh_has_its_place_and_its_texture_upright(quarters, geometry, make_scene, wide, corner_picture, suffix):
    """Set-up: a square written by trimesh with texture coordinates (v up), 1 cm a unit.

    Expectation: it stands where a plane would, with the bright corner at the top left.
    """
    quad().export(corner_picture / f"quad.{suffix}")
    item = thing(material="corner", shape="mesh", file=f"quad.{suffix}", position_cm=(0, 0, 25))
    scene = make_scene(item, materials=CORNER, folder=corner_picture)
    maps = geometry(scene, wide())
    plane = thing(shape="plane", size_cm=(10, 10), position_cm=(0, 0, 25))
    np.testing.assert_array_equal(maps.object_id, geometry(make_scene(plane), wide()).object_id)
    assert maps.depth_m[18, 24] == pytest.approx(0.25, rel=DEPTH_LIMIT)
    np.testing.assert_allclose(maps.normal[18, 24], [0, 0, -1], atol=NORMAL_LIMIT)
    np.testing.assert_allclose(quarters(scene, wide(), 8), TOP_LEFT, atol=QUARTER_LIMIT)


@pytest.mark.parametrize("suffix", ["stl", "off", "obj"])
def test_users_mesh_without_texture_coordinates(geometry, make_scene, wide, tmp_path, suffix):
    """Expectation: a wedge right of and below the middle, half a unit a centimetre, appears right and below."""
    vertices = np.array([[2, 2, 0], [8, 2, 0], [8, 8, 0]], float)
    trimesh.Trimesh(vertices, [[0, 1, 2]], process=False).export(tmp_path / f"wedge.{suffix}")
    item = thing(shape="mesh", file=f"wedge.{suffix}", unit_cm=0.5, position_cm=(0, 0, 25))
    labels = geometry(make_scene(item, folder=tmp_path), wide()).object_id
    rays = pixel_rays(wide()) * 25
    x, y = rays[..., 0], rays[..., 1]
    inside = (x < 4) & (y > 1) & (y < x)
    outline = np.min(np.abs([x - 4, y - 1, y - x]), axis=0) < 1e-6  # pixel centres there may fall on either side
    np.testing.assert_array_equal(labels.astype(bool)[~outline], inside[~outline])
    assert (inside & ~outline).sum() > 15


# --- what follows for the blur -------------------------------------------------------------------


def test_blur_has_the_sign_of_the_side(da_mobile):
    blur = depth_blur.signed_blur_px(np.array([[0.1, 0.4, 1.0, np.nan]]), da_mobile)[0]
    assert blur[0] > 0 and blur[1] == pytest.approx(0, abs=1e-9) and blur[2] < 0
    aperture, image = 3.6e-3 / 2.8, 3.6e-3 * 0.4 / 0.3964
    assert blur[3] == pytest.approx(-aperture * image / 0.4 / 1.7e-6), "nothing is infinitely far"


def test_boundary_is_as_wide_as_the_blur_of_the_nearer_side(da_mobile):
    """Set-up: a straight step from 10 cm to the focus at 40 cm between columns 47 and 48.

    Expectation: columns within the radius of the near blur and one pixel of the step, on both sides, and none 3 pixels
    beyond the radius.
    """
    depth = np.where(np.arange(96) < 48, 0.1, 0.4) * np.ones((20, 1))
    blur = camera_geometry.blur_px(da_mobile, depth)
    boundary = depth_blur.boundary(blur)
    radius = blur.max() / 2
    assert 9 < radius < 14
    distance = np.abs(np.arange(96) + 0.5 - 48)
    assert boundary[:, distance <= radius + 1].all()
    assert not boundary[:, distance > radius + 3].any()
    assert not depth_blur.boundary(np.full((8, 8), 20.0)).any(), "no step, no boundary, however large the blur"


def test_field_of_view_and_matrix_agree(wide):
    """Expectation: the horizontal view is that of the outermost pixel edges through K."""
    from dasim.render import truth

    camera = wide(focus_m=0.05)
    matrix = camera_geometry.intrinsic_matrix(camera)
    edge = np.linalg.inv(matrix) @ [0, camera.sensor.height_px / 2, 1]
    assert truth.field_of_view_deg(camera) == pytest.approx(2 * np.degrees(np.arctan(-edge[0])), rel=1e-9)


def test_window_has_the_geometry_of_that_part_of_the_frame(geometry, make_scene, wide):
    """Set-up: all shapes side by side. Expectation: depth, normals and objects of a window off the axis are those of
    the whole frame there, up to single precision.
    """
    scene = make_scene(*(thing(str(index), **shape) for index, shape in enumerate(SHAPES.values())))
    whole, window = geometry(scene, wide()), geometry(scene, cameras.cropped(wide(), 20, 12, at_px=(26, 4)))
    part = np.s_[4:16, 26:46]
    np.testing.assert_array_equal(window.object_id, whole.object_id[part])
    assert len(np.unique(window.object_id)) > 2
    np.testing.assert_allclose(window.depth_m, whole.depth_m[part], rtol=DEPTH_LIMIT)
    np.testing.assert_allclose(window.normal, whole.normal[part], atol=NORMAL_LIMIT)


def test_no_ray_slips_between_the_triangles_of_a_mesh(geometry, make_scene, da_mobile, tmp_path):
    """Rationale: the diagonal of a quad runs through pixel centres, and rays could pass along it.

    Expectation: every pixel sees the quad, none the wall behind it.
    """
    (tmp_path / "quad.obj").write_text("v -1 1 0\nv 1 1 0\nv 1 -1 0\nv -1 -1 0\nf 1 4 3 2\n")
    wall = thing("wall", shape="plane", size_cm=[60, 60], position_cm=[0, 0, 20])
    quad = thing(shape="mesh", file="quad.obj", position_cm=[0, 0, 16])
    camera = cameras.refocused(cameras.cropped(da_mobile, 192, 144), 0.15)
    maps = geometry(make_scene(wall, quad, folder=tmp_path), camera)
    assert (maps.object_id == 2).all()
    np.testing.assert_allclose(maps.depth_m, 0.16, rtol=DEPTH_LIMIT)
