"""The search for a shape: gradients against differences, light budgets, features, and what it finds."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

import dasim
from dasim.bounds import cramer_rao
from dasim.camera import specification as cameras
from dasim.cli import run
from tests.support import browser
from validation.studies import criteria
from validation.studies.shape import masks, patch_likelihood
from validation.studies.shape import search as shape
from validation.studies.shape import study as shape_study
from validation.studies.shape.board_likelihood import Reach
from validation.studies.shape.pipeline import Proof
from validation.studies.shape.search import Search

CELLS, BUDGET = 20, 0.2116
BLURS = np.array([5.0, 20.0, 40.0])
STEP = 1e-4  # of amplitudes; differences are good to its square
GRADIENT_TOLERANCE = 1e-3  # relative, of the issue; 1e-6 is reached


@pytest.fixture(scope="module")
def camera() -> dasim.Camera:
    return cameras.refocused(dasim.load_camera("da-mobile"), 0.4)


def bench(camera: dasim.Camera, objective: str = "depth", texture: str = "free", cells: int = CELLS) -> criteria.Bench:
    return criteria.bench(camera, BLURS, cells, budget=BUDGET, objective=objective, texture=texture, fine_cells=32)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("objective", "texture"), [("depth", "known"), ("depth", "spectrum"), ("depth", "free"), ("all-in-focus", "free")]
)
def test_gradients_are_those_of_finite_differences(camera: dasim.Camera, objective: str, texture: str) -> None:
    """Along random directions of all cells at once, and of single cells, at an asymmetric grey mask."""
    at, random = bench(camera, objective, texture), np.random.default_rng(3)
    mask = random.uniform(0.2, 0.8, (CELLS, CELLS)) * masks.inside(CELLS)
    _, slope = criteria.value_and_gradient(at, mask)
    one = np.zeros_like(mask)
    one[4, 9] = 1.0
    for direction in (random.normal(size=mask.shape), random.normal(size=mask.shape), one):
        ends = [criteria.value_and_gradient(at, mask + sign * STEP * direction)[0] for sign in (1, -1)]
        assert (slope * direction).sum() == pytest.approx((ends[0] - ends[1]) / (2 * STEP), rel=GRADIENT_TOLERANCE)


@pytest.mark.parametrize("texture", ["known", "spectrum", "free"])
def test_the_closed_form_is_the_general_bound(camera: dasim.Camera, texture: str) -> None:
    """Against the inverse of the whole covariance matrix, with complex transfer functions of three channels."""
    random = np.random.default_rng(5)
    seen = criteria.sight(camera, "A", 300.0, ("G", "R", "IR"))
    transfer, slope = random.normal(size=(2, 2, 3, 32, 17)) + 1j * random.normal(size=(2, 2, 3, 32, 17))
    variance, _ = criteria.blur_variance(transfer, slope, seen, texture)  # type: ignore[arg-type]
    expected = cramer_rao.blur_deviation(
        transfer, slope, seen.power, seen.noise, width=32, gain=seen.gain, texture=texture,  # type: ignore[arg-type]
        area_px=cramer_rao.window_area_px(31), spacing_px=2.0,
    )  # fmt: skip
    np.testing.assert_allclose(np.sqrt(variance), expected, rtol=1e-9)


def test_the_sharp_pictures_error_is_that_of_the_wiener_filter(camera: dasim.Camera) -> None:
    """Against the filter itself, applied to the covariances: tr(P - K C K^H), with texture of infrared's own."""
    seen, coherence = criteria.sight(camera, "D65", 300.0), 0.7
    random = np.random.default_rng(6)
    transfer = random.normal(size=(1, 2, 32, 17)) + 1j * random.normal(size=(1, 2, 32, 17))
    found, _ = criteria.sharp_error(transfer, seen, coherence)
    s = np.moveaxis(seen.gain[:, None, None] * transfer[0], 0, -1)[..., None]
    alike = np.array([[1, coherence], [coherence, 1]])
    covariance = seen.power[..., None, None] * (s @ np.conj(np.swapaxes(s, -1, -2))) * alike + np.diag(seen.noise)
    across = seen.power[..., None, None] * np.conj(s) * np.array([1, coherence])[:, None]
    best = np.conj(np.swapaxes(across, -1, -2)) @ np.linalg.inv(np.conj(covariance)) @ across
    left = seen.power - best[..., 0, 0].real
    assert found[0] == pytest.approx((left * seen.times).sum() / (seen.power * seen.times).sum(), rel=1e-9)


