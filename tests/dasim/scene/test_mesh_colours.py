"""Mesh files with colours of their own: of vertices, faces and pictures, and smooth normals."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
import trimesh
from trimesh.visual.material import PBRMaterial

from dasim.materials import photographs
from dasim.scene import checks, mesh_merging, mesh_paint, meshes, object_materials
from dasim.spectra.grid import WAVELENGTH_NM
from tests.support import pace

LOADING_PACES = 30.0  # of the reference work; 3 processor s where that takes 0.1
LINEAR_LIMIT = 1e-5  # colours are single precision
SRGB_188 = ((188 / 255 + 0.055) / 1.055) ** 2.4  # 0.5029


def at(picture: np.ndarray, uv: np.ndarray) -> np.ndarray:
    """A picture's value at uv (v up), bilinear between texel centres: written out anew for the tests."""
    height, width = picture.shape[:2]
    x = np.clip(uv[..., 0] * width - 0.5, 0, width - 1)
    y = np.clip((1 - uv[..., 1]) * height - 0.5, 0, height - 1)
    x0, y0 = np.minimum(x.astype(int), max(width - 2, 0)), np.minimum(y.astype(int), max(height - 2, 0))
    x1, y1 = np.minimum(x0 + 1, width - 1), np.minimum(y0 + 1, height - 1)
    fx, fy = (x - x0)[..., None], (y - y0)[..., None]
    above = picture[y0, x0] * (1 - fx) + picture[y0, x1] * fx
    below = picture[y1, x0] * (1 - fx) + picture[y1, x1] * fx
    return above * (1 - fy) + below * fy


