"""Scores, cached banks, the report and results.json: against answers worked out by hand."""

from __future__ import annotations

import json
import math
from dataclasses import replace

import cv2
import numpy as np
import pytest

import recon
from dasim.base.errors import InputError
from dasim.camera import geometry, response_curves
from dasim.camera import specification as cameras
from dasim.spectra import grid
from dasim.values import Capture, Reconstruction, Truth
from recon.picture import infrared
from tests.support import surfaces
from validation import demo
from validation.gates.claim import Claim, write_results
from validation.scores.depth import balanced_error
from validation.scores.figures import Figure
from validation.scores.pictures import blur_effect, infrared_free, psnr
from validation.scores.score import depth_of_level, score
from validation.subjects import rendering

SIZE = (8, 12)
CHECKER = (np.indices(SIZE).sum(axis=0) % 2).astype(np.float32)
ROUNDING = 1e-5  # single precision, a few operations
INTERPOLATED = 0.01  # levels
TEXTURE_E = 1000.0


@pytest.fixture(scope="module")
def camera(da_mobile):
    """A camera whose coatings do not shift, so that a picture can be right to the last digit."""
    camera = cameras.cropped(cameras.refocused(da_mobile, 0.4), SIZE[1], SIZE[0])
    return rendering.changed(camera, lens={"coating_index": 0.0}, sensor={"coating_index": 0.0})


def truth(camera, level, **changes) -> Truth:
    """Ground truth of a fronto-parallel patch of given levels, its picture a checkerboard of 0 and 1000 electrons."""
    image = np.repeat((CHECKER * TEXTURE_E)[..., None], 4, axis=-1)
    image[..., 3] = 0
    result = surfaces.truth(camera, np.broadcast_to(level, SIZE), image)
    return replace(result, **changes)


def reconstruction(camera, exact: Truth, **changes) -> Reconstruction:
    """A reconstruction that is right in everything."""
    colours = exact.sharp_e[..., :3]
    result = Reconstruction(
        rgb=colours / TEXTURE_E,
        sharp_rgb=colours / TEXTURE_E,
        linear_e=colours,
        sharp_e=colours,
        ir_e=exact.sharp_e[..., 3],
        level_raw=exact.level,
        level=exact.level,
        depth_m=exact.depth_m,
        confidence=np.ones(SIZE, np.float32),
        camera=camera,
        light="D55",
        settings={},
        timings_s={},
    )
    return replace(result, **changes)


def scored(result: Reconstruction, exact: Truth) -> list[Figure]:
    size = cameras.cropped(result.camera, SIZE[1], SIZE[0])
    capture = Capture(np.full(SIZE, 200, np.uint16), size, 0.01, 1.0, 0)
    return score(result, capture, exact)


def figures(result: Reconstruction, exact: Truth) -> dict[str, float]:
    return {figure.id: figure.value for figure in scored(result, exact)}


# --- scores of a reconstruction ------------------------------------------------------------------


def test_perfect_reconstruction_has_no_error(camera):
    exact = truth(camera, np.linspace(2, 8, SIZE[1]))
    score = figures(reconstruction(camera, exact), exact)
    assert score["raw.all.coverage"] == 1 and score["raw.far-side.share"] == 0
    for name in ("raw", "regularised"):
        for key in ("level-median", "level-bias", "level-bad-2", "level-ratio", "rmse-dioptre", "abs-rel"):
            assert score[f"{name}.all.{key}"] == pytest.approx(0, abs=ROUNDING), key
    assert score["all-in-focus.blurred.psnr"] == math.inf
    assert score["all-in-focus.blurred.ciede2000"] == 0


def test_constant_offset_is_bias_and_median(camera):
    """Expectation: raw levels 3 too high give median and bias 3 and all pixels off by over 2; 3 too low, bias -3.

    The regularised map is right: it is not what is judged.
    """
    exact = truth(camera, np.linspace(5, 15, SIZE[1]))
    whole = truth(camera, np.linspace(0, 25, SIZE[1]))
    for offset in (3.0, -3.0):
        raw = exact.level + np.float32(offset)
        result = reconstruction(camera, exact, level_raw=raw, level=whole.level, depth_m=whole.depth_m)
        result = replace(result, level=np.sort(whole.level, axis=1), depth_m=-np.sort(-whole.depth_m, axis=1))
        score = figures(result, exact)
        assert score["raw.all.level-median"] == pytest.approx(3.0, abs=INTERPOLATED)
        assert score["raw.all.level-bias"] == pytest.approx(offset, abs=INTERPOLATED)
        assert score["raw.all.level-bad-2"] == 1


