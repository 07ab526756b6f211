"""Meshes from depth: place and area of a plane, a sphere's radius, cuts at jumps, files read back."""

import numpy as np
import pytest
import trimesh

import dasim
from dasim.base.errors import InputError
from dasim.camera import geometry
from dasim.camera import specification as cameras
from recon.views import surface
from validation.subjects import rendering

K = np.array([[200.0, 0, 32], [0, 200.0, 24], [0, 0, 1]])
EXACT = 1e-9
FILE_PRECISION = 1e-6  # relative, float32 in files


def test_the_pinhole_is_the_cameras(da_mobile):
    """The simulator's own formula projects through the same pinhole."""
    camera = cameras.refocused(cameras.cropped(da_mobile, 64, 48), 0.3)
    window = cameras.cropped(camera, 32, 24, at_px=(0, 24))
    for each in (camera, window):
        np.testing.assert_allclose(surface.intrinsic_matrix(each), geometry.intrinsic_matrix(each), rtol=EXACT)


def picture():
    return np.random.default_rng(0).random((48, 64, 3))


def area(mesh):
    a, b, c = (mesh.vertex_m[mesh.triangle[:, i]] for i in range(3))
    return 0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1).sum()


def test_a_plane_has_its_place_and_its_area():
    """The area is (w - 1) (h - 1) pixels of (z / f)^2 each; every vertex is at depth z on the ray through its pixel's
    centre.
    """
    mesh = surface.surface(picture(), np.full((48, 64), 0.3), K)
    assert area(mesh) == pytest.approx(63 * 47 * (0.3 / 200) ** 2, rel=EXACT)
    np.testing.assert_allclose(mesh.vertex_m[0], [0.3 * (0.5 - 32) / 200, 0.3 * (0.5 - 24) / 200, 0.3], rtol=EXACT)


def test_triangles_face_the_camera():
    mesh = surface.surface(picture(), np.full((48, 64), 0.3), K)
    a, b, c = (mesh.vertex_m[mesh.triangle[:, i]] for i in range(3))
    assert (np.cross(b - a, c - a)[:, 2] < 0).all()


def test_a_tilted_plane_stays_a_plane():
    """Depths of the plane n . X = 1 give vertices that satisfy the equation."""
    normal = np.array([2.0, 1.0, 3.0])
    y, x = np.indices((48, 64)) + 0.5
    ray = np.stack([(x - 32) / 200, (y - 24) / 200, np.ones_like(x)], -1)
    mesh = surface.surface(picture(), 1 / (ray @ normal), K)
    np.testing.assert_allclose(mesh.vertex_m @ normal, 1, rtol=EXACT)


def test_a_jump_is_cut_and_nothing_else():
    """A near square in front of a far wall gives two flat pieces, without the cells across the edge."""
    depth = np.full((48, 64), 0.4)
    depth[10:30, 20:44] = 0.2
    mesh = surface.surface(picture(), depth, K)
    assert set(np.unique(mesh.vertex_m[mesh.triangle][..., 2].min(axis=1))) == {0.2, 0.4}
    np.testing.assert_array_equal(np.ptp(mesh.vertex_m[mesh.triangle][..., 2], axis=1), 0)
    square, hole = 23 * 19, 25 * 21 - 1  # cells; of two at the corners, the half that touches the wall alone stays
    assert area(mesh) == pytest.approx(square * (0.2 / 200) ** 2 + (63 * 47 - hole) * (0.4 / 200) ** 2, rel=EXACT)


def test_unknown_depth_leaves_a_hole():
    depth = np.full((48, 64), 0.4)
    depth[20, 30] = np.nan
    mesh = surface.surface(picture(), depth, K)
    assert len(mesh.triangle) == 2 * 63 * 47 - 6 and np.isfinite(mesh.vertex_m).all()  # six share a vertex


def test_low_confidence_leaves_a_hole():
    confidence = np.full((48, 64), 0.5)
    confidence[20, 30] = 0.99 * surface.LEAST_CONFIDENCE
    mesh = surface.surface(picture(), np.full((48, 64), 0.4), K, confidence=confidence)
    assert len(mesh.triangle) == 2 * 63 * 47 - 6


def test_outliers_are_dropped_with_all_that_belongs_to_them():
    """Set-up: a wall, and before it a speck of 3 x 3 pixels, 0.3 % of the frame, and a box of 20 x 24, 16 %.

    Expectation: pieces below 1 % are gone, the others keep all their triangles.
    """
    depth = np.full((48, 64), 0.4)
    depth[4:7, 4:7], depth[20:40, 30:54] = 0.1, 0.2
    every = surface.surface(picture(), depth, K)
    mesh = surface.surface(picture(), depth, K, smallest_piece=0.01)
    assert set(np.unique(every.vertex_m[:, 2])) == {0.1, 0.2, 0.4} and set(np.unique(mesh.vertex_m[:, 2])) == {0.2, 0.4}
    assert len(every.triangle) - len(mesh.triangle) == 2 * 2 * 2


