"""The bundled targets have the stated positions, colours, angles and sizes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import dasim
from dasim.base.errors import InputError
from dasim.base.toml import parse
from dasim.camera import geometry as camera_geometry
from dasim.camera import noise, radiometry
from dasim.camera import specification as cameras
from dasim.camera.pointspread import psf
from dasim.camera.specification import Camera
from dasim.materials.library import reflectance
from dasim.scene import specification as scenes
from dasim.scene import targets
from dasim.simulation.tiling import margin_px, tiled
from dasim.spectra.colour_checker import PATCHES
from dasim.spectra.grid import integrate
from dasim.values import Capture, Truth

LEVEL_LIMIT = 0.01  # levels; single precision is 1e-4
DEPTH_LIMIT = 1e-5  # relative; single precision
ANGLE_LIMIT_DEG = 0.1
EVEN_LIMIT = 1e-3  # relative: eight standard deviations of 256 samples
PATCH_LIMIT = 0.01  # relative: means of nine pixels of 64 samples, each of four wavelengths
SAME_LIMIT = 1e-4  # of white: the same rays, but for single precision
STEP_LIMIT = 2e-3  # of white: 5 cm of 50 m take 0.2 % of the light, and the near half's back gives a little
STAR_LIMIT = 0.02  # of white: 16 samples on pixels that edges cross
G, IR = 1, 3


@pytest.fixture(scope="module")
def coarse(da_mobile):
    """The lens of da-mobile before a central part of its sensor with pixels ``factor`` times as large."""

    def make(scene, factor: int, width: int, height: int) -> Camera:
        data = da_mobile.model_dump()
        data["sensor"] |= {"width_px": width, "height_px": height, "pixel_pitch_um": 1.7 * factor, "coating_index": 0}
        data["lens"]["coating_index"] = 0  # what is measured here are targets, not coatings off the axis
        return dasim.focused(parse(Camera, data, "coarse camera"), scene)

    return make


@pytest.fixture(scope="module")
def pinhole(renderer, loaded):
    """The picture through a pinhole, electrons a second [h, w, channel], relative to a perfect diffuser's on the axis.

    The diffuser receives the light's lux: L = E / pi.
    """
    from dasim.render import passes

    def picture(scene, camera, spp: int = 16) -> np.ndarray:
        size = (camera.sensor.width_px, camera.sensor.height_px)
        spectrum = scenes.light_spectrum(scene)
        world = loaded(scene)
        field = passes.irradiance_field(world, camera, spectrum, 0.0, spp, 0)
        rate = passes.pinhole_pass(world, camera, passes.Sampling(spp, 0), field)
        assert rate.shape[:2] == size[::-1]
        return rate / integrate(radiometry.response(camera) * spectrum / np.pi)

    return picture


@pytest.fixture(scope="module")
def geometry(renderer, loaded):
    from dasim.render import truth

    return lambda scene, camera: truth.geometry(loaded(scene), camera)


@pytest.fixture(scope="module")
def far(da_mobile):
    """da-mobile at the staircase's focus, 2 m."""
    return dasim.focused(da_mobile, dasim.load_scene("staircase"))


# --- staircase -----------------------------------------------------------------------------------


def test_every_level_of_the_staircase_is_at_its_level(far, geometry):
    small = cameras.cropped(far, 8, 8)
    for level in range(cameras.BLUR_LEVELS):
        maps = geometry(dasim.load_scene(f"staircase:{level}"), small)
        blur_px = camera_geometry.blur_px(small, maps.depth_m)
        np.testing.assert_allclose(0.54 * blur_px, level, atol=LEVEL_LIMIT)  # (1 - alpha) c, sec. 6.1


def test_staircase_reaches_from_focus_to_five_centimetres():
    boards = [dasim.load_scene(f"staircase:{level}").objects[0] for level in (0, 28)]
    assert boards[0].position_cm[2] == pytest.approx(200, rel=1e-12)
    assert boards[1].position_cm[2] == pytest.approx(5.1, abs=0.05)  # the paper's 5 cm is level 28.7
    assert dasim.load_scene("staircase").objects[0].position_cm[2] == pytest.approx(
        dasim.load_scene("staircase:14").objects[0].position_cm[2], rel=1e-3
    )


