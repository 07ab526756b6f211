"""The gates of the claim sharp-held-out pass for the truth, and fail for no gain, for halos and for losses in focus."""

from __future__ import annotations

import dataclasses

import cv2
import numpy as np
import pytest

from dasim.base.errors import InputError
from dasim.camera import geometry, specification
from dasim.simulation.exposure import Shot
from dasim.values import Capture
from tests.support import surfaces
from validation.claims.pictures import sharp_held_out
from validation.claims.table import CLAIMS
from validation.gates.limits import GATES, judged_all, load_gates
from validation.methods import bundled
from validation.scores import sharpness
from validation.scores.pictures import references

SIZE = (128, 200)
BLURS_PX = (0.5, 2.0, 5.0, 14.0, 25.0)  # of five walls, one in each interval
BRIGHTNESS = (1.0, 2.0, 1.0, 2.0, 1.0)
MEAN_E = np.array([800.0, 1500.0, 700.0, 600.0])
NOISE = 0.05  # of the captured picture, relative to its mean
NAMES = ("one", "two")
METHOD = bundled("best")


@pytest.fixture(scope="module")
def shot() -> Shot:
    """Five textured walls from the focus forwards, and a capture of which only the camera counts."""
    camera = specification.cropped(specification.load_camera("da-mobile"), SIZE[1], SIZE[0])
    width = SIZE[1] // len(BLURS_PX)
    level, brightness = (np.repeat(row, width)[None].repeat(SIZE[0], axis=0) for row in (BLURS_PX, BRIGHTNESS))
    texture = cv2.GaussianBlur(np.random.default_rng(5).standard_normal(SIZE), (0, 0), 1.0)
    image = MEAN_E * (brightness * (1 + 0.1 * texture / texture.std()))[..., None]
    truth = surfaces.truth(camera, level / geometry.level_blur_px(camera)[1], image)
    truth = dataclasses.replace(truth, focus_e=truth.sharp_e, sharp_srgb=np.clip(truth.sharp_srgb, 0, 1))
    return Shot(Capture(np.zeros(SIZE, np.uint16), camera, 0.02, 1.0, 0, "D65", {"diffraction": "wave"}), truth)


@pytest.fixture
def claim(monkeypatch, shot):
    """Function that gives the evidence of the claim with a method in place of the reconstruction."""
    recipes = [sharp_held_out.sets.Recipe(name, None, shot.capture.camera, None) for name in NAMES]
    monkeypatch.setattr(sharp_held_out.rendering, "needs_wave", lambda: None)
    monkeypatch.setattr(sharp_held_out.sets, "recipes", lambda name: recipes)
    monkeypatch.setattr(sharp_held_out.sets, "capture", lambda recipe: shot)
    monkeypatch.setattr(sharp_held_out, "quiet", lambda shot: shot)
    monkeypatch.setattr("dasim.calibration_captures", lambda *args, **options: None)
    monkeypatch.setattr("recon.calibrate", lambda captures: None)
    monkeypatch.setattr(sharp_held_out, "RIVALS", {"rival.": ("a rival", lambda result, bank: result.linear_e)})

    def run(method, methods=METHOD):
        monkeypatch.setattr(sharp_held_out, "reconstructed", method)
        monkeypatch.setattr("recon.reconstruct", lambda *args, method: picture(shot, "truth"))
        return sharp_held_out.sharp_held_out(lambda share: None, methods)

    return run


def failed(evidence) -> set[str]:
    entries = judged_all("sharp-held-out", evidence.figures, load_gates(GATES, CLAIMS))
    return {entry.id.removeprefix("sharp-held-out.") for entry in entries if entry.passed is False}


def picture(shot, case):
    """A reconstruction with a blurred and noisy captured picture, and the truth with one fault all in focus."""
    result = dataclasses.replace(surfaces.exact_reconstruction(shot.truth, shot.capture.camera), light="D65")
    exact = references(result, shot.truth)["-focus"].astype(np.float32)
    noise = NOISE * exact.mean() * np.random.default_rng(3).standard_normal(exact.shape)
    captured = (cv2.GaussianBlur(exact, (0, 0), 2.0) + noise).astype(np.float32)
    sharp = exact.copy()
    if case == "captured":
        sharp = captured
    elif case == "worse than captured":
        sharp = captured + (captured - exact)
    elif case == "halos":
        walls = cv2.GaussianBlur(exact, (0, 0), 8.0)
        rim = sharpness.regions(shot.truth)["boundary"]
        sharp[rim] += 0.15 * (exact - walls)[rim]
    elif case == "worse in focus":
        focus = sharpness.regions(shot.truth)["0-1"]
        sharp[focus] = (exact + 1.2 * (captured - exact))[focus]
    elif case == "far blur as captured":
        far = sharpness.regions(shot.truth)["over-20"]
        sharp[far] = captured[far]
    return dataclasses.replace(result, linear_e=captured, sharp_e=sharp)


