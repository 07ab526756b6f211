"""Claims of the paper's pictures fail when what they show is broken: maps, disks, refocused pictures, eyes, colours."""

from __future__ import annotations

import base64
import dataclasses
import re

import cv2
import numpy as np
import pytest

import recon
from dasim.camera import noise as sensor
from dasim.camera.crosstalk import electronic_crosstalk
from dasim.simulation.exposure import Shot
from dasim.values import Capture, Reconstruction, Truth
from recon.depth import raw_levels
from recon.views import anaglyph
from recon.views.surface import surface
from tests.support import recon_scenes, surfaces
from validation.claims.depth import depth_maps, disks
from validation.claims.pictures import scene_pictures, two_cameras
from validation.claims.table import CLAIMS
from validation.gates.limits import GATES, judged_all, load_gates
from validation.reports import claims, pictures
from validation.reports.page import png_address
from validation.reports.plots import plot
from validation.scores.figures import Figure
from validation.scores.pictures import infrared_free

HEIGHT, WIDTH = 192, 256


def failed(claim: str, figures) -> set[str]:
    """Figures that do not keep their limit, of those that are here."""
    entries = judged_all(claim, figures, load_gates(GATES, CLAIMS))
    return {entry.id.removeprefix(f"{claim}.") for entry in entries if entry.passed is False and "*" not in entry.id}


def truth_of(scene: recon_scenes.Scene, **changes) -> Truth:
    """The truth of a capture without a renderer, one object if not said otherwise."""
    truth = surfaces.truth(scene.capture.camera, scene.level, scene.sharp_e)
    truth = dataclasses.replace(
        truth, mean_e=scene.mean_e, sharp_srgb=np.clip(truth.sharp_srgb, 0, 1), objects=("sheet",)
    )
    return dataclasses.replace(truth, **changes)


@pytest.fixture(scope="module")
def slope() -> tuple[Reconstruction, Truth]:
    """A photograph on a surface from the focus to six levels of blur, and its reconstruction."""
    scene = recon_scenes.make(recon_scenes.slanted(HEIGHT, WIDTH, 0.0, 6.0), photo="gravel")
    exact = truth_of(scene)
    return recon.reconstruct(scene.capture, recon_scenes.bank(("D65",))), exact


# --- depth maps ----------------------------------------------------------------------------------


def test_a_regularised_map_with_noise_fails(slope):
    """Set-up: raw levels with noise of half a level; regularised ones with a tenth of it, with more, or flat."""
    result, exact = slope
    noise = np.random.default_rng(1).normal(0, 0.5, exact.level.shape).astype(np.float32)
    raw = exact.level + noise
    figures = {
        name: depth_maps.figures_of("bands.x", "", dataclasses.replace(result, level_raw=raw, level=level), exact)
        for name, level in {
            "right": exact.level + noise / 10,
            "noisy": raw + noise[::-1],
            "flat": np.full_like(raw, exact.level.mean()),
        }.items()
    }
    assert failed("depth-maps", figures["right"]) == set()
    assert failed("depth-maps", figures["noisy"]) == {f"bands.x.{w}" for w in ("kept-median", "kept-rms", "roughness")}
    assert {"bands.x.order", "bands.x.kept-rms"} <= failed("depth-maps", figures["flat"])


def test_order_of_a_map_turned_over(slope):
    """Expectation: all pairs in order in the truth, none in its negative, half in noise (to 1 % of 100,000 pairs)."""
    _, exact = slope
    noise = np.random.default_rng(2).normal(size=exact.level.shape)
    where = exact.valid
    order = [depth_maps.in_order(level, exact.level, where) for level in (exact.level, -exact.level, noise)]
    assert order[:2] == [1.0, 0.0] and order[2] == pytest.approx(0.5, abs=0.01)


