"""The gates of the claim depth-held-out pass for the truth, and fail for no depth and for a wrong accuracy."""

from __future__ import annotations

import base64
import dataclasses
import re

import cv2
import numpy as np
import pytest

from dasim.base.errors import InputError
from dasim.bounds import cramer_rao
from dasim.camera import noise, specification
from dasim.camera.crosstalk import electronic_crosstalk
from dasim.simulation.exposure import Shot
from dasim.values import Capture
from tests.support import surfaces
from validation.claims.depth import held_out
from validation.claims.table import CLAIMS
from validation.gates.limits import GATES, judged_all, load_gates
from validation.methods import bundled
from validation.reports import page, pictures
from validation.reports.claims import wide

SIZE = (128, 160)
MEAN_E = np.array([800.0, 1500.0, 700.0, 600.0])
CONTRAST = 0.1
SD = 0.1  # levels, of an estimator near the bound
NAMES = ("one", "two")
METHOD = bundled("best")


@pytest.fixture(scope="module")
def shot() -> Shot:
    """A textured wall at level 1.5 with objects at levels 5 and 9, as a sharp picture with sensor noise."""
    camera = specification.cropped(specification.load_camera("da-mobile"), SIZE[1], SIZE[0])
    level = np.full(SIZE, 1.5)
    level[20:80, 15:75], level[50:115, 85:145] = 5.0, 9.0
    power = cramer_rao.natural_power(SIZE, contrast=CONTRAST)
    texture = np.fft.irfft2(np.fft.rfft2(np.random.default_rng(5).standard_normal(SIZE)) * np.sqrt(power), SIZE)
    truth = surfaces.truth(camera, level, MEAN_E * (1 + texture[..., None]))
    raw, _ = noise.expose(electronic_crosstalk(noise.mosaic(truth.mean_e, camera), camera), camera.sensor, 0.02, 0)
    return Shot(Capture(raw, camera, 0.02, 1.0, 0, "D65", {"diffraction": "wave"}), truth)


@pytest.fixture(scope="module")
def windows(shot):
    return held_out.measured_windows(shot)


@pytest.fixture
def claim(monkeypatch, shot, windows):
    """Function that gives the evidence of the claim with a method in place of the reconstruction."""
    recipes = [held_out.sets.Recipe(name, None, shot.capture.camera, None) for name in NAMES]
    monkeypatch.setattr(held_out.rendering, "needs_wave", lambda: None)
    monkeypatch.setattr(held_out.sets, "recipes", lambda name: recipes)
    monkeypatch.setattr(held_out.sets, "capture", lambda recipe: shot)
    monkeypatch.setattr("dasim.calibration_captures", lambda *args, **options: None)
    monkeypatch.setattr("recon.calibrate", lambda captures: None)
    monkeypatch.setattr(held_out, "measured_windows", lambda shot: windows)

    def run(method, picture=lambda shot, maps: ""):
        monkeypatch.setattr(held_out, "reconstructed", method)
        monkeypatch.setattr(held_out, "_picture", picture)
        return held_out.depth_held_out(lambda share: None, METHOD)

    return run


def failed(evidence) -> set[str]:
    entries = judged_all("depth-held-out", evidence.figures, load_gates(GATES, CLAIMS))
    return {entry.id.removeprefix("depth-held-out.") for entry in entries if entry.passed is False}


def result(shot, level, sd):
    """A reconstruction with a map of levels and the confidence of its standard deviation."""
    confidence = np.broadcast_to(1 / (1 + np.square(sd)), SIZE).astype(np.float32)
    exact = surfaces.exact_reconstruction(shot.truth, shot.capture.camera)
    return dataclasses.replace(exact, level=level.astype(np.float32), confidence=confidence)


def estimate(shot, case):
    """Maps with normal errors of SD; the wrong ones differ in one respect."""
    true = shot.truth.level.astype(float)
    error = SD * np.random.default_rng(3).standard_normal(SIZE)
    if case == "constant":
        return result(shot, np.full(SIZE, true.mean()), true.std())
    if case == "smooth":
        return result(shot, smoothed(true) + error, SD)
    if case == "biased near the focus":
        return result(shot, true + error + np.where(true < 2, 0.7, 0), np.where(true < 2, 0.7, SD))
    stated = {"truth": SD, "sure": SD / 3, "unsure": 3 * SD}[case]
    return result(shot, true + error, stated)