def test_normals_of_a_tilted_plane_and_of_a_sphere():
    """Expectation: one normal all over a plane, towards the camera; on a sphere (radius 5 cm, centre at 30 cm) those
    of its radii, where it is not seen at a grazing angle.
    """
    y, x = np.indices((48, 64)) + 0.5
    ray = np.stack([(x - 32) / 200, (y - 24) / 200, np.ones_like(x)], -1)
    tilted = np.array([2.0, 1.0, 3.0])
    mesh = surface.surface(picture(), 1 / (ray @ tilted), K)
    np.testing.assert_allclose(mesh.normal @ tilted, -np.linalg.norm(tilted), rtol=EXACT)
    centre, radius = np.array([0, 0, 0.3]), 0.05
    a, b, c = (ray**2).sum(-1), ray @ centre, centre @ centre - radius**2
    with np.errstate(invalid="ignore"):
        depth = (b - np.sqrt(b**2 - a * c)) / a
    mesh = surface.surface(picture(), depth, K)
    radial = (mesh.vertex_m - centre) / radius
    facing = -radial[:, 2] > 0.7
    assert facing.sum() > 1000
    a_facet = 0.25 / 200 / (0.7 * radius)  # rad, by which the sphere turns over a pixel at 25 cm
    assert (mesh.normal * radial).sum(axis=1)[facing].min() > np.cos(a_facet)


def test_a_stride_keeps_place_and_thins_out():
    mesh = surface.surface(picture(), np.full((48, 64), 0.3), K, stride_px=4)
    assert area(mesh) == pytest.approx(60 * 44 * (0.3 / 200) ** 2, rel=EXACT)


def test_files_read_back(tmp_path):
    """PLY files have the camera's axes and a colour per vertex, GLB files y up and the picture as texture."""
    image = picture()
    mesh = surface.surface(image, np.full((48, 64), 0.3), K)
    surface.save_surface(tmp_path / "a.ply", mesh)
    surface.save_surface(tmp_path / "a.glb", mesh)
    ply = trimesh.load(tmp_path / "a.ply", process=False)
    np.testing.assert_allclose(ply.vertices, mesh.vertex_m, rtol=FILE_PRECISION)
    np.testing.assert_array_equal(ply.visual.vertex_colors[:, :3], mesh.picture.reshape(-1, 3))
    assert b"property float nx" in (tmp_path / "a.ply").read_bytes()[:1000]
    assert b'"NORMAL"' in (tmp_path / "a.glb").read_bytes()
    np.testing.assert_allclose(ply.vertex_normals, mesh.normal, atol=FILE_PRECISION)
    glb = trimesh.load(tmp_path / "a.glb", force="mesh", process=False)
    np.testing.assert_allclose(glb.vertex_normals, mesh.normal * [1, -1, -1], atol=FILE_PRECISION)
    np.testing.assert_allclose(glb.vertices, mesh.vertex_m * [1, -1, -1], rtol=FILE_PRECISION)
    np.testing.assert_array_equal(np.asarray(glb.visual.material.baseColorTexture.convert("RGB")), mesh.picture)
    np.testing.assert_allclose(glb.visual.uv, mesh.uv, atol=FILE_PRECISION)


def test_the_cameras_matrix_fits(da_mobile):
    """A pixel at the frame's edge lies at the limit of the field of view: x = z w p / (2 s)."""
    small = cameras.cropped(da_mobile, 64, 48)
    mesh = surface.surface(picture(), np.full((48, 64), 0.3), geometry.intrinsic_matrix(small))
    pitch_m = small.sensor.pixel_pitch_um * 1e-6
    assert np.ptp(mesh.vertex_m[:, 0]) == pytest.approx(0.3 * 63 * pitch_m / geometry.image_distance_m(small))


@pytest.mark.slow
def test_a_distorted_wall_is_straight(renderer, da_mobile):
    """Set-up: the true depths of a wall at an angle, through a lens of 5 % barrel distortion at the corner.

    Expectation: all vertices lie in the wall's plane; without the distortion they are off by millimetres.
    """
    sensor = {"width_px": 64, "height_px": 48, "pixel_pitch_um": 50.0}
    camera = rendering.changed(da_mobile, sensor=sensor, lens={"distortion_per_mm": (0.0125,)})
    wall = {
        "name": "wall",
        "shape": "plane",
        "size_cm": (60, 60),
        "position_cm": (0, 0, 30),
        "rotation_deg": (0, 35, 0),
    }
    shot = dasim.simulate(rendering.make_scene([wall | {"material": "grey-card"}]), camera, spp=1, diffraction="off")
    intrinsic, distortion = surface.intrinsic_matrix(camera), surface.distortion_per_px(camera)
    normal = np.array([-np.sin(np.radians(35)), 0.0, -np.cos(np.radians(35))])

    def off_m(**options):
        mesh = surface.surface(picture(), shot.truth.depth_m, intrinsic, **options)
        return np.abs((mesh.vertex_m - [0, 0, 0.3]) @ normal).max()

    assert off_m(distortion_per_px=distortion) < 1e-6  # metres, of depths in single precision
    assert off_m() > 2e-3


@pytest.mark.parametrize(
    ("arguments", "message"), [({"stride_px": 0}, "stride of 0"), ({"jump_share": 0.0}, "jump of 0")]
)
def test_what_cannot_be_is_refused(arguments, message):
    with pytest.raises(InputError, match=message):
        surface.surface(picture(), np.full((48, 64), 0.3), K, **arguments)


def test_other_files_are_refused(tmp_path):
    with pytest.raises(InputError, match=r"'.ply' or '.glb'"):
        surface.save_surface(tmp_path / "a.stl", surface.surface(picture(), np.full((48, 64), 0.3), K))
    with pytest.raises(InputError, match="nothing to write"):
        surface.save_surface(tmp_path / "a.ply", surface.surface(picture(), np.full((48, 64), np.nan), K))
