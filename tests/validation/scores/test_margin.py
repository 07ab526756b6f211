"""Truths of datasets that lack a margin of the frame, or parts: scored, shown and exposed again where they are."""

from __future__ import annotations

import json

import numpy as np
import pytest

import dasim
import recon
import validation
from dasim.cli import run
from dasim.files.captures import save_capture
from dasim.values import TRUTH_PARTS, Truth
from recon.files.reconstruction import save_reconstruction
from validation.scores.margin import central, framed

SIZE_PX, MARGIN_PX = (48, 36), 4
INNER = (SIZE_PX[1] - 2 * MARGIN_PX, SIZE_PX[0] - 2 * MARGIN_PX)


@pytest.fixture(scope="module")
def shot():
    return dasim.simulate("desk", dasim.cropped("da-mobile", *SIZE_PX), spp=2)


@pytest.fixture(scope="module")
def result(shot):
    bank = recon.calibrate(dasim.calibration_captures(shot.capture.camera))
    return recon.reconstruct(shot.capture, bank, recon.PRESETS["paper"])


def of_parts(truth, keep=tuple(TRUTH_PARTS), margin_px=0):
    """A truth with some parts, without a margin."""
    names = {name for part in keep for name in TRUTH_PARTS[part]} | {"channels", "objects", "materials"}
    inside = slice(margin_px, -margin_px or None)
    values = {name: value for name, value in vars(truth).items() if name in names}
    return Truth.of_parts({n: v[inside, inside] if isinstance(v, np.ndarray) else v for n, v in values.items()})


def test_images_in_a_larger_frame():
    image = np.arange(12.0).reshape(3, 4)
    whole = framed(image, (5, 8))
    assert whole.shape == (5, 8) and np.isnan(whole).sum() == 28
    np.testing.assert_array_equal(central(whole, image.shape), image)
    np.testing.assert_array_equal(central(image, (5, 8)), image)


def test_a_reconstruction_is_scored_within_the_margin(shot, result):
    """Expectation: the same figures as with the pixels of the margin marked as seeing nothing."""
    inner = of_parts(shot.truth, margin_px=MARGIN_PX)
    found = {figure.id: figure.value for figure in validation.score(result, shot.capture, inner)}
    valid = np.zeros(shot.truth.valid.shape, bool)
    valid[MARGIN_PX:-MARGIN_PX, MARGIN_PX:-MARGIN_PX] = True
    masked = of_parts(shot.truth)
    object.__setattr__(masked, "valid", shot.truth.valid & valid)
    expected = {figure.id: figure.value for figure in validation.score(result, shot.capture, masked)}
    for name in ("raw.all.coverage", "regularised.all.level-median", "regularised.textured.rmse-dioptre"):
        assert found[name] == pytest.approx(expected[name], rel=1e-6), name
    gain = "all-in-focus.inner.psnr-gain"
    assert found[gain] == pytest.approx(expected[gain], abs=0.05)  # white is that of the smaller picture


def test_a_map_may_have_either_size(shot):
    inner = of_parts(shot.truth, margin_px=MARGIN_PX)
    for depth_m in (shot.truth.depth_m, inner.depth_m):
        figures = {f.id: f.value for f in validation.score_map(depth_m, shot.capture, inner, confidence=depth_m)}
        assert figures["depth.all.coverage"] == 1.0 and figures["depth.all.rmse"] == pytest.approx(0, abs=1e-6)


@pytest.mark.parametrize(("keep", "margin_px"), [(tuple(TRUTH_PARTS), MARGIN_PX), (("depth", "labels", "mean_e"), 0)])
def test_views_of_such_samples(tmp_path, monkeypatch, shot, result, keep, margin_px):
    """Expectation: a page of the capture and one of its reconstruction, with the true depth in the frame's size."""
    monkeypatch.chdir(tmp_path)
    save_capture(tmp_path / "shot", shot.capture, of_parts(shot.truth, keep, margin_px))
    save_reconstruction(tmp_path / "rebuilt", result)
    for arguments in (["view", "shot", "--out", "a.html"], ["view", "rebuilt", "--capture", "shot", "--out", "b.html"]):
        assert run(arguments) == 0
        assert "true_depth" in (tmp_path / arguments[-1]).read_text()


def test_parts_that_are_there_are_exposed_again(tmp_path, monkeypatch, shot):
    monkeypatch.chdir(tmp_path)
    truth = of_parts(shot.truth, ("depth", "labels", "mean_e", "mean_e_variance"))
    save_capture(tmp_path / "shot", shot.capture, truth)
    assert run(["expose", "shot", "--time", "0.01", "--out", "again"]) == 0
    mean = dasim.load_truth(tmp_path / "again").mean_e
    np.testing.assert_allclose(mean, shot.truth.mean_e * (0.01 / shot.capture.exposure_s), rtol=1e-3)
    assert json.loads((tmp_path / "again" / "meta.json").read_text())["exposure_s"] == 0.01
