"""Random scenes are valid, reproducible from seed and index, and follow their stated distributions."""

from __future__ import annotations

import re
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np
import pytest
import trimesh

import dasim
from dasim import cli
from dasim.base.errors import InputError
from dasim.base.toml import parse
from dasim.camera import geometry
from dasim.camera import specification as cameras
from dasim.camera.specification import Camera
from dasim.random_scenes.scene import PICTURE_PX, by_name
from dasim.random_scenes.specification import RandomScenes
from dasim.scene import checks, object_materials, shapes
from dasim.scene import specification as scenes
from dasim.scene.procedural import library
from dasim.simulation.simulate import simulate
from tests.support import frames

SEED = 11
DRAWS = 200
ROUNDING_M = 3e-6  # positions and sizes are rounded to 1e-4 cm each, angles to 1e-4 degrees
BACKGROUND = ("floor", "wall 1", "wall 2")
LEAST_SPAN = 0.4  # of the range of blur; 60 % less twice the outer bands, in the least lucky of the scenes
SIGMAS = 5.0  # a share over n draws: misses one in two million right generators


@pytest.fixture(scope="module")
def samples() -> list[tuple[dasim.Scene, list[Measured]]]:
    """Scenes with all of their objects, each measured while its meshes are loaded."""
    scenes_drawn = (dasim.random_scene(SEED, index) for index in range(DRAWS))
    return [(scene, [measure(item, scene) for item in things(scene)]) for scene in scenes_drawn]


@pytest.fixture(scope="module")
def all_scenes(samples) -> list[dasim.Scene]:
    return [scene for scene, _ in samples]


class Measured(NamedTuple):
    """An object by its own points, metres: depths, middle (camera axes), lowest level, distance from the lamps."""

    name: str
    item: shapes.Object
    depth: tuple[float, float]
    middle: np.ndarray
    lowest: float
    from_lamps: float


@pytest.fixture(scope="module")
def measured(samples) -> list[list[Measured]]:
    return [layout for _, layout in samples]


def measure(item, scene: dasim.Scene) -> Measured:
    points = points_m(item, scene)
    to_camera = scenes.world_to_camera(scene)
    level = points @ to_camera[:3, 1]  # the second row of the inverse
    lowest = item.position_cm[1] * 1e-2 + item.radius_cm * 1e-2 if isinstance(item, shapes.Sphere) else level.max()
    lamps = [to_camera[:3, :3] @ np.multiply(light.position_cm, 1e-2) for light in near_lights(scene)]
    # An eighth of a mesh's vertices: they lie closer than a millimetre, and the limit is a matter of decimetres.
    distance = min((float(np.sqrt(((points[::8] - lamp) ** 2).sum(axis=-1).min())) for lamp in lamps), default=np.inf)
    depth = points[:, 2]
    middle = (points.min(axis=0) + points.max(axis=0)) / 2
    return Measured(item.name, item, (depth.min(), depth.max()), middle, float(lowest), distance)


def near_lights(scene: dasim.Scene) -> list:
    return [light for light in scene.lights if light.kind in ("lamp", "panel")]


def small_camera(width: int = 64, height: int = 48) -> Camera:
    """A camera with the field of view of the default picture, in few and large pixels."""
    data = cameras.load_camera("da-mobile").model_dump()
    pitch_um = data["sensor"]["pixel_pitch_um"] * PICTURE_PX[0] / width
    data["sensor"] |= {"width_px": width, "height_px": height, "pixel_pitch_um": pitch_um}
    return parse(Camera, data, "small camera")


def things(scene: dasim.Scene) -> list:
    return [item for item in scene.objects if item.name not in BACKGROUND]


def corners_m(item, scene: dasim.Scene) -> np.ndarray:
    """Corners of an object's box in camera axes, [8, 3]."""
    centre, half = shapes.half_extent_m(item, scene.folder)
    matrix = scenes.object_to_camera(item, scene)
    corners = centre + np.array(np.meshgrid(*[(-1, 1)] * 3)).reshape(3, -1).T * half
    return corners @ matrix[:3, :3].T + matrix[:3, 3]


