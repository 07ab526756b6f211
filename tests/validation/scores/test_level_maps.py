"""Scores of maps of levels with a standard deviation: values worked out by hand, known distributions, symmetries."""

from __future__ import annotations

import math

import numpy as np
import pytest

from dasim.base.errors import InputError
from dasim.camera import geometry
from dasim.camera import specification as cameras
from tests.support import surfaces
from validation.scores import level_maps
from validation.scores.depth import depth_scores
from validation.scores.level_maps import bound_ratios, half_coverage_error, level_dioptres, map_scores

SIZE = (48, 64)
ROUNDING = 1e-5  # single precision of the truth
TEXTURE = np.arange(SIZE[1]) < SIZE[1] // 2
WITHIN_ONE_SD = 0.6827  # of a normal distribution
MANY = 200_000
SHARE_SD = 5 * math.sqrt(0.25 / MANY)  # five standard deviations of a share


@pytest.fixture(scope="module")
def camera(da_mobile):
    return cameras.cropped(cameras.refocused(da_mobile, 0.4), SIZE[1], SIZE[0])


def truth(camera, level, boundary=False):
    return surfaces.truth(camera, np.broadcast_to(level, SIZE), np.full((*SIZE, 4), 1000), boundary)


def halves(left, right):
    return np.where(TEXTURE, left, right)[None, :].repeat(SIZE[0], 0).astype(float)


def scored(camera, level, exact, sd=0.0):
    texture = np.broadcast_to(TEXTURE, SIZE)
    return map_scores(level, np.broadcast_to(sd, SIZE), exact, texture, level_dioptres(camera))


def test_every_score_has_a_meaning(camera):
    assert set(scored(camera, halves(2, 12), truth(camera, halves(2, 12)))) == set(level_maps.MEANINGS)


def test_the_truth_is_perfect(camera):
    scores = scored(camera, truth(camera, halves(2, 12)).level, truth(camera, halves(2, 12)))
    for name in ("all.rmse", "all.rmse-ratio", "all.error", "all.error-median", "half.error-median"):
        assert scores[name] == 0, name
    assert scores["all.within-sd"] == 1


def test_scores_by_hand(camera):
    """Set-up: levels 2 (textured) and 10 (not); the map is 1 level too near on the left, 3 too far on the right."""
    scores = scored(camera, halves(3, 7), truth(camera, halves(2, 10)), halves(1.5, 2.0))
    rms = math.sqrt((1 + 9) / 2)
    expected = {
        "all.share": 1,
        "textured.share": 0.5,
        "boundary.share": 0,
        "all.rmse": rms * level_dioptres(camera),
        "all.rmse-ratio": rms / 4,  # the best constant is 6
        "all.error": 2,
        "all.error-constant": 4,
        "textured.error-median": 1,
        "untextured.error-median": 3,
        "all.within-sd": 0.5,
        "half.error-median": 1,
    }
    assert {name: scores[name] for name in expected} == pytest.approx(expected, abs=ROUNDING)
    assert math.isnan(scores["textured.rmse-ratio"]), "one level has no spread, and its best constant no error"
    assert math.isnan(scores["boundary.error"])


def test_dioptres_are_those_of_the_depths(camera):
    """Expectation: RMSE and best constant are those of the scores of depth maps, which work in metres."""
    random = np.random.default_rng(2)
    exact = truth(camera, np.cumsum(random.random(SIZE), axis=1) / 5)
    level = np.maximum(exact.level + random.normal(0, 1, SIZE), 0)
    depth_m = geometry.depth_of_blur_m(camera, level * geometry.level_blur_px(camera)[1])
    (other,) = (s for s in depth_scores(depth_m, exact, camera, np.ones(SIZE, bool)) if s.region == "all")
    scores = scored(camera, level, exact)
    assert scores["all.rmse"] == pytest.approx(other.values["rmse-dioptre"], rel=1e-3)
    constant = scores["all.rmse"] / scores["all.rmse-ratio"]
    assert constant == pytest.approx(other.constant["rmse-dioptre"], rel=0.01)