IN_FOCUS = {"gain.0-1.least", "tenth-noise.gain.0-1.mean"}
OF_A_GAIN = {
    *(f"gain.{region}.mean" for region in ("all", "3-8", "8-20", "over-20", "boundary")),
    *(f"tenth-noise.gain.{region}.mean" for region in sharpness.REGIONS),
}
CASES = {
    "truth": set(),
    "captured": OF_A_GAIN,
    "worse than captured": OF_A_GAIN | {"lost", "gain.0-1.least"},
    "halos": {"halo.mean"},
    "worse in focus": IN_FOCUS,
    "far blur as captured": {"gain.over-20.mean", "tenth-noise.gain.over-20.mean"},
}


@pytest.mark.parametrize("case", CASES)
def test_the_gates_fail_for_what_is_wrong(claim, shot, case):
    """Expectation: the truth passes all; every fault fails its own gates, and one that is local no other."""
    failures = failed(claim(lambda *args: picture(shot, case)))
    if case in ("captured", "worse than captured"):  # their noise may be a halo, too
        failures -= {"halo.mean"}
    assert failures == CASES[case]


def test_the_capture_as_picture_has_a_gain_of_zero(claim, shot):
    figures = {figure.id: figure.value for figure in claim(lambda *args: picture(shot, "captured")).figures}
    for region in sharpness.REGIONS:
        assert {figures[f"{quantity}.{region}.mean"] for quantity in sharpness.QUANTITIES} == {0}
    assert figures["lost"] == 0 and figures["gain.all.one"] == 0


def test_true_levels_and_less_noise_are_reported_apart(claim, shot):
    """Set-up: the capture as picture, but the truth with true levels. Expectation: three times the same figures, and
    those of a rival.
    """
    figures = {figure.id: figure.value for figure in claim(lambda *args: picture(shot, "captured")).figures}
    assert figures["true-levels.gain.all.mean"] > 60 and figures["tenth-noise.gain.all.mean"] == 0
    plain = [name for name in figures if not name.startswith(("true-levels.", "tenth-noise.", "rival."))]
    assert len(figures) == 4 * len(plain)


def test_pictures_of_rivals_stand_beside_without_limits(claim, shot):
    """Set-up: the truth as picture, and a rival that leaves the captured one. Expectation: the rival has no gain, no
    gate judges it, and the picture beside it keeps its own.
    """
    evidence = claim(lambda *args: picture(shot, "truth"))
    figures = {figure.id: figure.value for figure in evidence.figures}
    assert figures["rival.gain.all.mean"] == 0 and figures["gain.all.mean"] > 60
    assert failed(evidence) == set()
    assert any(label == "a rival, levels of best" for label, *_ in evidence.tables[0][2])


def test_other_methods_stand_beside_without_conditions(claim, shot):
    evidence = claim(lambda *args: picture(shot, "truth"), bundled("best", "paper"))
    names = {figure.id for figure in evidence.figures}
    assert "paper.gain.all.mean" in names and not any(name.startswith("paper.true-levels") for name in names)
    assert evidence.tables[0][2] == [[label, "0", ""] for label in evidence.tables[1][1][1:]]


def test_a_capture_without_a_reconstruction_is_lost(claim, shot):
    """Set-up: the first capture is refused. Expectation: its name and the reason are in the report, which goes on."""
    calls = []

    def reconstructed(*args):
        calls.append(args)
        if len(calls) == 1:
            raise InputError("too dark")
        return picture(shot, "truth")

    evidence = claim(reconstructed)
    figures = {figure.id: figure for figure in evidence.figures}
    assert failed(evidence) == {"lost"} and figures["lost"].value == 0.5 and figures["failed"].value == 1
    assert figures["lost"].meaning.endswith(": one") and len(evidence.pictures) == 1
    assert any(row[0] == "one" and row[-1] == "too dark" for _, _, rows in evidence.tables for row in rows)
    assert np.isnan(figures["gain.all.one"].value)
    assert figures["gain.all.mean"].value == figures["gain.all.two"].value


def test_the_report_states_the_set_and_shows_every_capture(claim, shot):
    evidence = claim(lambda *args: picture(shot, "captured"))
    assert sharp_held_out.sets.HASHES["test"] in evidence.tables[0][0]
    assert [caption.partition(":")[0] for caption, _ in evidence.pictures] == list(NAMES)
    assert all(address.startswith("data:image/png") for _, address in evidence.pictures)