# --- yellow disks --------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def printed() -> tuple[Capture, Truth]:
    """A yellow disk that infrared does not see beside a black one, four levels of blur from the focus."""
    margin, level = recon_scenes.MARGIN_PX, np.full((HEIGHT, 2 * HEIGHT), 4.0)
    y, x = np.mgrid[: HEIGHT + 2 * margin, : 2 * HEIGHT + 2 * margin] - margin
    inside = [np.hypot(y - HEIGHT / 2, x - place) < 44 for place in (0.5 * HEIGHT, 1.5 * HEIGHT)]
    visible, infrared = np.full((*y.shape, 4), 0.8), np.full(y.shape, 0.8)
    visible[inside[0]] *= (0.98, 0.85, 0.3, 1.0)
    visible[inside[1]], infrared[inside[1]] = 0.03, 0.03
    camera = recon_scenes.da_mobile(2 * HEIGHT, HEIGHT)
    white_e = 4500.0
    mean_e = white_e * recon_scenes.blurred(visible, infrared, level, "D65")
    signal = recon_scenes.stop_kernels("D65")[2]
    inner = slice(margin, -margin)
    sharp_e = white_e * (signal[0] * visible[inner, inner] + signal[1] * infrared[inner, inner, None])
    collected_e = electronic_crosstalk(sensor.mosaic(mean_e, camera), camera)
    raw, _ = sensor.expose(collected_e, camera.sensor, 0.02, 3)
    capture = Capture(raw, camera, 0.02, 1.0, 3)
    scene = recon_scenes.Scene(capture, level, mean_e.astype(np.float32), sharp_e.astype(np.float32))
    numbers = (inside[0] + 2 * inside[1])[inner, inner].astype(np.uint32)
    return capture, truth_of(scene, object_id=numbers, objects=("near-yellow", "near-black"))


@pytest.mark.parametrize("fallback", [True, False])
def test_without_the_fall_back_yellow_edges_have_no_level(printed, monkeypatch, fallback):
    capture, exact = printed
    if not fallback:
        monkeypatch.setattr(raw_levels, "_fallbacks", lambda camera: [])
    monkeypatch.setattr(disks, "SHEETS", {"near": "5 cm"})
    bank = recon_scenes.bank(("D65",))
    results = {name: recon.reconstruct(capture, bank, settings) for name, settings in disks.SETTINGS.items()}
    failures = failed("yellow-disks", disks.figures_of(results, exact))
    assert ("near.fallback" in failures) is not fallback
    assert not failures & {"near.infrared", "near.blue", "near.no-fallback", "near.black"}


def test_yellow_that_infrared_sees_fails(printed, monkeypatch):
    """Set-up: an ink with 5 % of contrast in near-infrared."""
    _, exact = printed
    sharp_e = exact.sharp_e.copy()
    sharp_e[..., 3][exact.object_id == 1] *= 0.95
    altered = dataclasses.replace(exact, sharp_e=sharp_e)
    assert [abs(disks.contrasts("near-yellow", one)[3]) <= 0.01 for one in (exact, altered)] == [True, False]


# --- pictures of scenes --------------------------------------------------------------------------


@pytest.mark.parametrize("off_levels", [0.0, 2.0])
def test_refocused_to_the_wrong_level_fails(slope, monkeypatch, off_levels):
    """Set-up: every focus is set two levels nearer than it was asked for."""
    result, exact = slope
    bank, true = recon_scenes.bank(("D65",)), recon.refocus

    def wrong(result, bank, depth_m):
        vergence = 1 / bank.depth_m.astype(float)
        return true(result, bank, 1 / (1 / depth_m + off_levels * (vergence[1] - vergence[0])))

    monkeypatch.setattr(recon, "refocus", wrong)
    figures = scene_pictures.sharpest("x", result, bank, exact)
    assert failed("scene-pictures", figures) == (set() if off_levels == 0 else {"x.stack.own", "x.stack.true"})


@pytest.mark.parametrize("swapped", [False, True])
@pytest.mark.parametrize("where", ["in", "out"])
def test_swapped_eyes_fail(slope, where, swapped):
    _, exact = slope
    left, right = anaglyph.pair(exact.sharp_srgb, exact.depth_m, scene_pictures.STRONGEST_PX, where)
    image = anaglyph.anaglyph(right, left) if swapped else anaglyph.anaglyph(left, right)
    figures = scene_pictures.eyes(f"x.{where}", image, exact.depth_m, where, exact)
    assert failed("scene-pictures", figures) == ({f"x.{where}.shift", f"x.{where}.side"} if swapped else set())


