"""Checks on the checks of colour, truth and datasets: each gate fails where what it is for is broken."""

from __future__ import annotations

import numpy as np
import pytest

from dasim.spectra import grid
from tests.support.gates import entries, verdicts
from validation.claims.cost import datasets, scenes
from validation.claims.depth import ground_truth
from validation.claims.optics import blur as lens
from validation.claims.optics import camera
from validation.claims.pictures import colour
from validation.claims.table import CLAIMS
from validation.gates.limits import GATES, gate_of, judged_all, load_gates, within


def test_moments_of_a_known_picture():
    """Expectation: two lines of 3 and 1 at distance 4 have a second moment of 16 * 3/4 * 1/4 = 3 along one axis."""
    picture = np.zeros((9, 9, 4))
    picture[4, 2], picture[4, 6] = 3.0, 1.0
    np.testing.assert_allclose(lens.second_moments(picture), [[0.0, 3.0]] * 4, atol=1e-12)


@pytest.fixture(scope="module")
def checker_under_a(renderer):
    return colour.checker("da-mobile", "A")


@pytest.mark.slow
@pytest.mark.parametrize("broken", [None, "white balance", "gamma"])
def test_colours_that_are_wrong_fail(checker_under_a, monkeypatch, broken):
    """Set-up: the ColorChecker under A as da-mobile has it; white balance that always finds daylight, or the display's
    curve applied twice.
    """
    from recon.picture import colour as recon_colour

    monkeypatch.setattr(colour, "CHECKER_LIGHTS", ("A",))
    monkeypatch.setattr(colour, "CHECKER_CAMERAS", ("da-mobile",))
    monkeypatch.setattr(colour, "checker", lambda *arguments: checker_under_a)
    if broken == "white balance":
        monkeypatch.setattr(recon_colour, "choose_light", lambda *picture: 0)
    if broken == "gamma":
        true = colour.to_srgb
        monkeypatch.setattr(colour, "to_srgb", lambda e, matrix, scale: true(true(e, matrix, scale), np.eye(3), 1.0))
    figure = next(f for f in colour.colour(lambda share: None).figures if f.id == "A")
    gate = gate_of("colour.A", load_gates(GATES, CLAIMS))
    assert within(figure.value, gate.limit) is (broken is None)


@pytest.mark.parametrize("good", [True, False])
def test_depth_as_range_fails(renderer, monkeypatch, good):
    """Set-up: the truth's depth times the length of the ray with z = 1: range, for z."""
    import dasim

    true = dasim.simulate

    def ranged(*arguments, **options):
        from dataclasses import replace

        shot = true(*arguments, **options)
        depth = shot.truth.depth_m
        away = [np.arange(n) + 0.5 - n / 2 for n in depth.shape]
        image_px = 1e-3 / (1 / 3.6 - 1 / (1e3 * ground_truth.FOCUS_M)) / (ground_truth.PITCH_UM * 1e-6)
        length = np.sqrt(1 + (away[0][:, None] ** 2 + away[1][None] ** 2) / image_px**2)
        return shot if good else replace(shot, truth=replace(shot.truth, depth_m=depth * length))

    monkeypatch.setattr(dasim, "simulate", ranged)
    depth, *others = verdicts("ground-truth", ground_truth.ground_truth)
    assert depth is good and all(others)


@pytest.mark.parametrize("flip", [False, True])
def test_a_mirrored_truth_fails(renderer, monkeypatch, flip):
    import dasim

    true = dasim.simulate

    def mirrored(*arguments, **options):
        from dataclasses import fields, replace

        shot = true(*arguments, **options)
        arrays = {f.name: getattr(shot.truth, f.name) for f in fields(shot.truth)}
        turned = {key: a[:, ::-1] for key, a in arrays.items() if isinstance(a, np.ndarray) and a.ndim > 1}
        return replace(shot, truth=replace(shot.truth, **turned)) if flip else shot

    monkeypatch.setattr(dasim, "simulate", mirrored)
    assert all(verdicts("ground-truth", ground_truth.ground_truth)) is not flip


@pytest.mark.slow
@pytest.mark.parametrize("shift_px", [0.0, 0.5])
def test_infrared_half_a_pixel_off_fails(renderer, monkeypatch, shift_px):
    """Set-up: the light that comes through the hole alone moved along x, as a film of its own could be."""
    from scipy import ndimage

    from dasim.render import passes

    true = passes.stop_ratios

    def moved(loaded, camera_, stop, *arguments, **options):
        picture = true(loaded, camera_, stop, *arguments, **options)
        if stop.name != camera_.stops[-1].name or shift_px == 0:
            return picture
        return type(picture)(*(ndimage.shift(part, (0, shift_px, 0), order=1, mode="nearest") for part in picture))

    monkeypatch.setattr(passes, "stop_ratios", moved)
    monkeypatch.setattr(scenes, "GRID_BLURS_PX", (0.0,))
    results = {
        entry.id.removeprefix("registration.blur-0."): entry.passed
        for entry in entries("registration", scenes.registration)
    }
    assert results["mean_e.G"] and results["sharp_e.G"]
    assert results["mean_e.IR"] is (shift_px == 0)


@pytest.mark.parametrize("good", [True, False])
def test_near_infrared_removed_from_red_fails(monkeypatch, good):
    """Set-up: a sensor whose red pixel is blind beyond 650 nm, as under a common camera's filter."""
    from dasim.camera import specification as cameras

    true = cameras.quantum_efficiency
    response = np.ones((4, len(grid.WAVELENGTH_NM)))
    response[0, grid.WAVELENGTH_NM > 650] = 1 if good else 0.01
    monkeypatch.setattr(cameras, "quantum_efficiency", lambda body: true(body) * response)
    figures = [entry for entry in entries("response-curves", camera.response_curves) if entry.id.endswith("alpha.R")]
    assert [entry.passed for entry in figures] == [good]


def test_dataset_claim_fails_what_is_slow_large_or_leaks():
    """Each figure from made-up runs: at its limit it holds, and a tenth beyond it fails."""
    row = {"seconds": 24.0, "cpu_s": 24.0, "render_s": 21.7, "peak_mb": 1000.0}

    def run(**changes):
        return [row | changes] * 2

    def failing(tiny=(1000.0,) * 8, **runs) -> set[str]:
        ran = {"auto": run(), "two": run(), "one": run(seconds=20.5), "ray": run(seconds=26.6)} | runs
        figures = datasets.figures(ran, [row | {"peak_mb": peak} for peak in tiny])
        judged = judged_all("dataset-speed", figures, load_gates(GATES, CLAIMS))
        return {entry.id.removeprefix("dataset-speed.") for entry in judged if entry.passed is False}

    assert failing() == set()
    assert failing(auto=run(seconds=26.0, render_s=25.0)) == {"rate-auto"}
    assert failing(auto=run(render_s=21.3)) == {"outside-auto"}
    assert failing(one=run(seconds=18.0)) == {"two-over-one"}
    assert failing(ray=run(seconds=29.0)) == {"ray-over-local"}
    assert failing(one=run(seconds=20.5, peak_mb=1100.0)) == {"memory"}
    assert failing(tiny=[1000.0] * 4 + [1010.0, 1030.0, 1060.0, 1100.0]) == {"growth"}