def points_m(item, scene: dasim.Scene) -> np.ndarray:
    """Points whose hull contains an object, in camera axes: the vertices of a mesh, the ends of a ball along z."""
    matrix = scenes.object_to_camera(item, scene)
    if isinstance(item, shapes.Sphere):
        return matrix[:3, 3] + np.array([[0, 0, -1], [0, 0, 1]]) * item.radius_cm * 1e-2
    if isinstance(item, shapes.Mesh):
        if item.file.startswith(library.PREFIX):
            vertices = library.procedural(item.file.removeprefix(library.PREFIX)).vertices * item.unit_cm * 1e-2
            return vertices @ matrix[:3, :3].T + matrix[:3, 3]
        return object_materials.triangles(item, scene.folder).vertices @ matrix[:3, :3].T + matrix[:3, 3]
    if isinstance(item, (shapes.Cylinder, shapes.Disc)):
        turn = np.linspace(0, 2 * np.pi, 48)
        height = item.height_cm / 2 if isinstance(item, shapes.Cylinder) else 0.0
        flat = [np.cos(turn), np.sin(turn), 0 * turn] if height == 0 else [np.cos(turn), 0 * turn, np.sin(turn)]
        ring = np.stack(flat, axis=-1) * item.radius_cm
        local = np.concatenate([ring + np.array((0, side * height, 0)) for side in (-1, 1)]) * 1e-2
        return local @ matrix[:3, :3].T + matrix[:3, 3]
    return corners_m(item, scene)


# --- valid by construction -----------------------------------------------------------------------


def test_every_object_lies_within_the_depth_range(measured):
    """The points of all objects lie within the depth range, and thus never in the lens."""
    near, far = RandomScenes().depth_cm
    for item in (item for scene in measured for item in scene):
        assert item.depth[0] >= near * 1e-2 - ROUNDING_M, item.name
        assert item.depth[1] <= far * 1e-2 + ROUNDING_M, item.name


def test_visible_floor_and_walls_lie_within_the_range(all_scenes):
    """Rays through the picture and its border are intersected analytically with each plane; the first hit counts."""
    near, far = RandomScenes().depth_cm
    for scene in all_scenes:
        depth = background_depth_m(scene)
        assert np.isfinite(depth).all(), scene.name
        assert depth.min() >= near * 1e-2 - ROUNDING_M, scene.name
        assert depth.max() <= far * 1e-2 + ROUNDING_M, scene.name


def background_depth_m(scene: dasim.Scene, camera: Camera | None = None) -> np.ndarray:
    view = dasim.focused(camera or small_camera(), scene)
    matrix = np.linalg.inv(geometry.intrinsic_matrix(view))
    size = (view.sensor.width_px, view.sensor.height_px)
    x, y = np.meshgrid(*(np.linspace(0, side, 41) for side in size))
    rays = np.stack([x, y, np.ones_like(x)], axis=-1) @ matrix.T
    nearest = np.full(x.shape, np.inf)
    for item in scene.objects:
        if item.name in BACKGROUND:
            assert isinstance(item, shapes.Plane)
            to_camera = scenes.object_to_camera(item, scene)
            normal, origin = to_camera[:3, 2], to_camera[:3, 3]
            depth = (normal @ origin) / (rays @ normal)
            place = (rays * depth[..., None] - origin) @ to_camera[:3, :2] / (np.array(item.size_cm) * 0.5e-2)
            hit = (depth > 0) & (np.abs(place) <= 1).all(axis=-1)
            nearest = np.where(hit, np.minimum(nearest, depth), nearest)
    return nearest


@pytest.mark.parametrize(
    ("size_px", "depth_cm"),
    [
        ((512, 384), (5.0, 40.0)),
        ((2048, 1536), (20.0, 80.0)),
        ((128, 512), (50.0, 75.0)),
        ((1536, 1536), (30.0, 400.0)),
    ],
)
def test_other_pictures_and_ranges_are_as_valid(size_px, depth_cm):
    camera = cameras.cropped(cameras.load_camera("da-mobile"), *size_px)
    for index in range(12):
        scene = dasim.random_scene(SEED, index, RandomScenes(depth_cm=depth_cm), camera)
        depth = [*(points_m(item, scene)[:, 2] for item in things(scene)), background_depth_m(scene, camera).ravel()]
        assert np.concatenate(depth).min() >= depth_cm[0] * 1e-2 - ROUNDING_M
        assert np.concatenate(depth).max() <= depth_cm[1] * 1e-2 + ROUNDING_M