def test_levels_are_those_of_the_camera_that_is_named():
    other = dasim.load_camera("da-8mm")
    scene = dasim.load_scene("staircase:14", camera=other)
    focused = dasim.focused(other, scene)
    depth_m = scene.objects[0].position_cm[2] * 1e-2
    assert camera_geometry.blur_px(focused, depth_m) / camera_geometry.level_blur_px(focused)[1] == pytest.approx(
        14, rel=1e-9
    )


def test_texture_has_the_same_size_in_the_picture_at_every_level(far, pinhole):
    """Expectation: through a pinhole the nearest and the farthest board look the same; a pixel off they do not."""
    small = cameras.cropped(far, 64, 48)
    first, last = (pinhole(targets.staircase(far, level), small) for level in (0, 28))
    assert np.abs(first - last).mean() < SAME_LIMIT
    assert np.abs(first[:, 1:] - last[:, :-1]).mean() > 100 * SAME_LIMIT
    for channel in (G, IR):
        low, high = np.percentile(first[..., channel], (5, 95))
        assert high > 1.5 * low, "contrast in visible light and near-infrared"


def test_board_fills_the_frame_and_what_blur_brings_into_it():
    """Expectation: the plane is seen half a kernel beyond the sensor's edge, by every bundled camera of that name."""
    for name in cameras.camera_names():
        camera = dasim.load_camera(name)
        board = dasim.load_scene("staircase:28", camera=camera)
        camera = dasim.focused(camera, board)
        px_per_unit = camera_geometry.image_distance_m(camera) / (camera.sensor.pixel_pitch_um * 1e-6)
        size_px = np.multiply(board.objects[0].size_cm, px_per_unit / board.objects[0].position_cm[2])
        reach = margin_px(camera, camera_geometry.level_blur_px(camera)[28])
        assert (size_px / 2 >= np.array([camera.sensor.width_px, camera.sensor.height_px]) / 2 + reach).all(), name


def test_other_textures_are_named_or_refused(far):
    scene = dasim.load_scene("staircase:3:pattern:dead-leaves:2")
    assert scene.materials["texture"].image == "pattern:dead-leaves:2"
    assert targets.staircase(far, 3, "brick").materials["texture"].image == "skimage:brick"


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("staircase:29", "level 29 is not one of 0 to 28"),
        ("staircase:-1", "level -1 is not one of 0 to 28"),
        ("staircase:1.5", "has the form staircase:LEVEL"),
        ("staircase:", "has the form staircase:LEVEL"),
        ("staircase:3:nothing", "image 'skimage:nothing': does not ship"),
        ("point:x", "has the form point:LEVEL"),
        ("depth-steps:5", "has the form depth-steps:DEPTH:STEP"),
        ("depth-steps:5:0", "a step above 0"),
        ("depth-steps:nan:1", "a depth from 1 cm"),
        ("depth-steps:0.5:1", "a depth from 1 cm"),
        ("stairs:3", "scene 'stairs:3' is neither a bundled name"),
    ],
)
def test_wrong_names_are_refused_in_one_line(name, message):
    with pytest.raises(InputError) as caught:
        dasim.load_scene(name)
    assert message in str(caught.value) and "\n" not in str(caught.value)


# --- tiles ---------------------------------------------------------------------------------------


def capture(camera, seed, exposure_s=0.01, blur_px=0.0):
    """A capture of random numbers, each pixel other than all others."""
    shape = (camera.sensor.height_px, camera.sensor.width_px)
    random = np.random.default_rng(seed)
    values = random.random(shape).astype(np.float32)
    per_channel = random.random((*shape, 4)).astype(np.float32)
    truth = Truth(
        depth_m=values,
        valid=values > 0.1,
        normal=per_channel[..., :3],
        object_id=(values * 100).astype(np.uint32),
        material_id=(values * 10).astype(np.uint32),
        blur_px=np.full(shape, blur_px, np.float32),
        level=np.full(shape, seed, np.float32),
        boundary=values > 0.9,
        channels=("R", "G", "B", "IR"),
        mean_e=per_channel,
        sharp_e=per_channel * 2,
        sharp_srgb=per_channel[..., :3],
    )
    return Capture(random.integers(0, 1023, shape, np.uint16), camera, exposure_s, 1.0, seed), truth


