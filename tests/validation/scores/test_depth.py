"""Scores of anybody's depth map: against values worked out by hand, symmetries, and files in the formats people use."""

from __future__ import annotations

import json
import math
from dataclasses import replace

import numpy as np
import OpenEXR
import pytest

from dasim.base.errors import InputError
from dasim.camera import geometry, noise
from dasim.camera import sensor as sensors
from dasim.camera import specification as cameras
from dasim.camera.crosstalk import electronic_crosstalk
from dasim.cli import run
from dasim.files.captures import save_capture
from dasim.files.png import write_png16
from dasim.values import Capture, Truth
from tests.support import surfaces
from validation.scores import depth as depth_scores
from validation.scores import depth_files, texture

SIZE = (48, 64)
ROUNDING = 1e-5  # single precision of the truth
NOISE_MISFIT = 0.1  # in the dark, where half of the noise counts as signal with its own shot noise
FALSE_TEXTURE = 0.01  # share of an even surface that may pass for textured: noise is 31 x 31 pixels' mean


@pytest.fixture(scope="module")
def camera(da_mobile):
    return cameras.cropped(cameras.refocused(da_mobile, 0.4), SIZE[1], SIZE[0])


@pytest.fixture(scope="module")
def step(camera):
    return float(geometry.level_blur_px(camera)[1])


def truth(camera, level, boundary=False) -> Truth:
    return surfaces.truth(camera, np.broadcast_to(level, SIZE), np.full((*SIZE, 4), 1000), boundary)


def at(camera, level):
    return geometry.depth_of_blur_m(camera, np.asarray(level, float) * geometry.level_blur_px(camera)[1])