def test_objects_are_in_view_and_their_blur_spans_the_range(all_scenes, measured):
    """At least three objects have their middle within the picture, and together they cover a large part of the range of
    blur.

    The first two objects are drawn from the outer 15 % at each end of the range. The range that is left to them begins
    where the floor becomes visible (at most 1.4 times the near end, where 60 % of the blur is left) and ends in front
    of the wall.
    """
    near, far = (value * 1e-2 for value in RandomScenes().depth_cm)
    spans = []
    for scene, layout in zip(all_scenes, measured, strict=True):
        matrix = geometry.intrinsic_matrix(dasim.focused(small_camera(), scene))
        pixels = np.array([item.middle for item in layout]) @ matrix.T
        depth, pixels = pixels[:, 2], pixels[:, :2] / pixels[:, 2:]
        assert ((pixels > 0) & (pixels < (64, 48))).all(axis=-1).sum() >= 3, scene.name
        share = (1 / depth - 1 / far) / (1 / near - 1 / far)
        spans.append(np.ptp(share[(pixels[:, 0] > 0) & (pixels[:, 0] < 64)]))
    assert min(spans) >= LEAST_SPAN
    assert np.median(spans) >= 0.5


def test_objects_rest_on_the_floor_or_on_a_box(all_scenes, measured):
    """The lowest point of each object is at the level of the floor, or at that of a box below it (posters hang).

    Set-up: rooms and table tops. Where an object stands on a box, its own points, seen from above, lie within the
    rectangle of the box, so that nothing of it protrudes. On table tops, nothing stands on anything else.
    """
    raised = 0
    for scene, layout in zip(all_scenes, measured, strict=True):
        floor = next(item for item in scene.objects if item.name == "floor").position_cm[1] * 1e-2
        for item in (item for item in layout if not item.name.startswith("poster")):
            lifted = 0.02 * item.item.radius_cm * 1e-2 if isinstance(item.item, shapes.Disc) else 0.0
            if item.lowest == pytest.approx(floor - lifted, abs=ROUNDING_M):
                continue
            assert any(stands_on(item, box, scene) for box in layout if isinstance(box.item, shapes.Box)), item.name
            assert scene.description.startswith("room")
            raised += 1
    assert raised >= DRAWS / 2  # one for each room at least; half of the scenes are rooms


def stands_on(item: Measured, box: Measured, scene: dasim.Scene) -> bool:
    """Whether the lowest point of an object lies on the top of a box, and the object within the box's rectangle."""
    top = (box.item.position_cm[1] - box.item.size_cm[1] / 2) * 1e-2
    if box is item or item.lowest != pytest.approx(top, abs=2 * ROUNDING_M):
        return False
    to_box = np.linalg.inv(scenes.object_to_camera(box.item, scene))
    points = points_m(item.item, scene) @ to_box[:3, :3].T + to_box[:3, 3]
    return bool((np.abs(points[:, ::2]) <= np.array(box.item.size_cm)[::2] * 0.5e-2 + ROUNDING_M).all())


def test_objects_of_rooms_float_where_the_key_says_so():
    """Expectation: some objects are above the floor and on no box, and tilted; only rooms differ from those at rest."""
    spec = RandomScenes(floating=True)
    free = [dasim.random_scene(SEED, index, spec) for index in range(20)]
    tilted = [item for scene in free for item in things(scene) if item.rotation_deg[2] != 0]
    assert len(tilted) >= 10
    for index, scene in enumerate(free):
        at_rest = dasim.random_scene(SEED, index)
        assert not any(item.rotation_deg[2] for item in things(at_rest))
        assert (scene == at_rest) or scene.description.startswith("room")


def test_lamps_are_out_of_the_picture_and_away_from_all_objects(all_scenes, measured):
    """Nothing is nearer to a lamp's middle than a quarter of the far end of the range: no spot outshines the rest."""
    camera = small_camera()
    least_m = 0.25 * RandomScenes().depth_cm[1] * 1e-2
    for scene, layout in zip(all_scenes, measured, strict=True):
        assert min(item.from_lamps for item in layout) > least_m, scene.name
        for light in near_lights(scene):
            place = scenes.world_to_camera(scene)[:3, :3] @ np.multiply(light.position_cm, 1e-2)
            if place[2] > 0:
                pixel = geometry.intrinsic_matrix(dasim.focused(camera, scene)) @ place
                assert not (np.abs(pixel[:2] / pixel[2] - (32, 24)) < (32, 24)).all(), scene.name