@pytest.mark.parametrize(("name", "size"), [("da-mobile", (70, 54)), ("da-4x4", (76, 60))])
def test_tiles_are_the_middles_of_the_captures_on_whole_cells_of_the_mosaic(name, size):
    """Set-up: captures from which an odd number of cells is cut. Expectation: the first is lowest, every pixel is that
    of a capture, near its middle, and of the channel that the picture's mosaic says.
    """
    camera = cameras.cropped(dasim.load_camera(name), *size)
    width, height = 16, 12
    tiles = [capture(camera, seed) for seed in range(3)]
    picture, exact = tiled(tiles, width, height)
    assert picture.raw_dn.shape == (36, 16) == (picture.camera.sensor.height_px, picture.camera.sensor.width_px)
    channels, mine = cameras.mosaic_channels(camera), cameras.mosaic_channels(picture.camera)
    cell = len(camera.sensor.mosaic)
    for seed, (shot, truth) in enumerate(tiles):
        rows = slice((2 - seed) * height, (3 - seed) * height)
        assert (exact.level[rows] == seed).all()
        place = np.argwhere(shot.raw_dn == picture.raw_dn[rows][0, 0])
        place = next(p for p in place if (exact.depth_m[rows][0, 0] == truth.depth_m[tuple(p)]))
        part = (slice(place[0], place[0] + height), slice(place[1], place[1] + width))
        np.testing.assert_array_equal(picture.raw_dn[rows], shot.raw_dn[part])
        np.testing.assert_array_equal(exact.mean_e[rows], truth.mean_e[part])
        np.testing.assert_array_equal(exact.valid[rows], truth.valid[part])
        np.testing.assert_array_equal(mine[rows], channels[part])
        assert (np.abs(place - np.subtract(size[::-1], (height, width)) / 2) < cell).all()


def test_labels_of_tiles_keep_their_names(far):
    """Set-up: two captures with one object each, of different names. Expectation: every pixel's number leads to the
    name that it had.
    """
    small = cameras.cropped(far, 64, 48)
    tiles = []
    for seed, name in enumerate(["first", "second"]):
        shot, truth = capture(small, seed)
        own = (truth.depth_m > 0.5).astype(np.uint32)
        tiles.append((shot, replace(truth, objects=(name,), object_id=own, materials=("paper",), material_id=own)))
    _, exact = tiled(tiles, 16, 12)
    assert exact.objects == ("first", "second") and exact.materials == ("paper",)
    assert set(np.unique(exact.object_id[12:])) == {0, 1} and set(np.unique(exact.object_id[:12])) == {0, 2}
    assert exact.material_id.max() == 1


def test_full_wells_of_tiles_are_counted(far):
    """Set-up: a converter that is not at its end where the well is full."""
    body = far.sensor.model_copy(update={"dn_per_e": 0.1})
    small = cameras.cropped(far.model_copy(update={"sensor": body}), 64, 48)
    shot, truth = capture(small, 0)
    full_dn, _ = noise.expose(np.full((48, 64), 1e6), small.sensor, 0.01, 0)
    picture, _ = tiled([(replace(shot, raw_dn=full_dn), truth)], 16, 12)
    assert full_dn.max() < 1023 and picture.provenance["saturated_pixels"] == 16 * 12


def test_tiles_that_do_not_fit_are_refused(far):
    small = cameras.cropped(far, 64, 48)
    good = capture(small, 0)
    for tiles, size, message in (
        ([], (16, 12), "at least one capture"),
        ([good], (15, 12), "multiples of the mosaic, 2x2"),
        ([good, capture(small, 1, exposure_s=0.02)], (16, 12), "tile 1: exposed 0.02 s"),
        ([good, capture(cameras.refocused(small, 1.0), 1)], (16, 12), "tile 1: its camera, focus"),
        ([good, capture(small, 1, blur_px=50.0)], (16, 12), "tile 1: its blur reaches"),
        ([capture(cameras.cropped("da-mobile", 64, 48, at_px=(0, 0)), 0)], (16, 12), "off the optical axis"),
    ):
        with pytest.raises(InputError, match=message):
            tiled(tiles, *size)


