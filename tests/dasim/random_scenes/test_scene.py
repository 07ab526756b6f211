"""Random scenes are valid, reproducible from seed and index, and follow their stated distributions."""

from __future__ import annotations

import numpy as np
import pytest

import dasim
from dasim.camera import geometry
from dasim.camera import specification as cameras
from dasim.camera.specification import Camera
from dasim.random_scenes.specification import RandomScenes
from dasim.scene import shapes
from dasim.scene import specification as scenes
from dasim.simulation.simulate import simulate
from tests.support.drawn_scenes import BACKGROUND, DRAWS, SEED, Measured, near_lights, points_m, small_camera, things

ROUNDING_M = 3e-6  # positions and sizes are rounded to 1e-4 cm each, angles to 1e-4 degrees
LEAST_SPAN = 0.4  # of the range of blur; 60 % less twice the outer bands, in the least lucky of the scenes
SIGMAS = 5.0  # a share over n draws: misses one in two million right generators
CLIPPED_SHARE = 0.02
NOISE_FLOOR_E = 3.0  # the camera's read noise; the median signal of the brightest channel is tenfold at least


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