def test_lamps_stand_within_the_room(all_scenes):
    for scene in all_scenes:
        floor = next(item for item in scene.objects if item.name == "floor")
        walls = [item for item in scene.objects if item.name.startswith("wall")]
        for light in near_lights(scene):
            assert light.position_cm[1] < floor.position_cm[1], scene.name
            for wall in walls:
                outwards = shapes.placement(wall)[:3, 2]
                assert outwards @ np.subtract(light.position_cm, wall.position_cm) < 0, scene.name


def test_drawn_scenes_pass_the_checks_of_scenes_that_are_read(all_scenes):
    for scene in all_scenes[:3]:
        checks.check(scene, scene.name)
        checks.check_clear(scene, geometry.aperture_m(small_camera()) / 2)


# --- distributions -------------------------------------------------------------------------------


def share_error(share: float, count: int) -> float:
    return SIGMAS * float(np.sqrt(share * (1 - share) / count))


def test_counts_are_uniform_from_5_to_40(all_scenes):
    """Mean and extremes of 36 equally likely numbers; 200 draws miss the five numbers at one end once in 10^13."""
    counts = np.array([len(things(scene)) for scene in all_scenes])
    assert counts.min() in range(5, 10) and counts.max() in range(36, 41)
    assert counts.mean() == pytest.approx(22.5, abs=SIGMAS * np.sqrt((36**2 - 1) / 12 / DRAWS))


def test_shares_of_rooms_and_of_outdoor_light(all_scenes):
    spec = RandomScenes()
    rooms = np.mean([scene.description.startswith("room") for scene in all_scenes])
    assert rooms == pytest.approx(spec.room_share, abs=share_error(spec.room_share, DRAWS))
    outdoors = np.mean([scene.lights[0].kind in ("daylight", "sky") for scene in all_scenes])
    assert outdoors == pytest.approx(spec.outdoor_share, abs=share_error(spec.outdoor_share, DRAWS))


def test_levels_are_log_uniform_and_lamps_share_them():
    spec = RandomScenes(outdoor_share=0.0, window_share=0.0, objects=(3, 3), lux=(10.0, 1000.0))
    lux = []
    for index in range(60):
        lights = dasim.random_scene(SEED, index, spec).lights
        assert [light.kind for light in lights][-1] == "dome" and 2 <= len(lights) <= 4
        lux.append(sum(light.lux for light in lights[:-1]))
    assert 9.9 <= min(lux) and max(lux) <= 1060  # a lamp gives 2 % at least
    assert np.mean(np.log10(lux)) == pytest.approx(2.0, abs=SIGMAS * 2 / np.sqrt(12 * len(lux)))


def test_focus_is_an_end_of_the_range_unless_drawn():
    assert dasim.random_scene(0, 0).focus_cm == 80.0
    assert dasim.random_scene(0, 0, RandomScenes(focus="near")).focus_cm == 20.0
    within = [dasim.random_scene(0, i, RandomScenes(focus="within", objects=(3, 3))).focus_cm for i in range(20)]
    assert 20 < min(within) and max(within) < 80 and len(set(within)) == 20


def test_illuminants_follow_their_weights():
    spec = RandomScenes(illuminants={"A": 1.0, "blackbody": 1.0}, objects=(3, 3), outdoor_share=0.0)
    names = [dasim.random_scene(SEED, index, spec).lights[0].illuminant for index in range(80)]
    assert np.mean([name == "A" for name in names]) == pytest.approx(0.5, abs=share_error(0.5, len(names)))
    assert all(name == "A" or 2300 <= int(name[10:-1]) <= 6500 for name in names)


def test_exposure_is_drawn_within_its_ranges():
    exposures = [dasim.random_exposure(SEED, index) for index in range(100)]
    assert {exposure.gain for exposure in exposures} == {1.0, 2.0, 4.0}
    assert all(0.6 <= exposure.auto_level <= 0.9 and exposure.time_s is None for exposure in exposures)


# --- the same numbers, the same scene ------------------------------------------------------------


def test_a_sample_depends_on_seed_and_index_alone(all_scenes):
    """The same bytes in any order, and with any other samples."""
    for index in (DRAWS - 1, 5, 0):
        assert dasim.random_scene(SEED, index).model_dump_json() == all_scenes[index].model_dump_json()
    assert len({scene.model_dump_json(exclude={"name"}) for scene in all_scenes}) == DRAWS
    assert dasim.random_scene(0, 1).objects != dasim.random_scene(1, 0).objects