def test_raw_levels_are_read_by_the_relation_of_the_regularised_map(camera):
    """Expectation: a level between two of the regularised map has the mean of their inverse depths; NaN stays NaN."""
    exact = truth(camera, np.linspace(0, 20, SIZE[1]))
    result = reconstruction(camera, exact)
    order = np.sort(exact.level[0])
    depth = depth_of_level(np.array([(order[3] + order[4]) / 2, order[7], np.nan]), result)
    depths = -np.sort(-exact.depth_m[0])
    assert 1 / depth[0] == pytest.approx((1 / depths[3] + 1 / depths[4]) / 2)
    assert depth[1] == pytest.approx(depths[7]) and math.isnan(depth[2])


@pytest.mark.parametrize("levels", [np.linspace(0, 5, SIZE[1]), 3.0], ids=["five levels", "one level"])
def test_raw_levels_beyond_the_regularised_map_keep_their_depth(camera, levels):
    """Expectation: a map without outliers hides none of the raw levels; beyond infinity, depth is finite."""
    result = reconstruction(camera, truth(camera, levels))
    outliers = np.array([-0.5, 10.0, 20.0, 28.0])
    exact = [truth(camera, level).depth_m[0, 0] for level in outliers]
    np.testing.assert_allclose(depth_of_level(outliers, result), exact, rtol=1e-3)
    assert np.isfinite(depth_of_level(np.array([-1e3]), result)).all()


def test_ratio_is_against_the_best_constant(camera):
    """A map that is the best constant one has the ratio 1; one with half its error, 1/2."""
    exact = truth(camera, np.broadcast_to(np.linspace(4, 12, 12), SIZE))
    middle = truth(camera, 8.0)
    constant = reconstruction(camera, exact, depth_m=middle.depth_m)
    score = figures(constant, exact)
    assert score["regularised.all.level-ratio"] == pytest.approx(1, abs=0.02)  # constants are tried in steps
    nearer = truth(camera, (exact.level + middle.level) / 2)
    score = figures(reconstruction(camera, exact, depth_m=nearer.depth_m), exact)
    assert score["regularised.all.level-ratio"] == pytest.approx(0.5, abs=0.02)


@pytest.mark.parametrize("level", [0.0, 5.0, 5.3, 1 / 3])
@pytest.mark.parametrize("error", [0.0, 1.0])
def test_ratio_of_a_flat_scene_is_never_a_huge_number(camera, level, error):
    """Rationale: the best constant map of a flat scene is perfect, so nothing can be half as bad.

    Expectation: the ratio says so (NaN or, without error, 0), and is no rounding error's reciprocal.
    """
    exact = truth(camera, np.float32(level) + np.float32(1e-6) * CHECKER)
    wrong = truth(camera, np.float32(level + error))
    ratio = figures(reconstruction(camera, exact, depth_m=wrong.depth_m), exact)["regularised.all.level-ratio"]
    assert not math.isfinite(ratio) or ratio <= 1.0, ratio


def test_pixels_without_estimate_are_not_judged(camera):
    """Expectation: NaN in the raw map is left out of its figures, not counted as an error; it lowers the coverage."""
    exact = truth(camera, np.linspace(5, 15, SIZE[1]))
    raw = exact.level.copy()
    raw[:, :3] = np.nan
    score = figures(reconstruction(camera, exact, level_raw=raw), exact)
    assert score["raw.all.coverage"] == pytest.approx(9 / 12)
    assert score["raw.all.level-median"] == pytest.approx(0, abs=ROUNDING)