def test_no_constant_is_better_than_the_best(camera):
    exact = truth(camera, halves(1, 6))
    ratios = [scored(camera, np.full(SIZE, c), exact)["all.rmse-ratio"] for c in np.linspace(0, 8, 81)]
    assert min(ratios) == pytest.approx(1, abs=ROUNDING)


def test_the_far_side_does_not_count(camera):
    exact = truth(camera, halves(3, -4))
    scores = scored(camera, halves(3, 20), exact)
    assert scores["all.error"] == 0 and scores["all.share"] == 1 and scores["untextured.share"] == 0


@pytest.mark.parametrize(("factor", "share"), [(1.0, WITHIN_ONE_SD), (0.5, 0.3829), (math.inf, 1.0), (0.0, 0.0)])
def test_calibration(da_mobile, factor, share):
    """Set-up: normal errors of a standard deviation that varies by pixel, of which a multiple is stated."""
    camera = cameras.cropped(da_mobile, 512, 400)
    random = np.random.default_rng(4)
    exact = surfaces.truth(camera, np.full((400, 512), 5.0), np.full((400, 512, 4), 1000))
    sd = random.uniform(0.2, 2, (400, 512))
    level = exact.level + sd * random.standard_normal((400, 512))
    scores = map_scores(level, factor * sd, exact, np.ones((400, 512), bool), level_dioptres(camera))
    assert scores["all.within-sd"] == pytest.approx(share, abs=SHARE_SD + 2e-4)


def test_half_coverage():
    """Expectation: the surer half; with one standard deviation for all, a half that does not depend on the error."""
    error = np.repeat([0.1, 3.0], 1000)
    assert half_coverage_error(error, error) == pytest.approx(0.1)
    assert half_coverage_error(-error, -error) == pytest.approx(3.0)
    assert half_coverage_error(error, np.where(error > 1, np.inf, 1.0)) == pytest.approx(0.1)
    spread = np.linspace(0, 1, 2001)
    assert half_coverage_error(spread, np.ones(2001)) == pytest.approx(0.5, abs=0.06)  # 2.7 sd of 1000 drawn
    assert math.isnan(half_coverage_error(np.zeros(0), np.zeros(0)))


def test_bias_near_the_focus(camera):
    """Set-up: true level 1 on the left and 5 on the right; 0.7 too near and 2 too far there."""
    scores = scored(camera, halves(0.3, 7), truth(camera, halves(1, 5)), halves(0.4, 9))
    expected = {"share": 0.5, "bias": -0.7, "abs-bias": 0.7, "rms": 0.7, "sd": 0.4}
    found = {name: scores[f"near-focus.{name}"] for name in expected}
    assert found == pytest.approx(expected, abs=ROUNDING)
    unknown = scored(camera, halves(1, 5), truth(camera, halves(1, 5)), np.inf)
    assert unknown["near-focus.sd"] == level_maps.LARGEST_SD
    far = scored(camera, halves(4, 5), truth(camera, halves(4, 5)))
    assert far["near-focus.share"] == 0 and math.isnan(far["near-focus.bias"])


@pytest.mark.parametrize("factor", [1.0, 2.0])
def test_errors_at_the_bound_have_a_ratio_of_one(factor):
    """Set-up: normal errors at the bound, or at twice the bound, and a few pixels of larger blur."""
    random = np.random.default_rng(6)
    blur = np.concatenate([random.uniform(3, 15, MANY), np.full(level_maps.FEWEST_PX - 1, 20.0)])
    bound = 0.02 * blur
    rows = bound_ratios(factor * bound * random.standard_normal(len(blur)), bound, blur)
    assert [row[0] for row in rows] == [4.5, 7.5, 10.5, 13.5]
    # The median of |x| of n normal x has a relative deviation of 1.17 / sqrt(n), 0.5 % of 50,000.
    assert np.array(rows)[:, 1:] == pytest.approx(factor, rel=0.025)


def test_another_size_is_refused(camera):
    with pytest.raises(InputError, match="map of levels: is 32 x 48 pixels"):
        map_scores(np.ones((48, 32)), np.ones((48, 32)), truth(camera, 4), np.ones(SIZE, bool), 1.0)