def smoothed(level):
    """The levels with edges smoothed over 24 px."""
    padded = np.pad(level, 12, "edge")
    return np.lib.stride_tricks.sliding_window_view(padded, (25, 25)).mean(axis=(-1, -2))


NEAR_FOCUS = "near-focus.abs-bias.mean"
CASES = {
    "truth": set(),
    "constant": {
        "all.rmse-ratio.mean", "lost", "textured.error-median.mean", "bound.ratio.mean", "edges.f-score.mean",
        "half.error-median.mean", NEAR_FOCUS,
    },
    "smooth": {"edges.f-score.mean"},
    "sure": {"all.within-sd.mean"},
    "unsure": {"all.within-sd.mean"},
    "biased near the focus": {NEAR_FOCUS},
}  # fmt: skip


@pytest.mark.parametrize("case", CASES)
def test_the_gates_fail_for_what_is_wrong(claim, shot, case):
    """Expectation: the truth passes all, and every error fails its gate; a constant map fails nearly all."""
    failures = failed(claim(lambda *args: estimate(shot, case)))
    assert failures >= CASES[case] and bool(failures) is (case != "truth")


def test_a_capture_without_a_reconstruction_is_lost(claim, shot):
    """Set-up: the first capture is refused. Expectation: its name and the reason are in the report, which goes on."""
    calls = []

    def reconstructed(*args):
        calls.append(args)
        if len(calls) == 1:
            raise InputError("too dark")
        return estimate(shot, "truth")

    evidence = claim(reconstructed)
    figures = {figure.id: figure for figure in evidence.figures}
    assert failed(evidence) >= {"lost"} and figures["lost"].value == 0.5 and figures["failed"].value == 1
    assert figures["lost"].meaning.endswith(": one") and len(evidence.pictures) == 2
    assert any(row[0] == "one" and row[-1] == "too dark" for _, _, rows in evidence.tables for row in rows)
    ratio = figures["all.rmse-ratio.two"].value
    assert figures["all.rmse-ratio.one"].value == 1 and figures["all.rmse-ratio.mean"].value == (1 + ratio) / 2
    assert figures["textured.error-median.mean"].value == figures["textured.error-median.two"].value


def test_the_report_states_the_set_and_shows_every_capture(claim, shot):
    evidence = claim(lambda *args: estimate(shot, "truth"), held_out._picture)
    assert held_out.sets.HASHES["test"] in evidence.tables[0][0]
    assert [caption.partition(":")[0] for caption, _ in evidence.pictures] == list(NAMES)
    assert all(wide(address) for _, address in evidence.pictures)


def test_what_lies_behind_the_focus_is_grey():
    """Set-up: a quarter of the frame lies behind the focus. Expectation: grey in the maps alone."""
    level = np.broadcast_to(np.where(np.arange(160) < 40, -3.0, 8.0), (120, 160))
    address = pictures.level_panels(np.ones((120, 160, 3)), [("true", level), ("first", level)], level >= 0)
    drawing = base64.b64decode(address.partition(",")[2]).decode()
    shares = []
    for encoded in re.findall(r'data:image/png;base64,([^"]+)"', drawing):
        picture = cv2.imdecode(np.frombuffer(base64.b64decode(encoded), np.uint8), cv2.IMREAD_COLOR)
        shares.append(float((picture == int(page.NO_ESTIMATE[1:3], 16)).all(axis=-1).mean()))
    maps = [share for share in shares if share > 0]
    assert len(maps) == 3, "both maps and the error, not the photograph nor the colour bars"
    np.testing.assert_allclose(maps, 0.25, atol=0.01)
    assert "url(#" in drawing, "hatches are a pattern of the drawing"


def test_the_standard_deviation_is_that_of_the_confidence():
    stated = held_out.stated_sd(np.array([1.0, 0.5, 0.1, 0.0], np.float32))
    np.testing.assert_allclose(stated, [0, 1, 3, np.inf], rtol=1e-6)