def test_capture_without_any_estimate(camera):
    exact = truth(camera, np.linspace(5, 15, SIZE[1]))
    score = figures(reconstruction(camera, exact, level_raw=np.full(SIZE, np.nan, np.float32)), exact)
    assert score["raw.all.coverage"] == 0
    assert math.isnan(score["raw.all.level-median"])
    assert score["regularised.all.level-median"] == pytest.approx(0, abs=ROUNDING)


def test_pixels_where_nothing_is_hit_do_not_count(camera):
    exact = truth(camera, np.linspace(5, 15, SIZE[1]))
    holes = np.zeros(SIZE, bool)
    holes[0] = True
    depth, level = np.where(holes, np.nan, exact.depth_m), np.where(holes, np.nan, exact.level)
    holed = replace(exact, valid=~holes, depth_m=depth, level=level, blur_px=np.where(holes, np.nan, exact.blur_px))
    score = figures(reconstruction(camera, exact), holed)
    assert score["raw.all.level-median"] == pytest.approx(0, abs=ROUNDING) and score["raw.all.coverage"] == 1
    for key in (
        "captured.inner.psnr",
        "captured.inner.ciede2000",
        "regularised.all.rmse",
        "regularised.sparsification",
    ):
        assert math.isfinite(score[key]) or score[key] == math.inf, key


def test_empty_view_is_scored_without_failing(camera):
    nothing = np.full(SIZE, np.nan, np.float32)
    empty = replace(truth(camera, 5.0), valid=np.zeros(SIZE, bool), depth_m=nothing, level=nothing, blur_px=nothing)
    score = figures(reconstruction(camera, truth(camera, 5.0)), empty)
    assert math.isnan(score["raw.all.level-median"]) and math.isnan(score["captured.inner.ssim"])


def test_wrong_side_of_the_focus_is_judged_apart(camera):
    """Expectation: three of twelve columns lie behind the focal plane; their error is not in the others' figures."""
    level = np.linspace(5, 15, SIZE[1])
    level[:3] = -4
    exact = truth(camera, level)
    found_level = exact.level.copy()
    found_level[:, :3] = 4  # what a method that cannot tell the sides finds
    score = figures(reconstruction(camera, exact, depth_m=truth(camera, found_level).depth_m), exact)
    assert score["regularised.far-side.share"] == pytest.approx(3 / 12)
    assert score["regularised.all.level-median"] == pytest.approx(0, abs=ROUNDING)
    assert score["regularised.all.level-bad-2"] == 0 and score["regularised.far-side.level-bad-2"] == 1


@pytest.mark.parametrize(("error_e", "decibel"), [(100.0, 20.0), (10.0, 40.0), (1000.0, 0.0)])
def test_psnr_by_hand(error_e, decibel):
    """Expectation: peak 1000, an error of 1000, 100, 10 everywhere: 0, 20, 40 dB; NaN where nothing is asked for."""
    exact = np.repeat((CHECKER * TEXTURE_E)[..., None], 3, axis=-1).astype(np.float64)
    everywhere = np.ones(SIZE, bool)
    assert psnr(exact + error_e, exact, everywhere) == pytest.approx(decibel)
    assert psnr(exact, exact, everywhere) == math.inf
    assert math.isnan(psnr(exact, exact, ~everywhere))
    for wrong in (math.nan, math.inf):
        broken = exact.copy()
        broken[0, 0] = wrong
        assert math.isnan(psnr(broken, exact, everywhere))


def test_psnr_looks_only_where_it_is_asked():
    exact = np.full((*SIZE, 3), 1000.0)
    image = exact + 100
    image[0] = 1e6
    where = np.ones(SIZE, bool)
    where[0] = False
    assert psnr(image, exact, where) == pytest.approx(20)