def halves(left, right):
    return np.where(np.arange(SIZE[1]) < SIZE[1] // 2, left, right)[None, :].repeat(SIZE[0], 0)


ALL = np.ones(SIZE, bool)


def scored(depth, exact, camera, texture=ALL):
    return {score.region: score for score in depth_scores.depth_scores(depth, exact, camera, texture)}


# --- metrics ---------------------------------------------------------------------------------------


def test_a_perfect_map_has_perfect_scores(camera):
    exact = truth(camera, halves(2, 12))
    score = scored(exact.depth_m, exact, camera)["all"]
    assert score.share == score.coverage == 1
    for name, metric in depth_scores.METRICS.items():
        assert score.values[name] == pytest.approx(metric.best, abs=ROUNDING), name


def test_scores_by_hand(camera, step):
    """Set-up: level 4 everywhere; the left half is 3 levels too near, the right half half a level too far."""
    exact = truth(camera, 4.0)
    score = scored(at(camera, halves(7.0, 3.5)), exact, camera)["all"].values
    near, far, true = float(at(camera, 7)), float(at(camera, 3.5)), float(at(camera, 4))
    expected = {
        "level-bias": 1.25,
        "level-std": 1.75,
        "level-median": 1.75,  # between .5 and 3
        "level-bad-1": 0.5,
        "level-bad-2": 0.5,
        "blur-bias": 1.25 * step,
        "blur-std": 1.75 * step,
        "blur-median": 1.75 * step,
        "blur-bad-1": 0.5,  # a level is 1.85 px, so half a level is below 1 px
        "blur-bad-2": 0.5,
        "rmse-dioptre": math.sqrt(((1 / near - 1 / true) ** 2 + (1 / far - 1 / true) ** 2) / 2),
        "abs-rel": (abs(near - true) + abs(far - true)) / 2 / true,
        "rmse": math.sqrt(((near - true) ** 2 + (far - true) ** 2) / 2),
        "delta-1.05": sum(max(d / true, true / d) < 1.05 for d in (near, far)) / 2,
        "delta-1.10": sum(max(d / true, true / d) < 1.10 for d in (near, far)) / 2,
        "delta-1.25": sum(max(d / true, true / d) < 1.25 for d in (near, far)) / 2,
    }
    assert score == pytest.approx(expected, rel=1e-4)


def test_best_constant_map_by_hand(camera):
    """Set-up: two depths, two thirds of the pixels at the far one (levels 2 and 10).

    Expectation: no constant is off by less than the median of its kind: 0, at the more frequent depth; the least
    RMSE in dioptres is the standard deviation, sqrt(2)/3 of the difference; a third is bad at any rate.
    """
    level = np.where(np.arange(SIZE[1] * SIZE[0]) % 3 == 0, 10.0, 2.0).reshape(SIZE)
    exact = truth(camera, level)
    constant = scored(exact.depth_m, exact, camera)["all"].constant
    difference = float(1 / at(camera, 10) - 1 / at(camera, 2))
    assert constant["level-median"] == pytest.approx(0, abs=0.03)
    assert constant["rmse-dioptre"] == pytest.approx(difference * math.sqrt(2) / 3, rel=0.01)
    assert constant["level-bad-1"] == pytest.approx(1 / 3, abs=0.01)
    assert constant["delta-1.05"] == pytest.approx(2 / 3, abs=0.01)


def test_scores_do_not_depend_on_orientation(camera):
    """Expectation: flipping map and truth alike changes nothing; flipping one of them does."""
    rng = np.random.default_rng(3)
    level = np.cumsum(rng.random(SIZE), axis=1) / 4
    exact, flipped = truth(camera, level), truth(camera, level[:, ::-1])
    estimate = at(camera, level + rng.normal(0, 0.5, SIZE))
    one, other = scored(estimate, exact, camera)["all"], scored(estimate[:, ::-1], flipped, camera)["all"]
    assert one.values == pytest.approx(other.values, rel=1e-6)
    assert scored(estimate[:, ::-1], exact, camera)["all"].values["level-median"] > 3 * one.values["level-median"]


def test_regions_part_the_frame(camera):
    """Set-up: left half textured, upper quarter a boundary, lower quarter behind the focus."""
    rows = np.arange(SIZE[0])[:, None]
    exact = truth(camera, np.where(rows < 36, 3.0, -2.0), boundary=rows < 12)
    texture_mask = halves(1, 0).astype(bool)
    estimate = exact.depth_m.copy()
    estimate[:, :8] = np.nan
    score = scored(estimate, exact, camera, texture_mask)
    shares = {name: region.share for name, region in score.items()}
    assert shares == pytest.approx(
        {"all": 0.75, "textured": 0.25, "untextured": 0.25, "boundary": 0.25, "far-side": 0.25}
    )
    assert score["textured"].coverage == pytest.approx(0.75) and score["untextured"].coverage == 1
    assert score["far-side"].values["level-median"] == pytest.approx(0, abs=1e-4), "signed levels: right is right"


def test_an_empty_map_scores_nothing(camera):
    exact = truth(camera, 4)
    score = scored(np.full(SIZE, np.nan), exact, camera)["all"]
    assert score.coverage == 0 and all(math.isnan(value) for value in score.values.values())


def test_maps_of_another_size_are_refused(camera):
    with pytest.raises(InputError, match=r"32 x 48 pixels.*64 x 48"):
        scored(np.ones((48, 32)), truth(camera, 4), camera)


def test_errors_by_true_level(camera):
    """Set-up: true levels 2 and 8, half each; the map is right at 2 and two levels too near at 8."""
    exact = truth(camera, halves(2, 8))
    rows = depth_scores.by_level(at(camera, halves(2, 10)), exact, camera, ALL)
    values = {low: (median, bias) for low, median, bias in rows}
    assert values[1.0] == pytest.approx((0, 0), abs=ROUNDING)
    assert values[6.0] == pytest.approx((2, 2), abs=ROUNDING)
    assert all(math.isnan(values[low][0]) for low in (0.0, 3.0, 12.0))


def test_errors_by_true_level_have_no_end():
    """Expectation: of a lens whose blur exceeds the paper's range, the largest levels count as well."""
    lens = cameras.refocused(cameras.load_camera("da-8mm"), 0.8)
    exact = truth(lens, 45.0)
    rows = depth_scores.by_level(2 * exact.depth_m, exact, lens, ALL)
    assert rows[-1][1] > 10


# --- confidence ------------------------------------------------------------------------------------


def test_sparsification(camera):
    """Expectation: 0 area for confidence in the order of the error; the most for the reverse; between for none."""
    exact = truth(camera, 4)
    error = np.random.default_rng(1).exponential(1.0, SIZE)
    estimate = at(camera, 4 + error)

    def area(confidence):
        return depth_scores.sparsification_area(*depth_scores.sparsification(estimate, confidence, exact, camera))

    assert area(-error) == pytest.approx(0, abs=1e-9)
    assert area(-error) < area(np.zeros(SIZE)) < area(error)
    share, remaining, oracle = depth_scores.sparsification(estimate, np.zeros(SIZE), exact, camera)
    assert share[0] == 1 and [remaining[0], oracle[0]] == pytest.approx([error.mean()] * 2, rel=1e-4)
    # Without confidence what is left out is drawn by chance: of N exponential errors a share k has the mean of all but
    # for a deviation of sqrt((1 / k - 1) / N).
    deviation = np.sqrt((1 / share[:40] - 1) / error.size)
    assert (np.abs(remaining[:40] / error.mean() - 1) < 5 * deviation + 1e-4).all()


# --- texture ---------------------------------------------------------------------------------------


def photographed(camera, image, seed=0) -> Capture:
    electrons = np.repeat(np.asarray(image, float)[..., None], 4, axis=-1)
    collected_e = electronic_crosstalk(noise.mosaic(electrons, camera), camera)
    raw, _ = noise.expose(collected_e, camera.sensor, 0.01, seed)
    return Capture(raw, camera, 0.01, 1.0, seed)


@pytest.mark.parametrize("electrons", [0, 20, 1000, 4000])
def test_noise_is_no_texture(da_mobile, electrons):
    large = cameras.cropped(da_mobile, 512, 512)
    snr = texture.gradient_snr(photographed(large, np.full((512, 512), electrons)))
    assert abs(np.mean(snr)) < NOISE_MISFIT
    assert np.mean(snr > texture.TEXTURE_SNR) <= FALSE_TEXTURE


@pytest.mark.parametrize("name", ["da-mobile", "bayer-mobile", "da-4x4"])
def test_stripes_are_texture_where_they_are(name):
    """Set-up: vertical stripes of 16 px on the left half. Expectation: textured there, less the window, not beside."""
    camera = cameras.cropped(cameras.load_camera(name), 192, 96)
    stripes = np.where(np.arange(192) // 8 % 2 == 0, 600.0, 1000.0) * np.ones((96, 1))
    stripes[:, 96:] = 800
    electrons = np.repeat(stripes[..., None], len(sensors.channels(camera.sensor)), axis=-1)
    collected_e = electronic_crosstalk(noise.mosaic(electrons, camera), camera)
    raw, _ = noise.expose(collected_e, camera.sensor, 0.01, 0)
    mask = texture.textured(Capture(raw, camera, 0.01, 1.0, 0))
    assert mask[:, :80].all() and not mask[:, 96 + 20 :].any()


# --- files and the command -------------------------------------------------------------------------


def write_exr(path, name, values):
    OpenEXR.File({"type": OpenEXR.scanlineimage}, {name: np.ascontiguousarray(values, np.float32)}).write(str(path))


@pytest.mark.parametrize("name", ["map.npy", "map.exr", "map.png"])
def test_depth_is_read_from_each_kind_of_file(tmp_path, name):
    """Expectation: metres as written; NaN, 0 and what is not finite are no estimate."""
    depth = np.linspace(0.1, 2, 12).reshape(3, 4)
    depth[0, 0] = 0
    path = tmp_path / name
    scale = None
    if name.endswith("npy"):
        np.save(path, np.where(depth == 0, np.inf, depth))
    elif name.endswith("exr"):
        write_exr(path, "Z", np.where(depth == 0, np.nan, depth))
    else:
        scale = 1e-4
        write_png16(path, np.rint(depth / scale).astype(np.uint16))
    result = depth_files.read_depth(path, scale)
    assert math.isnan(result[0, 0])
    np.testing.assert_allclose(result.ravel()[1:], depth.ravel()[1:], rtol=1e-3)


@pytest.mark.parametrize(
    ("name", "scale", "message"),
    [
        ("none.npy", None, "does not exist"),
        ("text.npy", None, "cannot be read as an NPY array"),
        ("text.exr", None, "cannot be read as EXR"),
        ("text.jpg", None, r"allowed are \.exr, \.npy, \.png"),
        ("colour.npy", None, r"shape \(3, 4, 3\)"),
        ("zero.npy", None, "no depth at all"),
        ("good.png", None, "--scale"),
        ("good.npy", -1.0, "--scale -1"),
        ("other.exr", None, r"has no channel Z.*it has q"),
    ],
)
def test_what_is_no_depth_map_is_refused(tmp_path, name, scale, message):
    for file in ("text.npy", "text.exr", "text.jpg"):
        (tmp_path / file).write_text("nothing")
    np.save(tmp_path / "colour.npy", np.ones((3, 4, 3)))
    np.save(tmp_path / "zero.npy", np.zeros((3, 4)))
    np.save(tmp_path / "good.npy", np.ones((3, 4)))
    write_png16(tmp_path / "good.png", np.ones((3, 4), np.uint16))
    write_exr(tmp_path / "other.exr", "q", np.ones((3, 4)))
    with pytest.raises(InputError, match=message):
        depth_files.read_depth(tmp_path / name, scale)


@pytest.fixture(scope="module")
def capture_folder(tmp_path_factory, camera):
    folder = tmp_path_factory.mktemp("scored") / "capture"
    stripes = np.where(np.arange(SIZE[1]) // 8 % 2 == 0, 600.0, 1000.0) * np.ones((SIZE[0], 1))
    capture = replace(photographed(camera, stripes), illuminant="D65", provenance={"scene": {"name": "made up"}})
    save_capture(folder, capture, truth(camera, halves(2, 6)))
    return folder


def test_the_command_scores_a_foreign_map(capture_folder, tmp_path, camera, capsys):
    np.save(tmp_path / "mine.npy", at(camera, halves(2, 6) + 0.5))
    np.save(tmp_path / "sure.npy", np.ones(SIZE))
    arguments = ["score", str(tmp_path / "mine.npy"), str(capture_folder), "--json", str(tmp_path / "s.json")]
    assert run([*arguments, "--confidence", str(tmp_path / "sure.npy")]) == 0
    content = json.loads((tmp_path / "s.json").read_text())
    assert content["depth.textured.level-median"]["value"] == pytest.approx(0.5, abs=1e-3)
    assert content["depth.textured.level-median.constant"]["value"] == pytest.approx(2, abs=0.05)
    assert content["depth.sparsification"]["value"] == pytest.approx(0, abs=1e-4), "the error is the same everywhere"
    output = capsys.readouterr().out
    assert "level-median" in output and "textured" in output


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["small.npy"], "64 x 48"),
        (["good.png"], "--scale"),
        (["none.npy"], "none.npy: does not exist"),
        (["good.npy", "--confidence", "small.npy"], "confidence: is 4 x 4"),
    ],
)
def test_the_command_refuses_in_one_line(capture_folder, tmp_path, monkeypatch, capsys, arguments, message):
    monkeypatch.chdir(tmp_path)
    np.save("small.npy", np.ones((4, 4)))
    np.save("good.npy", np.ones(SIZE))
    write_png16(tmp_path / "good.png", np.ones(SIZE, np.uint16))
    assert run(["score", arguments[0], str(capture_folder), *arguments[1:]]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith("dasim: ") and message in line