@pytest.mark.parametrize("where", ["in", "out"])
def test_a_few_wild_depths_do_not_change_the_expected_shifts(slope, where):
    """Set-up: one pixel in 200 has twice the vergence of the nearest or half that of the farthest."""
    _, exact = slope
    depth_m = exact.depth_m.copy()
    depth_m[::20, ::20], depth_m[10::20, ::20] = exact.depth_m.min() / 2, exact.depth_m.max() * 2
    left, right = anaglyph.pair(exact.sharp_srgb, depth_m, scene_pictures.STRONGEST_PX, where)
    figures = scene_pictures.eyes(f"x.{where}", anaglyph.anaglyph(left, right), depth_m, where, exact)
    assert not failed("scene-pictures", figures)


def test_all_in_focus_that_is_the_capture_fails(slope):
    result, exact = slope
    same = dataclasses.replace(result, sharp_e=result.linear_e, sharp_rgb=result.rgb)
    failures = failed("scene-pictures", scene_pictures.edges("x", same, exact))
    assert {"x.slope-0-3.gain", "x.slope-3-10.gain", "x.blur.way"} <= failures
    assert not failed("scene-pictures", scene_pictures.edges("x", result, exact)) & {"x.slope-3-10.gain", "x.blur.way"}


def test_halos_fail(slope):
    """Set-up: the sharp truth, and with every gradient a fifth steeper."""
    result, exact = slope
    sharp_e = infrared_free(exact.sharp_e, result.camera, result.light)
    for gain in (1.0, 1.21):
        steeper = dataclasses.replace(result, sharp_e=gain * sharp_e)
        failures = failed("scene-pictures", scene_pictures.edges("x", steeper, exact))
        assert ("x.slope-0-3" in failures) is (gain > 1.15)


# --- two cameras ---------------------------------------------------------------------------------


def test_colours_differ_by_cast_and_not_by_exposure():
    """Expectation: none for twice the exposure; a cast of 15 % in red is above the limit of 1.5."""
    picture = cv2.GaussianBlur(np.random.default_rng(4).uniform(0.1, 1, (64, 64, 3)).astype(np.float32), (0, 0), 2)
    where = np.ones((64, 64), bool)
    assert two_cameras.differences(2 * picture, picture, where).max() < 1e-3  # float32
    cast = picture * np.array([1.15, 1.0, 1.0], np.float32)
    figure = Figure("x.between", float(two_cameras.differences(cast, picture, where).mean()), "dE00", "")
    assert failed("two-cameras", [figure]) == {"x.between"}


def test_noise_and_detail_follow_light_and_blur(printed):
    """Expectation: half the light has sqrt(2) of the relative shot noise, more with read noise, less as noise reduction
    adapts; a Gaussian of 1 px takes from edges that are blurred by 7 px already.
    """
    capture, exact = printed
    developed = recon.develop(capture, lights=["D65"])
    figures = []
    for share in (1.0, 0.5):
        mean_e = share * exact.mean_e
        raw, _ = sensor.expose(
            electronic_crosstalk(sensor.mosaic(mean_e, capture.camera), capture.camera), capture.camera.sensor, 0.02, 3
        )
        shot = Shot(dataclasses.replace(capture, raw_dn=raw), dataclasses.replace(exact, mean_e=mean_e))
        figures.append(two_cameras.noise(shot, recon.develop(shot.capture, lights=["D65"])))
    assert 1.15 < figures[1] / figures[0] < 1.6
    in_focus = dataclasses.replace(exact, blur_px=np.zeros_like(exact.blur_px))
    smooth = dataclasses.replace(developed, linear_e=cv2.GaussianBlur(developed.linear_e, (0, 0), 1.0))
    edges = [two_cameras.detail(Shot(capture, in_focus), one) for one in (developed, smooth)]
    assert edges[1] < 0.95 * edges[0]


# --- pictures ------------------------------------------------------------------------------------


def decoded(address: str) -> np.ndarray:
    data = np.frombuffer(base64.b64decode(address.split(",")[1]), np.uint8)
    return cv2.imdecode(data, cv2.IMREAD_COLOR)[..., ::-1].astype(float) / 255