def test_sharpness_is_judged_at_3_to_15_pixels_of_blur(camera):
    """Expectation: an error where the blur is too small or too large, or near a boundary, does not count.

    Levels are (1 - alpha) times the blur; the middle columns have 3 to 15 pixels.
    """
    blur = np.array([0, 1, 2.9, 3.1, 5, 7, 9, 11, 14.9, 15.1, 20, 30])
    edge = np.zeros(SIZE, bool)
    edge[:, 5] = True
    exact = truth(camera, blur / geometry.level_blur_px(camera)[1], boundary=edge)
    unjudged = (blur < 3) | (blur > 15)
    unjudged[5] = True
    worse = exact.sharp_e[..., :3] + 100.0 * unjudged[None, :, None].astype(np.float32)
    score = figures(reconstruction(camera, exact, sharp_e=worse), exact)
    assert score["all-in-focus.blurred.psnr"] == math.inf
    better = exact.sharp_e[..., :3] + np.float32(100)
    score = figures(reconstruction(camera, exact, linear_e=better, sharp_e=better / 2 + worse / 2), exact)
    assert score["captured.blurred.psnr"] == pytest.approx(20, abs=ROUNDING)
    assert score["all-in-focus.blurred.psnr-gain"] == pytest.approx(20 * math.log10(2), abs=1e-4)


def test_pictures_are_scored_against_both_truths(camera):
    """Set-up: a truth in focus that is 100 electrons above the pinhole's, an all-in-focus picture that is the former.

    Expectation: it is exact against the one and 20 dB against the other; a truth without the part has no such figures.
    """
    exact = truth(camera, 5.0)
    focus_e = exact.sharp_e + np.float32([100, 100, 100, 0])
    score = figures(reconstruction(camera, exact, sharp_e=focus_e[..., :3]), replace(exact, focus_e=focus_e))
    assert score["all-in-focus.blurred.psnr-focus"] == math.inf
    assert score["all-in-focus.blurred.psnr"] == pytest.approx(20, abs=ROUNDING)
    assert score["captured.blurred.psnr"] == math.inf
    assert score["captured.blurred.psnr-focus"] == pytest.approx(20 * math.log10(11), abs=1e-4), "its peak is 1,100"
    assert {"captured.inner.ssim-focus", "all-in-focus.inner.ciede2000-focus", "truth-focus.blur-effect"} <= set(score)
    assert not [
        name for name in figures(reconstruction(camera, exact), exact) if "focus." in name and "-focus" in name[12:]
    ]


def test_sizes_that_differ_are_refused(camera):
    exact = truth(camera, 5.0)
    result = reconstruction(camera, exact)
    smaller = replace(result, level=result.level[:4], level_raw=result.level_raw[:4])
    with pytest.raises(InputError, match=r"12 x 4 .*12 x 8"):
        figures(smaller, exact)


def test_blur_effect_tells_a_blurred_picture():
    """Rationale: its name and range are scikit-image's; the direction, 0 for sharp, is easily taken the other way."""
    picture = np.repeat(np.random.default_rng(0).random((64, 64, 1)), 3, axis=-1)
    values = [blur_effect(cv2.GaussianBlur(picture, (0, 0), sigma)) for sigma in (0.5, 1.0, 2.0, 4.0)]
    assert values == sorted(values) and 0 <= values[0] and values[-1] <= 1


@pytest.mark.parametrize("removal", ["coefficients", "matrix"])
def test_the_truth_is_of_the_settings_of_the_result(camera, removal):
    """Set-up: a picture that is the true one with infrared removed by the settings. Expectation: no error is left."""
    exact = truth(camera, 5.0)
    image = np.random.default_rng(0).uniform(100, 1000, (*SIZE, 4)).astype(np.float32)
    exact = replace(exact, sharp_e=image, focus_e=None)
    settings = recon.PAPER.model_copy(update={"infrared_removal": removal})
    colours = image @ infrared.separation(camera, "D55", settings).T
    result = reconstruction(camera, exact, sharp_e=colours.astype(np.float32), settings=settings.model_dump())
    assert figures(result, exact)["all-in-focus.blurred.psnr"] > 60


def test_infrared_free_undoes_the_crosstalk(camera):
    """Expectation: near-infrared light of even photon flux leaves nothing in R, G and B; eqs. (7) and (8).

    Signals are photon counts over 650 to 810 nm through the sensor's own curves. Without infrared nothing changes.
    """
    band = (grid.WAVELENGTH_NM >= 650) & (grid.WAVELENGTH_NM <= 810)
    sensor = camera.sensor
    curves = response_curves.rgb_ir_quantum_efficiency() * grid.short_pass(sensor.cutoff_nm, sensor.cutoff_width_nm)
    response = np.trapezoid(curves[:, band], grid.WAVELENGTH_NM[band], axis=-1)
    assert (response[:3] > 0.05 * response[3]).all(), "the colour pixels see infrared, or this test shows nothing"
    left = infrared_free(np.broadcast_to(response, (*SIZE, 4)), camera, "D65")
    np.testing.assert_allclose(left, 0, atol=ROUNDING * response[3])
    visible = np.broadcast_to([10.0, 20.0, 30.0, 0.0], (*SIZE, 4))
    np.testing.assert_array_equal(infrared_free(visible, camera, "D65")[4, 4], [10, 20, 30])