def test_margin_holds_the_widest_kernel(far):
    """Expectation: of a point at level 28, 98 % of the light of every channel lands within the margin of its place."""
    blur = float(camera_geometry.level_blur_px(far)[28])
    margin = margin_px(far, blur)
    depth_m = float(camera_geometry.depth_of_blur_m(far, blur))
    for channel in ("G", "IR"):
        assert psf(far, depth_m, channel, "D65", size=2 * margin + 1).sum() > 0.98


# --- the other targets ---------------------------------------------------------------------------


@pytest.mark.parametrize(("depth_cm", "step_cm"), [(5.0, 0.05), (20.0, 1.0), (200.0, 75.0)])
def test_depth_steps_are_at_their_depths_and_meet_in_the_middle(da_mobile, geometry, depth_cm, step_cm):
    scene = dasim.load_scene(f"depth-steps:{depth_cm}:{step_cm}")
    maps = geometry(scene, dasim.focused(cameras.cropped(da_mobile, 16, 8), scene))
    np.testing.assert_allclose(maps.depth_m[:, :8], depth_cm * 1e-2, rtol=DEPTH_LIMIT)
    np.testing.assert_allclose(maps.depth_m[:, 8:], (depth_cm + step_cm) * 1e-2, rtol=DEPTH_LIMIT)


def test_only_blur_tells_a_depth_step(da_mobile, pinhole):
    """Expectation: through a pinhole a small and a large step look the same but for a thin seam, light and texture."""
    small, large = (dasim.load_scene(f"depth-steps:20:{step}") for step in (0.1, 5))
    camera = dasim.focused(cameras.cropped(da_mobile, 64, 48), small)
    first, second = (pinhole(scene, camera) for scene in (small, large))
    seam = slice(30, 34)
    off = np.delete(np.abs(first - second).mean(axis=(0, 2)), seam)
    assert off.max() < STEP_LIMIT
    assert np.abs(first[:, 34:-1] - first[:, 35:]).mean() > 10 * STEP_LIMIT, "there is texture to be seen"


def test_colour_checker_has_its_patches_in_order_with_their_colours(coarse, pinhole, geometry):
    """Expectation: four rows of six from dark skin at the top left, each what the response integrates to over the
    patch's reflectance: rho E / pi, with cos^4 of the chart's place.
    """
    scene = dasim.load_scene("colour-checker")
    camera = coarse(scene, 8, 64, 48)
    picture, labels = (
        pinhole(scene, camera, 64) / radiometry.relative_illumination(camera)[..., None],
        geometry(scene, camera),
    )
    spectrum = radiometry.response(camera) * scenes.light_spectrum(scene)
    pitch_px = 4.6 / 130 * camera_geometry.image_distance_m(camera) / 1.7e-6 / 8
    for number, patch in enumerate(PATCHES):
        row, column = divmod(number, 6)
        x, y = int(32 + (column - 2.5) * pitch_px), int(24 + (row - 1.5) * pitch_px)
        assert scene.objects[labels.object_id[y, x] - 1].material == patch
        expected = integrate(spectrum * reflectance(patch)) / integrate(spectrum)
        patch_mean = picture[y - 1 : y + 2, x - 1 : x + 2].mean(axis=(0, 1))
        np.testing.assert_allclose(patch_mean, expected, rtol=PATCH_LIMIT, err_msg=patch)


def test_slanted_edges_are_turned_by_five_degrees(coarse, pinhole):
    """Set-up: rows across the left edge and columns across the upper one; where a row's brightness changes is the
    mean of its values between black and white. Expectation: straight lines of slope tan 5 degrees, black against white
    in green and near-infrared.
    """
    scene = dasim.load_scene("slanted-edge")
    picture = pinhole(scene, coarse(scene, 2, 160, 160))
    for channel in (G, IR):
        image = picture[..., channel]
        upright, level = image[50:110, 5:50], image[5:50, 50:110].T  # each from white to black
        for part, turn in ((upright, -5.0), (level, 5.0)):
            white, black = part[:, :8].mean(), part[:, -8:].mean()
            assert white > 20 * black
            place = ((part - black) / (white - black)).sum(axis=1)
            slope = np.polyfit(np.arange(len(place)), place, 1)[0]
            assert np.degrees(np.arctan(slope)) == pytest.approx(turn, abs=ANGLE_LIMIT_DEG)