@pytest.mark.parametrize("symmetry", ["none", "half-turn"])
@pytest.mark.parametrize("beta", [2.0, 16.0])
def test_the_projection_keeps_the_budget_and_its_gradient(symmetry: str, beta: float) -> None:
    search = Search(CELLS, BUDGET, 3.0, symmetry=symmetry)  # type: ignore[arg-type]
    random = np.random.default_rng(7)
    latent = random.uniform(0, 1, (CELLS, CELLS)) * masks.inside(CELLS)
    weight, direction = random.normal(size=(2, CELLS, CELLS))
    direction *= masks.inside(CELLS)
    amplitude, back = shape.projected(latent, search, beta)
    assert masks.budget(amplitude) == pytest.approx(BUDGET, rel=1e-9)
    if symmetry == "half-turn":
        np.testing.assert_allclose(amplitude, amplitude[::-1, ::-1], atol=1e-12)
    ends = [(shape.projected(latent + sign * 1e-5 * direction, search, beta)[0] * weight).sum() for sign in (1, -1)]
    assert (back(weight) * direction).sum() == pytest.approx((ends[0] - ends[1]) / 2e-5, rel=GRADIENT_TOLERANCE)


@pytest.mark.parametrize("diameter", [3, 5])
def test_cut_masks_have_their_budget_and_no_smaller_feature(diameter: int) -> None:
    search = Search(48, BUDGET, diameter)
    for seed in (3, 4):
        mask = shape.cut(shape.filtered(shape.start(search, seed), search), search)
        assert set(np.unique(mask)) == {0.0, 1.0}
        assert masks.budget(mask) == pytest.approx(BUDGET, abs=0.02)  # a level changes a whole patch
        assert masks.smallest_feature(mask) >= diameter


def test_a_search_finds_more_depth_than_the_disc_with_the_same_light(camera: dasim.Camera) -> None:
    """Two windows far apart: their two pictures tell depth as a stereo pair does. 20 % less error, coarsely."""
    at = bench(camera, cells=24)
    found = shape.found(at, Search(24, BUDGET, 3.0, symmetry="half-turn", iterations=8), seed=1)
    disc = masks.disc(24, BUDGET)
    own = bench_of(camera, found.amplitude)
    assert criteria.value(own, found.amplitude) < 0.8 * criteria.value(bench_of(camera, disc), disc)
    np.testing.assert_array_equal(found.amplitude, found.amplitude[::-1, ::-1])
    assert found.history[-1] < found.history[0]


def bench_of(camera: dasim.Camera, mask: np.ndarray) -> criteria.Bench:
    return criteria.bench(camera, BLURS, len(mask), budget=masks.budget(mask))


def test_the_likelihood_of_patches_reaches_its_bound(camera: dasim.Camera) -> None:
    """Of the disc and of two windows: 300 patches know a deviation to 4 %; steps of 0.1 px add 0.03 px."""
    half = masks.disc(32, BUDGET / 2, (0.67, 0.0)) + masks.disc(32, BUDGET / 2, (-0.67, 0.0))
    blurs = np.array([10.0])
    for own in (camera, masks.camera_with(camera, half)):
        error, bound = patch_likelihood.likelihood_errors(own, blurs, patches=300)
        np.testing.assert_allclose(error, np.hypot(bound, 0.03), rtol=0.15)