def test_other_numbers_of_objects_leave_lights_room_and_surfaces():
    few, many = (dasim.random_scene(3, 4, RandomScenes(objects=(count, count))) for count in (6, 30))
    assert few.lights == many.lights and few.view == many.view
    assert few.objects[0] == many.objects[0]
    both = few.materials.keys() & many.materials.keys()
    assert both and all(few.materials[name] == many.materials[name] for name in both)


# --- the user's own ------------------------------------------------------------------------------


@pytest.fixture
def mesh_folder(tmp_path: Path) -> Path:
    folder = tmp_path / "meshes"
    folder.mkdir()
    cone = trimesh.creation.cone(radius=3.0, height=7.0)
    cone.export(folder / "cone.ply")
    coloured = trimesh.creation.box((20, 10, 5))
    coloured.apply_translation((100, 40, 3))
    coloured.visual.vertex_colors = np.random.default_rng(0).integers(0, 255, (8, 4)).astype(np.uint8)
    coloured.export(folder / "painted.ply")
    return folder


def test_meshes_of_a_folder_are_used_and_stand_in_range(mesh_folder):
    """Both files appear, whatever their unit and origin; one has colours and gets the rule that was asked for."""
    spec = RandomScenes(meshes=(str(mesh_folder),), mesh_share=1.0, mesh_up="z", mesh_near_infrared="dyed")
    names = set()
    for index in range(4):
        scene = dasim.random_scene(SEED, index, spec)
        checks.check(scene, scene.name)
        for item in things(scene):
            if isinstance(item, shapes.Mesh) and "procedural" not in item.file:
                names.add((Path(item.file).name, item.near_infrared))
                depth = points_m(item, scene)[:, 2]
                assert 0.2 - ROUNDING_M <= depth.min() and depth.max() <= 0.8 + ROUNDING_M
    assert names == {("cone.ply", None), ("painted.ply", "dyed")}


def test_files_and_patterns_name_meshes_and_textures(mesh_folder, tmp_path):
    """Expectation: of a folder with two meshes, the one that a pattern or path names is drawn, and only it; the
    pictures of a scene are those of the pattern, in folders below as well, and a scene that is drawn can be loaded.
    """
    (tmp_path / "pictures" / "deep").mkdir(parents=True)
    for name in ("a.png", "deep/b.png", "deep/c.jpg"):
        cv2.imwrite(str(tmp_path / "pictures" / name), np.full((4, 4, 3), 90, np.uint8))
    for meshes, textures, files, images in (
        (["meshes/c*.ply"], ["pictures/**/*.png"], {"meshes/cone.ply"}, {"pictures/a.png", "pictures/deep/b.png"}),
        (["meshes/painted.ply"], ["pictures/a.png"], {"meshes/painted.ply"}, {"pictures/a.png"}),
    ):
        spec = RandomScenes(meshes=meshes, mesh_share=0.3, textures=textures, folder=tmp_path, objects=(30, 30))
        drawn = [dasim.random_scene(SEED, index, spec) for index in range(4)]
        assert {item.file for scene in drawn for item in things(scene) if item.name.startswith("mesh")} == files
        assert set(re.findall(r'"(pictures/[^"]+)"', "".join(scene.model_dump_json() for scene in drawn))) == images
        checks.check(drawn[0], drawn[0].name)


def test_all_broken_files_of_a_folder_are_named_at_once(mesh_folder):
    (mesh_folder / "broken.obj").write_text("v 1 2\nf 1 2 9\n")
    (mesh_folder / "empty.stl").write_bytes(b"")
    with pytest.raises(InputError, match=r"broken\.obj(.|\n)*empty\.stl"):
        dasim.random_scene(0, 0, RandomScenes(meshes=(str(mesh_folder),)))


def test_folders_without_files_and_broken_pictures_are_errors(tmp_path):
    for places, message in (
        ([str(tmp_path / "none")], "no such file or folder"),
        ([str(tmp_path)], "holds none of"),
        ([f"{tmp_path}/*.ply"], "holds none of"),
    ):
        with pytest.raises(InputError, match=f"meshes .*{message}"):
            dasim.random_scene(0, 0, RandomScenes(meshes=places))
    (tmp_path / "bad.png").write_bytes(b"no picture")
    with pytest.raises(InputError, match=r"bad\.png"):
        dasim.random_scene(0, 0, RandomScenes(textures=(str(tmp_path),)))