def test_siemens_star_is_centred_and_has_36_pairs_of_sectors(coarse, pinhole):
    """Expectation: half a turn about the frame's centre changes nothing (36 is even), and circles around it have 36
    periods, in phase at every radius.
    """
    scene = dasim.load_scene("siemens-star")
    picture = pinhole(scene, coarse(scene, 2, 160, 120))
    turned = picture[::-1, ::-1]
    assert np.abs(picture - turned).mean() < STAR_LIMIT < 0.1 * np.abs(picture - turned[:, ::-1]).mean()
    turn = np.linspace(0, 2 * np.pi, 1024, endpoint=False)
    for radius in (30, 45, 58):
        x, y = (80 + radius * np.cos(turn)).astype(int), (60 + radius * np.sin(turn)).astype(int)
        for channel in (G, IR):
            spectrum = np.fft.rfft(picture[y, x, channel])
            assert np.argmax(np.abs(spectrum[1:])) + 1 == 36
            assert np.angle(spectrum[36]) == pytest.approx(-np.pi / 2, abs=0.2)


def test_flat_is_even_to_cos4_over_the_whole_frame(coarse, pinhole):
    """Expectation: at every pixel of the full field of view rho E / pi times the relative illumination."""
    scene = dasim.load_scene("flat")
    camera = coarse(scene, 24, 84, 64)
    spectrum = radiometry.response(camera) * scenes.light_spectrum(scene)
    expected = integrate(spectrum * reflectance("grey-card")) / integrate(spectrum)
    flattened = pinhole(scene, camera, 256) / radiometry.relative_illumination(camera)[..., None]
    np.testing.assert_allclose(flattened, np.broadcast_to(expected, flattened.shape), rtol=EVEN_LIMIT)


@pytest.mark.parametrize("level", [0, 14, 28])
def test_point_is_at_its_level_and_small(far, level):
    hole = targets.point_source(far, level).lights[0]
    depth_m = hole.position_cm[2] * 1e-2
    assert 0.54 * camera_geometry.blur_px(far, depth_m) == pytest.approx(level, abs=1e-9)
    per_pixel_m = depth_m * 1.7e-6 / camera_geometry.image_distance_m(far)
    assert 0.4 < 2 * hole.radius_cm * 1e-2 / per_pixel_m < 0.5


def test_point_shines_in_the_middle_with_the_light_that_it_says(far, renderer, loaded):
    """Set-up: the hole in focus through the open stop without diffraction. Expectation: a disc of radius r at depth d
    that gives E lux has the radiance E (r^2 + d^2) / (pi r^2) and covers pi (r / pixel)^2 pixels, whatever they
    measure; in the middle of the frame. Limit: of the samples that meet it, 65,536 a pixel, four standard deviations.
    """
    from dasim.render import passes

    camera = cameras.cropped(far, 8, 8)
    scene = dasim.load_scene("point:0")
    spp, hole = 65_536, scene.lights[0]
    radius_px = hole.radius_cm / hole.position_cm[2] * camera_geometry.image_distance_m(far) / 1.7e-6
    limit = 4 / np.sqrt(spp * np.pi * radius_px**2)
    stop = camera.stops[0]
    rate = passes.stop_pass(
        loaded(scene),
        camera,
        stop,
        passes.Sampling(spp, 0),
        diffraction="off",
        max_blur_px=1.0,
        illuminant="A",
        field=None,
    )
    response = integrate(radiometry.stop_response(camera, stop) * scenes.light_spectrum(scene))
    expected = response * (hole.position_cm[2] / hole.radius_cm) ** 2 / np.pi * np.pi * radius_px**2
    np.testing.assert_allclose(rate.sum(axis=(0, 1)), expected, rtol=limit)
    assert rate[3:5, 3:5].sum() == pytest.approx(rate.sum(), rel=1e-6)
    np.testing.assert_allclose(rate[3:5, 3:5].sum(axis=-1) / rate.sum(), 0.25, atol=limit / 2)