def test_seeds_are_repeatable(camera: dasim.Camera) -> None:
    at, search = bench(camera), Search(CELLS, BUDGET, 2.0, iterations=2)
    first, again = (shape.found(at, search, 3) for _ in range(2))
    np.testing.assert_array_equal(first.amplitude, again.amplitude)


def test_everything_that_is_wrong_is_said_at_once(tmp_path, capsys) -> None:  # type: ignore[no-untyped-def]
    arguments = "--budget 0 --cells 4 --feature-um 1 --seeds 0 --light nix --near-cm 50"
    assert run(["study", "shape", "--out", str(tmp_path / "out"), *arguments.split()]) == 2
    said = capsys.readouterr().err
    assert said.count("\n") == 1
    for part in ("cells 4", "no light", "seeds 0", "feature 1 um", "near side", "illuminant 'nix'"):
        assert part in said
    assert not (tmp_path / "out").exists()


def test_a_camera_without_infrared_has_nothing_to_shape(tmp_path, capsys) -> None:  # type: ignore[no-untyped-def]
    assert run(["study", "shape", "bayer-mobile", "--out", str(tmp_path / "out")]) == 2
    assert "IR" in capsys.readouterr().err


@pytest.fixture(scope="module")
def study(camera: dasim.Camera) -> Iterator[shape_study.Study]:
    """A coarse study, to be quick; the pipeline takes minutes, so what it finds stands in."""
    small = {"REFERENCE_CELLS": 32, "FINE": 24, "SEARCH_FINE": 24, "BLURS": 2, "SEARCH_BLURS": 2}
    rendered = Proof(((0.1, np.nan),) * 2, ((0.2, np.nan),) * 2, (0.9, 0.0), (20.0, 18.0), (0.3, 0.3), 25.0)
    reached = Reach((0.1, 0.2), (0.1, 0.3), ((0.2, 0.3), (0.2, 0.4)), ((0.1, 0.2), (0.1, 0.1)))
    with pytest.MonkeyPatch.context() as patch:
        for name, value in small.items():
            patch.setattr(shape_study, name, value)
        patch.setattr(shape_study.patch_likelihood, "STEP_PX", 1.0)
        patch.setattr(shape_study, "proof", lambda camera, folder, preset, seed: rendered)
        patch.setattr(shape_study, "reach", lambda camera, folder, light, lux, seed: reached)
        plan = shape_study.Plan(camera, BUDGET, cells=16, feature_um=170.0, seeds=1, iterations=1)
        yield shape_study.studied(plan, render=True)


def test_a_study_writes_its_masks_table_and_page(study: shape_study.Study, tmp_path: Path) -> None:
    shape_study.written(study, tmp_path / "out")
    results = json.loads((tmp_path / "out" / "results.json").read_text())
    assert results["designs"]["disc-0-46"]["depth_ratio"] == 1
    names = {shape_study.slug(row.name) for row in study.rows}
    assert len(names) == len(study.rows)
    for suffix in (".png", ".svg", ".toml"):
        assert {path.stem for path in (tmp_path / "out" / "masks").glob(f"*{suffix}")} == names
    assert len(results["pipeline"]) == 5 * len(shape_study.PRESETS)
    assert set(results["patches"]) == {name.rpartition("-")[0] for name in results["pipeline"]}
    page = (tmp_path / "out" / "report.html").read_text()
    assert "http" not in page.replace("http://www.w3.org/2000/svg", "")
    assert all(row.name.replace("&", "&amp;") in page for row in study.rows)


def test_the_page_opens_in_a_browser_without_complaint(study: shape_study.Study, tmp_path: Path) -> None:
    page = tmp_path / "report.html"
    page.write_text(shape_study.report(study), encoding="utf-8")
    assert browser.screenshot(page).std() > 10, "the page is blank"