def inner_points(mesh: meshes.Part, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Random points on every face: barycentric coordinates [m, 3], places and uv."""
    share = rng.dirichlet((1, 1, 1), len(mesh.faces))
    place = np.einsum("mk,mkx->mx", share, mesh.vertices[mesh.faces])
    assert mesh.uv is not None
    return share, place, np.einsum("mk,mkx->mx", share, mesh.uv[mesh.faces])


@pytest.mark.parametrize("suffix", ["ply", "glb", "obj"])
def test_vertex_colours_run_linearly_over_each_face(tmp_path, suffix):
    """Set-up: a sphere with random colours at its vertices. Expectation: anywhere on a face the picture of its colours
    holds the linear interpolation of the three, in linear light (sRGB decoded; glTF holds linear light already).
    """
    rng = np.random.default_rng(1)
    ball = trimesh.creation.icosphere(subdivisions=2)
    # between 140 and 170 the block's fourth corner, c10 + c01 - c00, stays within 0..1
    colours = rng.integers(140, 170, (len(ball.vertices), 3), dtype=np.uint8)
    ball.visual = trimesh.visual.ColorVisuals(ball, vertex_colors=colours)
    ball.export(tmp_path / f"ball.{suffix}")
    parts = meshes.read(tmp_path / f"ball.{suffix}", 1.0, "ball")
    mesh = mesh_merging.merge_with_colours(parts, "ball")
    share, _, uv = inner_points(mesh, rng)
    decode = (lambda c: c / 255) if suffix == "glb" else lambda c: ((c / 255 + 0.055) / 1.055) ** 2.4
    corners = parts[0].vertices[parts[0].faces]
    # the file's order of vertices is its own: find each by its place
    nearest = np.linalg.norm(corners[:, :, None] - ball.vertices, axis=-1).argmin(axis=-1)
    expected = np.einsum("mk,mkc->mc", share, decode(colours[nearest].astype(float)))
    assert mesh.paint is not None
    np.testing.assert_allclose(at(mesh.paint, uv), expected, atol=LINEAR_LIMIT)
    np.testing.assert_allclose(mesh.vertices[mesh.faces], corners)


def test_face_colours_stay_within_their_faces(tmp_path):
    rng = np.random.default_rng(2)
    ball = trimesh.creation.icosphere(subdivisions=1)
    colours = rng.integers(0, 256, (len(ball.faces), 3), dtype=np.uint8)
    ball.visual = trimesh.visual.ColorVisuals(ball, face_colors=colours)
    ball.export(tmp_path / "ball.ply")
    mesh = mesh_merging.merge_with_colours(meshes.read(tmp_path / "ball.ply", 1.0, "ball"), "ball")
    assert mesh.paint is not None
    _, _, uv = inner_points(mesh, rng)
    np.testing.assert_allclose(at(mesh.paint, uv), mesh_paint.decode_srgb(colours), atol=LINEAR_LIMIT)


def test_parts_with_colours_of_all_kinds_keep_them_in_one_picture(tmp_path):
    """Set-up: a GLB of a textured square whose picture repeats 2 x 3 times, moved vertex-coloured triangles, and a
    box of one colour. Expectation: each shows its own at every place, the square's repeated and not mirrored.
    """
    rng = np.random.default_rng(3)
    from PIL import Image

    picture = rng.integers(0, 256, (16, 8, 3), dtype=np.uint8)
    square = trimesh.Trimesh([[0, 0, 0], [2, 0, 0], [2, 3, 0], [0, 3, 0]], [[0, 1, 2], [0, 2, 3]], process=False)
    square.visual = trimesh.visual.TextureVisuals(
        uv=[[0, 0], [2, 0], [2, 3], [0, 3]], material=PBRMaterial(baseColorTexture=Image.fromarray(picture))
    )
    box = trimesh.creation.box((1, 1, 1))
    box.visual = trimesh.visual.TextureVisuals(material=PBRMaterial(baseColorFactor=[255, 51, 0, 255]))
    ball = trimesh.creation.icosphere(subdivisions=1)
    colours = np.where(ball.vertices[:, :1] > 0, np.uint8([0, 80, 200]), np.uint8([0, 60, 150]))
    ball.visual = trimesh.visual.ColorVisuals(ball, vertex_colors=colours)
    scene = trimesh.Scene([square])
    scene.add_geometry(box, transform=trimesh.transformations.translation_matrix([0, 0, 10]))
    scene.add_geometry(ball, transform=trimesh.transformations.translation_matrix([0, 0, 20]))
    scene.export(tmp_path / "all.glb")
    parts = meshes.read(tmp_path / "all.glb", 0.5, "all")
    assert mesh_merging.colour_kinds(parts) == ["one colour", "texture image", "vertex colours"]
    mesh = mesh_merging.merge_with_colours(parts, "all")
    assert mesh.paint is not None
    for _ in range(20):
        _, place, uv = inner_points(mesh, rng)
        values, place = at(mesh.paint, uv), 2 * place
        on_box = np.abs(place[:, 2] - 10) < 0.51
        np.testing.assert_allclose(values[on_box], np.tile([1, 0.2, 0], (on_box.sum(), 1)), atol=LINEAR_LIMIT)
        on_ball = np.abs(place[:, 2] - 20) < 1.1
        np.testing.assert_allclose(values[on_ball, 2] * 0.4, values[on_ball, 1], atol=0.005)
        flat = np.abs(place[:, 2]) < 0.1
        tile = place[flat, :2] % 1
        away = (np.abs(tile - 0.5) < 0.42).all(axis=-1)  # a half texel from its border at least
        np.testing.assert_allclose(
            values[flat][away], at(mesh_paint.decode_srgb(picture), tile[away]), atol=1e-4
        )  # uv in single precision


def test_obj_with_a_material_library_shows_its_colours_and_pictures(tmp_path):
    """Set-up: a unit square of Kd (1, 0, 0.5) and one beside it with a picture. Expectation: each shows its own, Kd as
    sRGB; a file with texture coordinates and no library has no colours (trimesh makes a grey one up).
    """
    picture = np.random.default_rng(4).integers(0, 256, (8, 8, 3), dtype=np.uint8)
    cv2.imwrite(str(tmp_path / "own.png"), picture[..., ::-1])
    (tmp_path / "two.mtl").write_text("newmtl red\nKd 1 0 0.5\nnewmtl own\nKd 0.2 0.2 0.2\nmap_Kd own.png\n")
    corners = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nv 2 0 0\nv 2 1 0\nvt 0 0\nvt 1 0\nvt 1 1\nvt 0 1\n"
    red, textured = "f 1 2 3\nf 1 3 4\n", "f 2/1 5/2 6/3\nf 2/1 6/3 3/4\n"
    (tmp_path / "two.obj").write_text(f"mtllib two.mtl\n{corners}usemtl red\n{red}usemtl own\n{textured}")
    mesh = mesh_merging.merge_with_colours(meshes.read(tmp_path / "two.obj", 1.0, "two"), "two")
    assert mesh.paint is not None
    for seed in range(10):
        _, place, uv = inner_points(mesh, np.random.default_rng(seed))
        values = at(mesh.paint, uv)
        left = place[:, 0] < 1
        np.testing.assert_allclose(values[left], np.tile([1, 0, 0.2122], (2, 1)), atol=0.005)  # Kd is kept in 8 bits
        image = at(mesh_paint.decode_srgb(picture), place[~left, :2] - [1, 0])
        np.testing.assert_allclose(values[~left], image, atol=1e-4)  # uv in single precision
    (tmp_path / "bare.obj").write_text(corners + textured)
    assert mesh_merging.colour_kinds(meshes.read(tmp_path / "bare.obj", 1.0, "bare")) == []


@pytest.mark.slow
@pytest.mark.parametrize(
    "name", ["plain.ply", "plain.off", "plain.obj", "coloured.ply", "coloured.glb", "coloured.obj"]
)
def test_half_a_million_triangles_load_at_once(loaded, make_scene, tmp_path, name):
    """Expectation: reading, checks and Mitsuba's mesh take at most 30 times the reference work (measured 2 to 18 times,
    the most with coloured.obj, also where other programs use the machine).
    """
    steps = np.linspace(-5, 5, 501)
    x, y = np.meshgrid(steps, steps)
    first = np.arange(500 * 501).reshape(500, 501)[:, :-1].ravel()
    faces = np.concatenate(
        [np.stack([first, first + 1, first + 502], -1), np.stack([first, first + 502, first + 501], -1)]
    )
    mesh = trimesh.Trimesh(np.stack([x, y, np.sin(x)], -1).reshape(-1, 3), faces, process=False)
    assert len(faces) == 500_000
    if name.startswith("coloured"):
        colours = np.random.default_rng(0).integers(0, 256, (len(mesh.vertices), 3), dtype=np.uint8)
        mesh.visual = trimesh.visual.ColorVisuals(mesh, vertex_colors=colours)
    mesh.export(tmp_path / name)
    look = {"near_infrared": "print"} if name.startswith("coloured") else {"material": "brick"}
    item = {"name": "thing", "shape": "mesh", "file": name, "position_cm": (0, 0, 30)} | look
    scene = make_scene(item, folder=tmp_path)

    def load() -> None:
        (tmp_path / name).touch()  # so that nothing is found in a cache
        checks.check_clear(scene, 1e-3)
        loaded(scene)

    assert pace.paces(load, repeats=2) <= LOADING_PACES


@pytest.mark.slow
def test_colours_become_a_material_by_the_named_rule_and_the_capture_says_so(make_scene, wide, tmp_path, renderer):
    """Set-up: a blue square under the achromatic rule, beside the rule's own surface of that blue.

    Expectation: in the truth the infrared pixel sees what the rule's spectrum reflects there; the notes name object,
    file, kind of colours and rule. sRGB 188 is 0.503 in linear light.
    """
    import dasim

    square = trimesh.Trimesh([[-9, -9, 0], [9, -9, 0], [9, 9, 0], [-9, 9, 0]], [[0, 1, 2], [0, 2, 3]], process=False)
    square.visual = trimesh.visual.ColorVisuals(square, vertex_colors=np.tile(np.uint8([0, 0, 188]), (4, 1)))
    square.export(tmp_path / "blue.ply")
    item = {"name": "sheet", "shape": "mesh", "file": "blue.ply", "position_cm": (0, 0, 20)}
    scene = make_scene(item | {"near_infrared": "achromatic"}, folder=tmp_path)
    shot = dasim.simulate(scene, wide(16, 12), spp=16)
    (note,) = [note for note in shot.capture.provenance["notes"] if "sheet" in note]
    assert "blue.ply" in note and "one colour" in note and "'achromatic'" in note
    surface = photographs.photograph_surface(np.full((1, 1, 3), (0, 0, SRGB_188), np.float32), "achromatic")
    white = dasim.simulate(
        make_scene(item | {"material": "white-paper"}, folder=tmp_path), wide(16, 12), spp=16, exposure=dasim.Exposure()
    )
    per_second = [s.truth.sharp_e[4:8, 4:12, 3].mean() / s.capture.exposure_s for s in (shot, white)]
    infrared = WAVELENGTH_NM == 740
    paper = object_materials.surface_of(
        make_scene(item | {"material": "white-paper"}, folder=tmp_path).objects[0], scene
    )
    expected = spectrum(surface)[infrared] / spectrum(paper)[infrared]
    assert per_second[0] / per_second[1] == pytest.approx(float(expected[0]), rel=0.02)


def spectrum(surface) -> np.ndarray:
    """Reflectance of a surface of one texel."""
    if not hasattr(surface, "weight"):
        return surface.reflectance
    share = float(surface.weight.mean())
    return (1 - share) * spectrum(surface.first) + share * spectrum(surface.second)


def test_smooth_normals_are_used_where_the_file_has_them_and_geometry_stays(loaded, make_scene, tmp_path):
    ball = trimesh.creation.icosphere(subdivisions=1)
    for name, keep in (("flat", False), ("smooth", True)):
        ball.export(tmp_path / f"{name}.ply", vertex_normal=keep)
        item = {"name": name, "shape": "mesh", "file": f"{name}.ply", "position_cm": (0, 0, 20), "material": "brick"}
        built = loaded(make_scene(item, folder=tmp_path)).shapes()[0]
        assert built.has_vertex_normals() == keep