def test_a_specification_is_read_from_toml(tmp_path, mesh_folder):
    """Folders are looked up beside the file, and the scene says where they are as the file did."""
    path = tmp_path / "set.toml"
    path.write_text('depth_cm = [5, 40]\nobjects = [5, 6]\nmeshes = ["meshes"]\nmesh_share = 1\n[gains]\n"2" = 1\n')
    scene, exposure = by_name(f"random:{path}:3:4")
    assert exposure.gain == 2.0 and scene.focus_cm == 40.0 and len(things(scene)) in (5, 6)
    files = {item.file for item in things(scene) if isinstance(item, shapes.Mesh)}
    assert files <= {"meshes/cone.ply", "meshes/painted.ply"} and files
    checks.check(scene, scene.name)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("depth_cm = [40, 50]", "1.5 times its nearer end"),
        ("objects = [40, 5]", "the smaller number comes first"),
        ("[illuminants]\nD66 = 1", "illuminant 'D66' is unknown"),
        ("colour = 1", "colour: unknown key"),
        ("objects = [0, 5]", "objects.0: must be greater than or equal to 3"),
    ],
)
def test_bad_specifications_are_named(tmp_path, text, message):
    path = tmp_path / "bad.toml"
    path.write_text(text)
    with pytest.raises(InputError, match=message):
        dasim.load_random_scenes(path)


def test_bad_names_and_numbers_are_named():
    for name in ("random:1", "random:a:2", "random:1:-2", "random:"):
        with pytest.raises(InputError, match="random:SEED:INDEX"):
            by_name(name)
    with pytest.raises(InputError, match="seed is -1"):
        dasim.random_scene(-1, 0)


def test_the_command_line_names_what_is_wrong(tmp_path, capsys):
    assert cli.run(["render", "random:7", "--out", str(tmp_path / "a")]) == 2
    assert "random:SEED:INDEX" in capsys.readouterr().err
    assert cli.run(["render", "random:none.toml:0:1", "--out", str(tmp_path / "a")]) == 2
    assert "'none.toml': no such file" in capsys.readouterr().err


# --- rendered ------------------------------------------------------------------------------------

CLIPPED_SHARE = 0.02
NOISE_FLOOR_E = 3.0  # the camera's read noise; the median signal of the brightest channel is tenfold at least


def check_truth(depth_m: np.ndarray, object_id: np.ndarray, spec: RandomScenes) -> None:
    near, far = (value * 1e-2 for value in spec.depth_cm)
    assert np.isfinite(depth_m).all()
    assert near - ROUNDING_M <= depth_m.min() and depth_m.max() <= far + ROUNDING_M
    assert len(np.unique(object_id)) >= 5


@pytest.mark.parametrize("index", range(4))
def test_every_pixel_sees_something_in_range(renderer, index):
    from dasim.render import translate, truth

    spec = RandomScenes(textured_share=0.0, surfaces=2)
    scene = dasim.random_scene(SEED, index, spec)
    camera = dasim.focused(small_camera(), scene)
    maps = truth.geometry(translate.world(scene, camera).scene, camera)
    check_truth(maps.depth_m, maps.object_id, spec)


@pytest.mark.slow
def test_a_rendered_sample_is_well_exposed(renderer):
    """A sample lies within its range, few of its pixels clip, and most are well lit."""
    # Preparing surfaces is what takes time; those with textures are rendered with the bundled scenes.
    spec = RandomScenes(objects=(5, 8), surfaces=2, textured_share=0.0, background_textured_share=0.0)
    scene = dasim.random_scene(SEED, 8, spec)
    camera, exposure = dasim.focused(small_camera(), scene), dasim.random_exposure(SEED, 8, spec)
    shot = simulate(scene, camera, 0, spp=4, exposure=exposure, diffraction="off")
    check_truth(shot.truth.depth_m, shot.truth.object_id, spec)
    assert shot.capture.provenance["saturated_pixels"] <= CLIPPED_SHARE * shot.capture.raw_dn.size
    assert np.median(shot.truth.mean_e, axis=(0, 1)).max() > 10 * NOISE_FLOOR_E


@pytest.mark.parametrize("count", [2, pytest.param(60, marks=pytest.mark.slow)])
@pytest.mark.parametrize("camera", frames.CAMERAS)
@pytest.mark.parametrize("size", frames.SIZES)
def test_frames_of_any_size_have_valid_scenes(size, camera, count):
    """A share of ``python -m tests.support.frames``, which draws 1,000 seeds for each size and camera."""
    assert list(frames.problems(camera, size, range(count))) == []