# --- claims and results.json ---------------------------------------------------------------------


def claim_of(name: str, value: float) -> Claim:
    return next(c for c in demo.claims([Figure(name, value, "1", "a figure")]) if c.id == f"demo.{name}")


def test_claims_hold_their_limits():
    assert claim_of("raw.all.level-median", 2.0).passed is True
    assert claim_of("raw.all.level-median", 2.01).passed is False
    assert claim_of("raw.all.level-ratio", 0.5).passed is True
    assert claim_of("all-in-focus.blurred.psnr-gain", 0.0).passed is False
    assert claim_of("raw.all.coverage", 0.1).passed is False
    assert claim_of("raw.all.level-bias", 0.1).passed is None
    for name in demo.LIMITS:
        assert claim_of(name, math.nan).passed is False, "what was not measured has not passed"


def test_a_limit_without_its_figure_is_not_passed_over(camera):
    """Expectation: where a figure with a limit could not be measured, a failed claim says so; it is not left out."""
    exact = truth(camera, np.linspace(5, 15, SIZE[1]))
    blank = reconstruction(camera, exact, level_raw=np.full(SIZE, np.nan, np.float32))
    entries = {claim.id: claim for claim in demo.claims(scored(blank, exact))}
    for name in demo.LIMITS:
        assert f"demo.{name}" in entries, f"{name} is missing"
    assert entries["demo.raw.all.level-ratio"].passed is False


def test_results_follow_their_schema(tmp_path, camera):
    """Expectation: the contract's keys, plain JSON (no NaN or Infinity, which other parsers refuse)."""
    exact = truth(camera, 5.0)
    entries = demo.claims(scored(reconstruction(camera, exact), exact))
    assert any(math.isinf(claim.value) for claim in entries) and any(math.isnan(claim.value) for claim in entries)
    write_results(tmp_path / "results.json", entries, {"render": 1.234})

    def refuse(constant: str) -> None:
        raise AssertionError(f"{constant} is no JSON")

    content = json.loads((tmp_path / "results.json").read_text(), parse_constant=refuse)
    assert content["schema"] == 1
    assert len({claim["id"] for claim in content["claims"]}) == len(content["claims"]) == len(entries)
    for claim in content["claims"]:
        assert set(claim) == {"id", "value", "limit", "unit", "passed", "source", "spread"}
        assert isinstance(claim["id"], str) and isinstance(claim["unit"], str) and isinstance(claim["source"], str)
        assert claim["value"] is None or isinstance(claim["value"], float)
        assert (claim["limit"] is None) == (claim["passed"] is None)
    assert content["timings_s"] == {"render": 1.23}
    assert {"dasim", "mitsuba", "numpy"} <= set(content["software"])


def test_balanced_error_counts_levels_not_pixels():
    """Levels 2, 5 and 8 of 800, 150 and 50 pixels, off by 0, 1 and 3: balanced, the median is the middle one's."""
    true = np.repeat([2.0, 5.0, 8.0], [800, 150, 50])
    error = np.repeat([0.0, 1.0, 3.0], [800, 150, 50])
    map_error, constant, bins = balanced_error(error, true)
    assert map_error == 1.0
    assert constant == pytest.approx(1.5, abs=0.05)  # between two of them
    assert bins == [(2, 0.8, 0.0), (5, 0.15, 1.0), (8, 0.05, 3.0)]


def test_balanced_error_leaves_rare_levels_out():
    true = np.repeat([2.0, 8.0], [990, 10])
    map_error, _, bins = balanced_error(np.where(true == 8, 5.0, 0.5), true)
    assert map_error == 0.5 and len(bins) == 1