def test_photographs_keep_their_pixels():
    ramp = np.dstack([*np.meshgrid(np.linspace(0, 1, 64), np.linspace(0, 1, 48)), np.full((48, 64), 0.5)])
    np.testing.assert_allclose(decoded(pictures.photo_address(ramp)), ramp, atol=0.03)  # JPEG's quantisation


def test_maps_share_a_scale_and_gaps_are_grey():
    """Expectation: one depth has one colour in both maps; what has none is grey, as dark as its red, green and blue."""
    first = np.full((30, 40), 0.2)
    second = np.where(np.arange(40) < 20, 0.2, np.nan)[None].repeat(30, axis=0)
    svg = base64.b64decode(pictures.depth_panels([("a", first), ("b", second)], 0.1, 0.4).split(",")[1]).decode()
    one, other = (decoded("," + data) for data in re.findall(r"image/png;base64,([A-Za-z0-9+/=\s]+)", svg)[:2])
    middle = other.shape[1] // 2
    colour = one[one.shape[0] // 2, one.shape[1] // 4]
    assert np.abs(colour - 127 / 255).max() > 0.1
    assert np.abs(one[5:-5, 5:-5] - colour).max() < 0.01 and np.abs(other[5:-5, 5 : middle - 5] - colour).max() < 0.01
    assert np.abs(other[5:-5, middle + 5 : -5] - 127 / 255).max() < 0.01


def test_from_the_right_near_things_stand_to_the_left():
    """Set-up: a near red patch in the middle of a far wall. Expectation: from the front, and only from there, it stays
    in the middle.
    """
    depth_m = np.full((60, 80), 0.4)
    depth_m[20:40, 30:50] = 0.2
    image = np.where(depth_m < 0.3, 1.0, 0.2)[..., None].repeat(3, axis=2) * (1.0, 0.5, 0.5)
    intrinsic = np.array([[200.0, 0, 40], [0, 200.0, 30], [0, 0, 1]])
    body = surface(image, depth_m, intrinsic)
    middle = []
    for yaw_deg in (0.0, 9.0, -9.0):
        view = pictures.in_perspective(body, intrinsic, (60, 80), 0.3, yaw_deg)
        red = (view[..., 0] > 0.9) & (view[..., 1] < 0.7)
        middle.append(float(np.flatnonzero(red.any(axis=0)).mean()) + 0.5)
    assert middle[0] == pytest.approx(40, abs=1) and middle[1] < 37 and middle[2] > 43


def test_from_the_front_a_surface_looks_like_its_picture():
    """Rationale: a pinhole sees each point where the picture shows it, at whatever depth.

    Expectation: the picture itself, up to the half pixel by which triangles of one colour are coarse, but at the cut.
    """
    y, x = np.mgrid[:60, :80]
    image = np.stack([x / 80, y / 60, np.full((60, 80), 0.5)], axis=-1)
    depth_m = np.where(x < 40, 0.2, 0.4 + 0.001 * y)
    intrinsic = np.array([[200.0, 0, 40], [0, 200.0, 30], [0, 0, 1]])
    view = pictures.in_perspective(surface(image, depth_m, intrinsic), intrinsic, (60, 80), 0.3, 0.0)
    inner = np.s_[2:-2, np.r_[2:37, 43:78]]
    assert np.abs(view - image)[inner].max() < 1.5 / 60


def test_rows_of_panels_get_the_whole_width():
    row, single = np.zeros((30, 90, 3)), np.zeros((30, 40, 3))
    assert [claims.wide(png_address(image)) for image in (row, single)] == [True, False]
    assert not claims.wide(pictures.photo_address(row)) and not claims.wide("data:image/svg+xml;base64,AAAA")


@pytest.mark.parametrize(("columns", "rows", "full_width"), [(5, 2, True), (1, 1, False), (2, 1, True)])
def test_rows_of_plots_get_the_whole_width(columns, rows, full_width):
    """Expectation: five panels in half the page's width are too small to read; one plot is not."""
    address = plot(lambda axes: None, columns=columns, rows=rows)
    assert claims.wide(address) is full_width
